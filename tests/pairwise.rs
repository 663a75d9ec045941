//! Registration of two scans with each other, on points whose truth is known exactly.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scanweave::geometry::{Direction, Point, RigidMotion};
use scanweave::geometry::{PointMover, rotation_error_rad, translation_error_m};
use scanweave::registration::EdgeRegistrar;
use scanweave::registration::EstimatorConfig;
use scanweave::registration::{Lengths, ScanInput};
use scanweave::scan::{DeclineReason, Descriptors, Features, ScanId, Surface};

const LENGTHS: Lengths = Lengths { inlier_radius_m: 0.07, voxel_m: 0.025 };

/// 300 points of a unit cube with random descriptors.
fn world(seed: u64) -> (Vec<Point>, Vec<[f32; 16]>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let points =
        (0..300).map(|_| Point::from(Vector3::from_fn(|_, _| rng.random_range(0.0f32..1.0)))).collect();
    let descriptors = (0..300).map(|_| std::array::from_fn(|_| rng.random_range(-1.0f32..1.0))).collect();
    (points, descriptors)
}

/// The world's points with x in a range, in the frame that `scan_from_world` leads to.
fn scan(seed: u64, x: std::ops::Range<f32>, scan_from_world: &RigidMotion) -> Features {
    let (points, descriptors) = world(seed);
    let seen: Vec<usize> = (0..points.len()).filter(|&i| x.contains(&points[i].x)).collect();
    let mover = PointMover::new(scan_from_world);
    let values = seen.iter().flat_map(|&i| descriptors[i]).collect();
    let keypoints = seen.iter().map(|&i| mover.point(&points[i])).collect();
    Features::new(keypoints, None, Descriptors::new(16, values).unwrap().normalized()).unwrap()
}

fn pose() -> RigidMotion {
    RigidMotion::new(Vector3::new(2.0, -1.0, 0.5), Vector3::new(0.4, 1.0, -0.3))
}

#[test]
fn half_overlapping_scans_are_brought_together() {
    let (a, b) = (scan(1, 0.0..0.7, &RigidMotion::identity()), scan(1, 0.3..1.0, &pose()));
    let none = Surface::default();
    let inputs = [&a, &b].map(|features| ScanInput::new(features, &none));
    let config = EstimatorConfig::default();
    let pairwise = EdgeRegistrar::new(&inputs, &config, LENGTHS, 0);
    let found = pairwise.register(ScanId(0), ScanId(1));
    let (_, first_is_target) = pairwise.key(ScanId(0), ScanId(1));
    let a_from_b = if first_is_target { found } else { found.reversed() }.target_from_source;
    assert!(rotation_error_rad(&a_from_b, &pose().inverse()) < 1e-4);
    assert!(translation_error_m(&a_from_b, &pose().inverse()) < 1e-4);
    // Every shared point is a match, and only those.
    let shared = world(1).0.iter().filter(|p| (0.3..0.7).contains(&p.x)).count();
    assert!(
        found.inliers >= shared && found.inliers <= shared + shared / 10,
        "{} of {shared}",
        found.inliers
    );
    assert!(found.residual_m < 0.01);
    // Shared points have a counterpart; some others lie within τ of one by chance.
    let least = 2.0 * shared as f64 / (a.len() + b.len()) as f64;
    assert!(found.overlap >= least && found.overlap < least + 0.25, "{} of {least}", found.overlap);

    // What the scans are called, and who is named first, means nothing.
    assert_eq!(pairwise.register(ScanId(1), ScanId(0)), found);
    let swapped = [inputs[1], inputs[0]];
    let again = EdgeRegistrar::new(&swapped, &config, LENGTHS, 0);
    assert_eq!(again.register(ScanId(0), ScanId(1)), found);
    assert_eq!(again.key(ScanId(1), ScanId(0)), pairwise.key(ScanId(0), ScanId(1)));
}

#[test]
fn the_median_distance_is_that_of_the_surfaces_where_they_overlap() {
    // The keypoints agree exactly, so that the motion is the identity. The surfaces are two
    // 1 m floors 3 cm apart; the second goes on 2 m to where the first has nothing.
    let features = scan(2, 0.0..1.0, &RigidMotion::identity());
    let floor = |length: usize, z: f32| Surface {
        points: (0..length * 40)
            .map(|i| Point::new((i / 40) as f32 * 0.025, (i % 40) as f32 * 0.025, z))
            .collect(),
        normals: vec![Direction::z(); length * 40],
        viewpoint: Point::new(0.5, 0.5, 1.0),
        ..Surface::default()
    };
    let (near, far) = (floor(40, 0.0), floor(120, 0.03));
    let inputs = [&near, &far].map(|surface| ScanInput::new(&features, surface));
    let config = EstimatorConfig::default();
    let found = EdgeRegistrar::new(&inputs, &config, LENGTHS, 0).register(ScanId(0), ScanId(1));
    assert!(found.target_from_source.translation.vector.norm() < 1e-5);
    assert!((found.median_distance_m - 0.03).abs() < 1e-4, "{}", found.median_distance_m);
}

#[test]
fn strangers_have_next_to_nothing_in_common() {
    let (a, b) = (scan(3, 0.0..1.0, &RigidMotion::identity()), scan(4, 0.0..1.0, &pose()));
    let none = Surface::default();
    let inputs = [&a, &b].map(|features| ScanInput::new(features, &none));
    let config = EstimatorConfig::default();
    let found = EdgeRegistrar::new(&inputs, &config, LENGTHS, 0).register(ScanId(0), ScanId(1));
    assert!(found.inliers < 12, "{} of {} matches", found.inliers, found.matches);
}

#[test]
fn a_scan_of_two_keypoints_cannot_be_registered() {
    let (a, b) = (scan(5, 0.0..1.0, &RigidMotion::identity()), scan(5, 0.0..1.0, &pose()).select(&[0, 1]));
    let none = Surface::default();
    let inputs = [&a, &b].map(|features| ScanInput::new(features, &none));
    let config = EstimatorConfig::default();
    let pairwise = EdgeRegistrar::new(&inputs, &config, LENGTHS, 0);
    assert_eq!(pairwise.unusable(ScanId(0)), None);
    assert!(matches!(
        pairwise.unusable(ScanId(1)),
        Some(DeclineReason::TooFewKeypoints { keypoints: 2, .. })
    ));
    let failed = pairwise.register(ScanId(0), ScanId(1));
    assert_eq!((failed.inliers, failed.overlap), (0, 0.0));
    assert!(failed.median_distance_m.is_infinite());
}
