//! Both strategies on the scans of a synthetic interior, whose true poses are known.

use scanweave::config::{Config, Layers};
use scanweave::evaluation::PoseError;
use scanweave::geometry::RigidMotion;
use scanweave::pipeline::{self, Described, FeatureSource, Stopwatch};
use scanweave::scan::{Outcome, Placement, Reconstruction, Scan, ScanId};
use scanweave::synthetic::{SynthConfig, generate};
use scanweave::{Result, Silent, register_pair};
use std::sync::OnceLock;

struct Interior {
    scans: Vec<Scan>,
    described: Described,
    world_from_scan: Vec<RigidMotion>,
}

fn interior() -> &'static Interior {
    static INTERIOR: OnceLock<Interior> = OnceLock::new();
    INTERIOR.get_or_init(|| {
        let config = SynthConfig { seed: 21, rooms: 1, scans: 8, ..SynthConfig::default() };
        let set = generate(&config, &Silent).unwrap();
        let described = pipeline::describe(
            &set.scans,
            &settings("default", &[]).unwrap(),
            &FeatureSource::Computed,
            &Silent,
        );
        Interior { described: described.unwrap(), world_from_scan: set.world_from_scan, scans: set.scans }
    })
}

/// A preset with settings laid over it; FPFH, which is quick.
fn settings(preset: &str, assignments: &[&str]) -> Result<Config> {
    let mut layers = Layers::new::<Config>();
    layers.add_preset(preset)?;
    for assignment in ["descriptor.kind=fpfh", "descriptor.keypoints.count=1500"].iter().chain(assignments) {
        layers.add_assignment(assignment)?;
    }
    Config::from_layers(&layers)
}

impl Interior {
    /// Registers the scans in an order: `order[k]` is the scan at place `k` of the input.
    fn register(&self, config: &Config, order: &[usize]) -> Reconstruction {
        let mut described = self.described.clone();
        described.surfaces = order.iter().map(|&k| self.described.surfaces[k].clone()).collect();
        described.frames = order.iter().map(|&k| self.described.frames[k]).collect();
        described.features = order.iter().map(|&k| self.described.features[k].clone()).collect();
        let mut clock = Stopwatch::default();
        let (similarity, _) = pipeline::predict_overlap(&described, config, &Silent, &mut clock).unwrap();
        pipeline::register_described(&described, &similarity, config, &Silent, &mut clock).unwrap()
    }

    fn in_order(&self) -> Vec<usize> {
        (0..self.world_from_scan.len()).collect()
    }
}

/// The paper's one meta-shape with the verification and refinement of the default: surfaces, free
/// space, multiview ICP in between and at the end.
#[test]
fn incremental_growth_by_surfaces_and_multiview_icp_finds_the_true_poses() {
    let interior = interior();
    for assignments in [
        &["registration.strategy.kind=incremental"][..],
        &["registration.strategy.kind=incremental", "registration.strategy.refine_every=2"],
        // Ablation (c): who overlaps most joins next, verified by inliers.
        &["registration.strategy.kind=incremental", "registration.strategy.ordering=overlap"],
    ] {
        let config = settings("default", assignments).unwrap();
        let r = interior.register(&config, &interior.in_order());
        let n = interior.world_from_scan.len();
        assert!(r.placed() + 1 >= n, "{assignments:?}: {} of {n}", r.placed());
        let mut compared = 0;
        for i in 0..n {
            for j in i + 1..n {
                let Some(found) = r.relative(ScanId(i), ScanId(j)) else { continue };
                let truth = interior.world_from_scan[i].inverse() * interior.world_from_scan[j];
                let error = PoseError::between(&found, &truth);
                assert!(
                    error.translation_m < 0.08 && error.rotation_deg < 2.0,
                    "{assignments:?}: {i} {j} {error:?}"
                );
                compared += 1;
            }
        }
        assert!(compared >= (n - 1) * (n - 2) / 2, "{assignments:?}: {compared} pairs");
        let joined = r.outcomes.iter().filter_map(|o| o.placement()).filter(|p| p.parent.is_some());
        for p in joined {
            let evidence = p.evidence.unwrap();
            assert!(evidence.probability.is_some_and(|p| p >= 0.6) && evidence.overlap > 0.0, "{evidence:?}");
        }
    }
}

