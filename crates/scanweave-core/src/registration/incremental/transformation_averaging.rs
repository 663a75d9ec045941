//! Transformation averaging of a newly selected scan (Li et al. 2025, algorithm 1).

use crate::geometry::RigidMotion;
use crate::geometry::averaging::average_motion;
use crate::geometry::fit::fit_rigid;
use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::overlap::two_way_overlap;
use crate::geometry::rigid::PointMover;
use crate::registration::config::AveragingConfig;
use rayon::prelude::*;

/// A registered scan: its keypoints, indexed in its own frame with radius τ, and its pose.
#[derive(Clone, Copy)]
pub struct Registered<'a> {
    /// Keypoints, metres, scan frame.
    pub keypoints: &'a RadiusGrid<'a>,
    /// Its pose.
    pub world_from_scan: RigidMotion,
}

/// Averages what every sufficiently overlapping registered scan says about the pose of a new one.
///
/// For each registered scan i with two-way overlap o above the threshold at the first
/// estimate: one closed-form fit on nearest-neighbour pairs within τ, an observation of
/// weight o. With two or more observations their average is returned, otherwise the
/// first estimate. `keypoints` is indexed with radius τ like those of the registered scans.
pub fn average_observations(
    keypoints: &RadiusGrid<'_>,
    first_estimate: &RigidMotion,
    registered: &[Registered<'_>],
    config: &AveragingConfig,
) -> RigidMotion {
    let observations: Vec<(RigidMotion, f64)> = registered
        .par_iter()
        .filter_map(|other| observe(keypoints, first_estimate, other, config.min_overlap))
        .collect();
    if observations.len() < 2 {
        return *first_estimate;
    }
    average_motion(first_estimate, &observations, config.max_rounds, config.tolerance)
        .unwrap_or(*first_estimate)
}

/// One registered scan's observation of `world_from_scan`, weighted by the overlap.
fn observe(
    keypoints: &RadiusGrid<'_>,
    estimate: &RigidMotion,
    other: &Registered<'_>,
    min_overlap: f64,
) -> Option<(RigidMotion, f64)> {
    let other_from_scan = other.world_from_scan.inverse() * estimate;
    let overlap = two_way_overlap(other.keypoints, keypoints, &other_from_scan).ratio;
    if overlap <= min_overlap {
        return None;
    }
    let mover = PointMover::new(&other_from_scan);
    let pairs: Vec<_> = keypoints
        .points()
        .iter()
        .filter_map(|p| {
            let (j, _) = other.keypoints.nearest(&mover.point(p))?;
            Some((p.cast::<f64>(), other.keypoints.points()[j].cast::<f64>(), 1.0))
        })
        .collect();
    Some((other.world_from_scan * fit_rigid(pairs)?, overlap))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use crate::geometry::rigid::{rotation_error_rad, translation_error_m};
    use nalgebra::Vector3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn cloud(seed: u64) -> Vec<Point> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..800).map(|_| Point::from(Vector3::from_fn(|_, _| rng.random_range(-1.0f32..1.0)))).collect()
    }

    #[test]
    fn a_slightly_wrong_estimate_is_pulled_back_to_the_registered_scans() {
        // Three registered copies of the scan at known poses: each fit recovers the truth exactly.
        let points = cloud(1);
        let grid = RadiusGrid::new(&points, 0.07);
        let truth = RigidMotion::new(Vector3::new(0.5, 0.2, 0.0), Vector3::new(0.0, 0.1, 0.3));
        let registered: Vec<_> =
            (0..3).map(|_| Registered { keypoints: &grid, world_from_scan: truth }).collect();
        let wrong = RigidMotion::new(Vector3::new(0.01, -0.01, 0.0), Vector3::new(0.0, 0.0, 0.004)) * truth;
        let config = AveragingConfig::default();
        let average = average_observations(&grid, &wrong, &registered, &config);
        assert!(translation_error_m(&average, &truth) < 1e-5);
        assert!(rotation_error_rad(&average, &truth) < 1e-5);
        // A single observation is not an average: the estimate stays.
        assert_eq!(average_observations(&grid, &wrong, &registered[..1], &config), wrong);
        // Nor do scans count that hardly overlap.
        let far = RigidMotion::translation(1.8, 0.0, 0.0) * truth;
        let apart: Vec<_> = registered.iter().map(|r| Registered { world_from_scan: far, ..*r }).collect();
        assert_eq!(average_observations(&grid, &wrong, &apart, &config), wrong);
    }
}
