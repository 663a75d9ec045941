//! The incremental strategy on synthetic worlds whose truth is known exactly.
//!
//! A world is a set of random points, each with its own random descriptor; a scan is the
//! part of it inside a window, in a random frame, with 5 mm noise on points and a little
//! on descriptors. Expected poses are the frames drawn, up to the choice of the pivot.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scanweave::geometry::{Direction, Point, RigidMotion};
use scanweave::geometry::{rotation_error_rad, translation_error_m};
use scanweave::registration::{
    EstimatorConfig, IncrementalConfig, InlierCountConfig, MergeRule, Ordering, RansacConfig,
    RegistrationConfig, Strategy, VerificationConfig,
};
use scanweave::registration::{Lengths, ScanInput, register};
use scanweave::scan::{
    DeclineReason, Descriptors, Features, Outcome, Reconstruction, ScanId, SimilarityMatrix, Surface,
};
use scanweave::{Monitor, Silent};

const DIM: usize = 16;
const RADIUS_M: f64 = 0.07;
const LENGTHS: Lengths = Lengths { inlier_radius_m: RADIUS_M, voxel_m: 0.025 };

struct World {
    features: Vec<Features>,
    surfaces: Vec<Surface>,
    world_from_scan: Vec<RigidMotion>,
}

impl World {
    fn empty() -> Self {
        Self { features: Vec::new(), surfaces: Vec::new(), world_from_scan: Vec::new() }
    }

    /// Adds a strip of scans, each window `0.5` of its width further than the last.
    fn add_strip(&mut self, scans: usize, seed: u64) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let length = 1.0 + 0.5 * scans as f32;
        let points: Vec<Point> = (0..(400.0 * length) as usize)
            .map(|_| {
                Point::new(
                    rng.random_range(0.0..length),
                    rng.random_range(0.0..1.5),
                    rng.random_range(0.0..1.0),
                )
            })
            .collect();
        let descriptors: Vec<[f32; DIM]> =
            points.iter().map(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))).collect();
        for s in 0..scans {
            let start = 0.5 * s as f32;
            let inside: Vec<usize> =
                (0..points.len()).filter(|&i| (start..start + 1.0).contains(&points[i].x)).collect();
            let pose = RigidMotion::new(
                Vector3::from_fn(|_, _| rng.random_range(-3.0..3.0)),
                Vector3::from_fn(|_, _| rng.random_range(-1.5..1.5)),
            );
            let back = pose.inverse();
            let seen = inside
                .iter()
                .map(|&i| {
                    let noise = Vector3::from_fn(|_, _| rng.random_range(-0.005f32..0.005));
                    (back * points[i].cast::<f64>()).cast::<f32>() + noise
                })
                .collect::<Vec<_>>();
            let values: Vec<f32> = inside
                .iter()
                .flat_map(|&i| descriptors[i])
                .map(|v| v + rng.random_range(-0.1..0.1))
                .collect();
            let d = Descriptors::new(DIM, values).unwrap().normalized();
            self.surfaces.push(Surface {
                normals: vec![Direction::zeros(); seen.len()],
                points: seen.clone(),
                ..Surface::default()
            });
            self.features.push(Features::new(seen, None, d).unwrap());
            self.world_from_scan.push(pose);
        }
    }

    /// Similarity by the share of points both windows hold would be an oracle; a constant makes
    /// the registration find its order by geometry.
    fn flat_similarity(&self) -> SimilarityMatrix {
        let n = self.features.len();
        SimilarityMatrix::new(n, vec![0.5; n * n]).unwrap()
    }

    fn inputs(&self) -> Vec<ScanInput<'_>> {
        let pairs = self.features.iter().zip(&self.surfaces);
        pairs.map(|(features, surface)| ScanInput::new(features, surface)).collect()
    }

    fn register(&self, config: &RegistrationConfig, seed: u64) -> Reconstruction {
        register(&self.inputs(), &self.flat_similarity(), config, LENGTHS, seed, &Silent).unwrap()
    }

    fn assert_relative_poses(&self, result: &Reconstruction, scans: std::ops::Range<usize>) {
        for i in scans.clone() {
            for j in scans.clone() {
                let truth = self.world_from_scan[i].inverse() * self.world_from_scan[j];
                let found = result.relative(ScanId(i), ScanId(j)).expect("both placed in one component");
                assert!(translation_error_m(&found, &truth) < 0.02, "{i} {j}");
                assert!(rotation_error_rad(&found, &truth) < 0.02, "{i} {j}");
            }
        }
    }
}

