//! Synchronisation of synthetic pose graphs, whose poses are known.

use nalgebra::Vector3;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scanweave::Silent;
use scanweave::geometry::RigidMotion;
use scanweave::geometry::{rotation_error_rad, translation_error_m};
use scanweave::scan::{DeclineReason, Outcome, PoseEdge, PoseGraph, Reconstruction, ScanId};
use scanweave::synchronization::{Method, synchronize};
use scanweave::synthetic::{KnownPoseGraph, PoseGraphConfig};

/// All methods but the learned one, whose answer is never exact.
const CLOSED_FORM: [Method; 6] =
    [Method::Eigse3, Method::L1Irls, Method::Rotavg, Method::Hara, Method::Sghr, Method::PoseGraph];

fn solve(graph: &PoseGraph, method: Method) -> Reconstruction {
    synchronize(graph, method, None, &Silent).unwrap()
}

/// Rotation and translation errors of all relative poses; the frame does not matter.
fn pair_errors(found: &Reconstruction, truth: &[RigidMotion]) -> Vec<(f64, f64)> {
    let mut errors = Vec::new();
    for i in 0..truth.len() {
        for j in i + 1..truth.len() {
            let relative = found.relative(ScanId(i), ScanId(j)).expect("both placed in one component");
            let expected = truth[i].inverse() * truth[j];
            errors
                .push((rotation_error_rad(&relative, &expected), translation_error_m(&relative, &expected)));
        }
    }
    errors
}

fn worst(errors: &[(f64, f64)]) -> (f64, f64) {
    errors.iter().fold((0.0, 0.0), |w, e| (f64::max(w.0, e.0), f64::max(w.1, e.1)))
}

/// Root mean square per axis of rotation and translation errors.
fn rms(errors: &[(f64, f64)]) -> (f64, f64) {
    let mean = |f: fn(&(f64, f64)) -> f64| {
        (errors.iter().map(|e| f(e).powi(2)).sum::<f64>() / errors.len() as f64 / 3.0).sqrt()
    };
    (mean(|e| e.0), mean(|e| e.1))
}

fn assert_exact(found: &Reconstruction, truth: &[RigidMotion], what: &str) {
    let (rad, m) = worst(&pair_errors(found, truth));
    assert!(rad < 1e-6 && m < 1e-6, "{what}: {rad:.1e} rad, {m:.1e} m");
}

#[test]
fn exact_graphs_give_the_truth_back() {
    for (scans, density) in [(2, 1.0), (3, 0.0), (25, 0.0), (30, 0.3), (30, 1.0)] {
        let known = PoseGraphConfig { scans, density, seed: scans as u64, ..Default::default() }.generate();
        for method in CLOSED_FORM {
            let found = solve(&known.graph, method);
            assert_exact(
                &found,
                &known.world_from_scan,
                &format!("{method}, {scans} scans, density {density}"),
            );
        }
    }
}

#[test]
fn a_tree_has_one_answer() {
    // Nothing is redundant: every method must return the composition of the edges.
    let mut known = PoseGraphConfig { scans: 12, density: 1.0, seed: 4, ..Default::default() }.generate();
    known.graph.edges.retain(|e| e.i.0 == (e.j.0 - 1) / 2);
    assert_eq!(known.graph.edges.len(), 11);
    for method in CLOSED_FORM {
        assert_exact(&solve(&known.graph, method), &known.world_from_scan, &method.to_string());
    }
}

#[test]
fn edges_may_be_turned_around() {
    let config = PoseGraphConfig {
        rotation_noise_rad: 0.02,
        translation_noise_m: 0.02,
        outliers: 0.1,
        seed: 5,
        ..Default::default()
    };
    let known = config.generate();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut turned = known.graph.clone();
    for edge in &mut turned.edges {
        if rng.random_bool(0.5) {
            *edge = edge.reversed();
        }
    }
    turned.edges.shuffle(&mut rng);
    for method in CLOSED_FORM {
        let (a, b) = (solve(&known.graph, method), solve(&turned, method));
        for scan in (0..30).map(ScanId) {
            let (a, b) = (a.world_from_scan(scan).unwrap(), b.world_from_scan(scan).unwrap());
            assert!(rotation_error_rad(a, b) < 1e-6 && translation_error_m(a, b) < 1e-6, "{method}");
        }
    }
}