/// A placement but for the numbers of scans.
fn content(p: &Placement) -> (RigidMotion, usize, usize, usize, usize, Option<f64>) {
    let probability = p.evidence.and_then(|e| e.probability);
    (p.world_from_scan, p.component, p.step, p.matches, p.inliers, probability)
}

/// File names, and the order that they give, change no bit of any result: random numbers and ties
/// go by the content of the scans.
#[test]
fn shuffled_scans_get_the_same_poses_to_the_bit() {
    let interior = interior();
    let n = interior.world_from_scan.len();
    let orders = [(0..n).rev().collect::<Vec<_>>(), (0..n).map(|k| (3 * k + 2) % n).collect()];
    for (preset, assignments) in [
        ("default", &[][..]),
        ("default", &["registration.strategy.kind=incremental"]),
        ("default", &["registration.estimator.kind=ransac"]),
        ("default", &["retrieval.head=untrained"]),
        ("paper", &[]),
        ("default", &["method=sghr", "registration.estimator.kind=ransac"]),
        ("default", &["method=pose-graph"]),
    ] {
        let config = settings(preset, assignments).unwrap();
        let straight = interior.register(&config, &interior.in_order());
        assert!(straight.placed() + 2 >= n, "{preset} {assignments:?}: {} placed", straight.placed());
        for order in &orders {
            let place_of = |scan: ScanId| ScanId(order.iter().position(|&k| k == scan.0).unwrap());
            let shuffled = interior.register(&config, order);
            for (k, outcome) in straight.outcomes.iter().enumerate() {
                let other = &shuffled.outcomes[place_of(ScanId(k)).0];
                match (outcome, other) {
                    (Outcome::Placed(a), Outcome::Placed(b)) => {
                        assert_eq!(content(a), content(b), "{preset} {assignments:?}: scan {k}");
                        assert_eq!(a.parent.map(place_of), b.parent, "{preset} {assignments:?}: scan {k}");
                    }
                    (Outcome::Declined(a), Outcome::Declined(b)) => assert_eq!(a, b),
                    _ => panic!("{preset} {assignments:?}: scan {k} is placed in one order only"),
                }
            }
        }
    }
}

/// Pairs of one room: those that are accepted are right, and most neighbours are.
#[test]
fn a_pair_is_accepted_where_it_is_right_and_says_why_not_elsewhere() {
    let interior = interior();
    let config = settings("default", &[]).unwrap();
    let (mut accepted, mut declined) = (0, 0);
    for i in 0..4 {
        for j in 0..i {
            let pair = register_pair(&interior.scans[j], &interior.scans[i], &config).unwrap();
            assert_eq!(pair.accepted, pair.declined.is_none());
            if !pair.accepted {
                declined += 1;
                continue;
            }
            accepted += 1;
            let truth = interior.world_from_scan[j].inverse() * interior.world_from_scan[i];
            let error = PoseError::between(&pair.target_from_source.unwrap(), &truth);
            assert!(error.translation_m < 0.15 && error.rotation_deg < 4.0, "{j} {i}: {error:?}");
            assert!(pair.evidence.probability.is_some_and(|p| p >= 0.6));
        }
    }
    assert!(accepted >= 2, "{accepted} accepted, {declined} declined");
    // A flat wall fixes no pose.
    let wall: Vec<[f64; 3]> =
        (0..10_000).map(|k| [f64::from(k % 100) * 0.02, f64::from(k / 100) * 0.02, 1.0]).collect();
    let wall = Scan::from_points("wall", &wall);
    let pair = register_pair(&interior.scans[0], &wall, &config).unwrap();
    assert!(!pair.accepted && pair.target_from_source.is_none());
    assert!(pair.declined.unwrap().to_string().contains("plane"));
    let paper = settings("paper", &[]).unwrap();
    let error = register_pair(&interior.scans[0], &interior.scans[1], &paper).unwrap_err().to_string();
    assert!(error.contains("registration.verification.kind: found inlier-count"), "{error}");
}