/// The paper's method: worlds of random points have no surface to verify or refine on.
fn paper(settings: IncrementalConfig) -> RegistrationConfig {
    let mut config = RegistrationConfig::default();
    config.strategy = Strategy::Incremental(settings);
    config.verification = VerificationConfig::InlierCount(InlierCountConfig::new(12));
    config.multiview_icp.enabled = false;
    config
}

fn by_inliers() -> IncrementalConfig {
    let mut config = IncrementalConfig::default();
    config.ordering = Ordering::Inliers;
    config
}

/// Every ablation of Li et al. 2025, table 4, but (c), which needs surfaces.
#[test]
fn a_strip_is_registered_under_every_ablation() {
    let mut world = World::empty();
    world.add_strip(6, 1);
    let mut ransac = paper(by_inliers());
    ransac.estimator = EstimatorConfig::Ransac(RansacConfig::default());
    let mut a = by_inliers();
    a.semantic = false;
    let mut b = by_inliers();
    b.ordering = Ordering::Similarity;
    let mut d = by_inliers();
    d.averaging.enabled = false;
    let [e, f] = [MergeRule::Concatenate, MergeRule::Mean].map(|merge| {
        let mut changed = by_inliers();
        changed.merge = merge;
        changed
    });
    let variants = [paper(by_inliers()), ransac].into_iter().chain([a, d, e, f].map(paper));
    for config in variants {
        let result = world.register(&config, 7);
        assert_eq!((result.placed(), result.components()), (6, 1), "{config:?}");
        world.assert_relative_poses(&result, 0..6);
    }
    // Without the geometric stage similarity alone orders the scans: it must know who overlaps.
    let n = world.features.len();
    let near = |i: usize, j: usize| 1.0 / (1.0 + i.abs_diff(j) as f32);
    let values = (0..n * n).map(|k| near(k / n, k % n)).collect();
    let similarity = SimilarityMatrix::new(n, values).unwrap();
    let result = register(&world.inputs(), &similarity, &paper(b), LENGTHS, 7, &Silent).unwrap();
    assert_eq!((result.placed(), result.components()), (6, 1));
    world.assert_relative_poses(&result, 0..6);
}

#[test]
fn scans_that_only_fit_each_other_form_their_own_component() {
    let mut world = World::empty();
    world.add_strip(4, 1);
    world.add_strip(3, 2);
    let result = world.register(&paper(by_inliers()), 7);
    assert_eq!((result.placed(), result.components()), (7, 2));
    world.assert_relative_poses(&result, 0..4);
    world.assert_relative_poses(&result, 4..7);
    assert_eq!(result.relative(ScanId(0), ScanId(5)), None);
    // The larger component comes first.
    assert_eq!(result.outcomes[0].placement().unwrap().component, 0);
    assert_eq!(result.outcomes[6].placement().unwrap().component, 1);
}