#[test]
fn names_of_scans_mean_nothing() {
    let config = PoseGraphConfig {
        rotation_noise_rad: 0.02,
        translation_noise_m: 0.02,
        outliers: 0.1,
        seed: 6,
        ..Default::default()
    };
    let known = config.generate();
    let mut name: Vec<usize> = (0..30).collect();
    name.shuffle(&mut ChaCha8Rng::seed_from_u64(2));
    let mut renamed = known.graph.clone();
    for edge in &mut renamed.edges {
        (edge.i, edge.j) = (ScanId(name[edge.i.0]), ScanId(name[edge.j.0]));
    }
    for method in CLOSED_FORM {
        let (a, b) = (solve(&known.graph, method), solve(&renamed, method));
        for i in 0..30 {
            for j in 0..i {
                let a = a.relative(ScanId(i), ScanId(j)).unwrap();
                let b = b.relative(ScanId(name[i]), ScanId(name[j])).unwrap();
                let errors = (rotation_error_rad(&a, &b), translation_error_m(&a, &b));
                assert!(errors.0 < 1e-5 && errors.1 < 1e-5, "{method}: {errors:?}");
            }
        }
    }
}

#[test]
fn the_frame_of_the_scans_means_nothing() {
    // Every scan in a frame of its own: T_ij becomes F_i T_ij F_j⁻¹ and poses X_i F_i⁻¹. Turns
    // only, because a least squares translation depends on where a scan's origin is.
    let config = PoseGraphConfig { rotation_noise_rad: 0.02, seed: 7, ..Default::default() };
    let known = config.generate();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let frames: Vec<RigidMotion> = (0..30)
        .map(|_| RigidMotion::rotation(Vector3::from_fn(|_, _| rng.random_range(-1.5..1.5))))
        .collect();
    let mut moved = known.graph.clone();
    for edge in &mut moved.edges {
        let motion = frames[edge.i.0] * edge.i_from_j() * frames[edge.j.0].inverse();
        edge.pair.target_from_source = motion;
    }
    for method in CLOSED_FORM {
        let (a, b) = (solve(&known.graph, method), solve(&moved, method));
        for i in 0..30 {
            let j = (i + 7) % 30;
            let a = frames[i] * a.relative(ScanId(i), ScanId(j)).unwrap() * frames[j].inverse();
            let b = b.relative(ScanId(i), ScanId(j)).unwrap();
            let errors = (rotation_error_rad(&a, &b), translation_error_m(&a, &b));
            assert!(errors.0 < 1e-5 && errors.1 < 1e-5, "{method}: {errors:?}");
        }
    }
}

/// Mean over seeds of the rms error per axis.
fn error_of(method: Method, config: &PoseGraphConfig) -> (f64, f64) {
    let seeds = 8;
    let (mut rad, mut m) = (0.0, 0.0);
    for seed in 0..seeds {
        let known = PoseGraphConfig { seed, ..config.clone() }.generate();
        let e = rms(&pair_errors(&solve(&known.graph, method), &known.world_from_scan));
        (rad, m) = (rad + e.0 / seeds as f64, m + e.1 / seeds as f64);
    }
    (rad, m)
}

#[test]
fn errors_follow_the_noise_and_the_redundancy() {
    // Least squares on a complete graph of n nodes: the difference of two nodes has variance
    // 2σ²/n per axis. Robust averages come within 1/√efficiency of that. The optimisation on
    // SE(3) does better, because exact translations also tell about rotations.
    let sigma = 0.01;
    let complete = |scans: usize, rotation_noise_rad: f64, translation_noise_m: f64| PoseGraphConfig {
        scans,
        density: 1.0,
        rotation_noise_rad,
        translation_noise_m,
        ..Default::default()
    };
    for method in CLOSED_FORM {
        let rotation = if method == Method::PoseGraph { 0.4..1.2 } else { 0.85..1.5 };
        let few = error_of(method, &complete(10, sigma, 0.0)).0;
        let many = error_of(method, &complete(40, sigma, 0.0)).0;
        let louder = error_of(method, &complete(40, 2.0 * sigma, 0.0)).0;
        let expected = |n: f64| sigma * (2.0 / n).sqrt();
        for (found, n) in [(few, 10.0), (many, 40.0)] {
            let ratio = found / expected(n);
            assert!(rotation.contains(&ratio), "{method}: {ratio} of least squares with {n} scans");
        }
        // SGHR weighs an error of one degree by exp(−2) whatever the noise is: of louder edges it
        // uses fewer.
        let growth = if method == Method::Sghr { 1.8..2.6 } else { 1.8..2.2 };
        assert!(growth.contains(&(louder / many)), "{method}: {}", louder / many);
        let few = error_of(method, &complete(10, 0.0, sigma)).1;
        let many = error_of(method, &complete(40, 0.0, sigma)).1;
        for (found, n) in [(few, 10.0), (many, 40.0)] {
            let ratio = found / expected(n);
            assert!((0.85..1.3).contains(&ratio), "{method}: {ratio} of least squares with {n} scans");
        }
    }
}