#[test]
fn a_scan_that_fits_nothing_is_declined_with_its_best_attempt() {
    let mut world = World::empty();
    world.add_strip(4, 1);
    world.add_strip(1, 2);
    let result = world.register(&paper(by_inliers()), 7);
    assert_eq!(result.placed(), 4);
    match &result.outcomes[4] {
        Outcome::Declined(DeclineReason::TooFewInliers { inliers, needed, matches }) => {
            assert!(inliers < needed && *matches > 0);
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_empty_scan_is_declined_and_the_others_are_placed() {
    let mut world = World::empty();
    world.add_strip(3, 1);
    world.features.push(Features::new(vec![], None, Descriptors::new(DIM, vec![]).unwrap()).unwrap());
    world.surfaces.push(Surface::default());
    world.world_from_scan.push(RigidMotion::identity());
    let result = world.register(&paper(by_inliers()), 7);
    assert_eq!(result.placed(), 3);
    assert_eq!(
        result.outcomes[3],
        Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 0, needed: 3 })
    );
}

#[test]
fn the_evidence_of_a_placement_adds_up() {
    let mut world = World::empty();
    world.add_strip(5, 3);
    let result = world.register(&paper(by_inliers()), 7);
    let mut steps: Vec<usize> = Vec::new();
    for outcome in &result.outcomes {
        let p = outcome.placement().unwrap();
        steps.push(p.step);
        assert_eq!(p.parent.is_none(), p.step == 0);
        assert!(p.inliers <= p.matches && p.residual_m <= RADIUS_M);
        if let Some(parent) = p.parent {
            let parent_step = result.outcomes[parent.0].placement().unwrap().step;
            assert!(parent_step < p.step, "a parent joins before its child");
            assert!(p.neighbours.iter().any(|n| n.scan == parent && n.overlap > 0.2));
        }
    }
    steps.sort_unstable();
    assert_eq!(steps, [0, 1, 2, 3, 4]);
    // Neighbouring windows share half of their points, two-way overlap 0.5.
    let n = &result.outcomes[1].placement().unwrap().neighbours;
    let overlap = n.iter().find(|n| n.scan == ScanId(2)).unwrap().overlap;
    assert!((overlap - 0.5).abs() < 0.12, "{overlap}");
}

#[test]
fn one_thread_and_two_give_the_same_bits() {
    let mut world = World::empty();
    world.add_strip(6, 5);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| world.register(&paper(by_inliers()), 11))
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn the_order_of_the_input_does_not_decide_what_is_placed() {
    let mut world = World::empty();
    world.add_strip(5, 8);
    let mut turned = World::empty();
    turned.add_strip(5, 8);
    turned.features.reverse();
    turned.surfaces.reverse();
    turned.world_from_scan.reverse();
    let result = turned.register(&paper(by_inliers()), 7);
    assert_eq!(result.placed(), 5);
    turned.assert_relative_poses(&result, 0..5);
}

#[test]
fn a_cancelled_run_says_where_it_stopped() {
    struct Stop;
    impl Monitor for Stop {
        fn cancelled(&self) -> bool {
            true
        }
    }
    let mut world = World::empty();
    world.add_strip(3, 1);
    let inputs = world.inputs();
    let config = RegistrationConfig::default();
    let stopped = register(&inputs, &world.flat_similarity(), &config, LENGTHS, 7, &Stop);
    assert_eq!(
        stopped.unwrap_err().to_string(),
        "interrupted during registration; nothing half-written was left behind"
    );
}

#[test]
fn features_of_different_dimension_are_refused() {
    let mut world = World::empty();
    world.add_strip(2, 1);
    let n = world.features[1].len();
    world.features[1] = Features::new(
        world.features[1].keypoints.clone(),
        None,
        Descriptors::new(3, [1.0, 0.0, 0.0].repeat(n)).unwrap(),
    )
    .unwrap();
    let inputs = world.inputs();
    let config = RegistrationConfig::default();
    let refused = register(&inputs, &world.flat_similarity(), &config, LENGTHS, 7, &Silent);
    assert_eq!(
        refused.unwrap_err().to_string(),
        "features of scan 1: found descriptors of dimension 3, expected dimension 16, as in scan 0; \
         compute the features of all scans with one descriptor"
    );
}