/// Share of right edges' pairs within 0.1 rad and 0.2 m.
fn share_right(known: &KnownPoseGraph, method: Method) -> f64 {
    let errors = pair_errors(&solve(&known.graph, method), &known.world_from_scan);
    errors.iter().filter(|e| e.0 < 0.1 && e.1 < 0.2).count() as f64 / errors.len() as f64
}

#[test]
fn robust_methods_survive_a_third_of_wrong_edges() {
    for method in [Method::Rotavg, Method::Hara, Method::Sghr, Method::PoseGraph] {
        for seed in 0..3 {
            let config = PoseGraphConfig {
                rotation_noise_rad: 0.01,
                translation_noise_m: 0.01,
                outliers: 0.3,
                seed,
                ..Default::default()
            };
            let share = share_right(&config.generate(), method);
            assert!(share > 0.95, "{method}, seed {seed}: {share:.2}");
        }
    }
}

#[test]
fn hara_drops_what_contradicts_its_tree() {
    // Wild edges close no triplet, so that the tree is the same without them; once they are
    // dropped, so is everything else. Under ℓ½ weights alone they would still pull a little.
    let config = PoseGraphConfig {
        scans: 12,
        density: 1.0,
        rotation_noise_rad: 0.01,
        outliers: 0.15,
        seed: 11,
        ..Default::default()
    };
    let known = config.generate();
    let mut without = known.graph.clone();
    let mut wild = known.outlier.iter();
    without.edges.retain(|_| !wild.next().unwrap());
    assert!(known.graph.edges.len() - without.edges.len() >= 5);
    let (a, b) = (solve(&known.graph, Method::Hara), solve(&without, Method::Hara));
    for scan in (1..12).map(ScanId) {
        let (a, b) = (a.relative(ScanId(0), scan).unwrap(), b.relative(ScanId(0), scan).unwrap());
        assert!(rotation_error_rad(&a, &b) < 1e-9 && translation_error_m(&a, &b) < 1e-9);
    }
}

#[test]
fn what_no_edge_joins_stays_apart() {
    // Scans 0–5, 6–8 and 9 have nothing to do with each other.
    let known = PoseGraphConfig { scans: 10, density: 1.0, seed: 8, ..Default::default() }.generate();
    let group = |s: ScanId| [6, 9].iter().filter(|&&from| s.0 >= from).count();
    let mut graph = known.graph.clone();
    graph.edges.retain(|e| group(e.i) == group(e.j));
    let lonely = DeclineReason::TooFewInliers { inliers: 2, needed: 6, matches: 31 };
    graph.without_edges[9] = lonely.clone();
    for method in CLOSED_FORM {
        let found = solve(&graph, method);
        assert_eq!((found.placed(), found.components()), (9, 2), "{method}");
        assert_eq!(found.outcomes[9], Outcome::Declined(lonely.clone()));
        assert!(found.relative(ScanId(0), ScanId(6)).is_none(), "{method}: two frames are not one");
        for (i, j) in [(0, 5), (6, 8)] {
            let relative = found.relative(ScanId(i), ScanId(j)).unwrap();
            let expected = known.world_from_scan[i].inverse() * known.world_from_scan[j];
            assert!(rotation_error_rad(&relative, &expected) < 1e-6, "{method}");
        }
        // A component's frame is that of its one scan without a parent.
        for component in 0..2 {
            let pivots: Vec<_> = found
                .outcomes
                .iter()
                .filter_map(Outcome::placement)
                .filter(|p| p.component == component && p.parent.is_none())
                .collect();
            assert_eq!(pivots.len(), 1);
            assert_eq!(pivots[0].world_from_scan, RigidMotion::identity());
        }
    }
}

#[test]
fn unusable_graphs_are_refused() {
    let known = PoseGraphConfig { scans: 4, seed: 9, ..Default::default() }.generate();
    let refused = |change: &dyn Fn(&mut PoseGraph)| {
        let mut graph = known.graph.clone();
        change(&mut graph);
        synchronize(&graph, Method::Sghr, None, &Silent).unwrap_err().to_string()
    };
    let twice = refused(&|g| g.edges.push(g.edges[0].reversed()));
    assert!(twice.contains("two edges between 0 and 1"), "{twice}");
    let strange = refused(&|g| g.edges[0].j = ScanId(9));
    assert!(strange.contains("between 0 and 9"), "{strange}");
    let broken = refused(&|g: &mut PoseGraph| {
        let e: &mut PoseEdge = &mut g.edges[2];
        e.pair.target_from_source.translation.x = f64::NAN;
    });
    assert!(broken.contains("not finite"), "{broken}");
    let empty = PoseGraph { scans: 0, edges: Vec::new(), without_edges: Vec::new(), ..known.graph.clone() };
    assert!(solve(&empty, Method::Hara).outcomes.is_empty());
}
