//! Stated against true errors of poses: the normalized estimation error squared, NEES (Bar-Shalom, Li,
//! Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, Sec. 5.4).

use super::pose_error::stated_centre;
use super::{mean, median};
use crate::geometry::RigidMotion;
use crate::scan::{Placement, Reconstruction, ScanId};
use nalgebra::{Matrix6, Point3, Vector6};
use serde::{Deserialize, Serialize};

/// Median of χ² with six degrees of freedom over six: that of the NEES of true covariances.
pub const EXPECTED_MEDIAN: f64 = 0.8914;
/// Mean of the NEES of true covariances.
pub const EXPECTED_MEAN: f64 = 1.0;
/// 95 % quantile of χ² with six degrees of freedom.
const QUANTILE_95: f64 = 12.592;

/// NEES of one scan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScanNees {
    /// The scan.
    pub scan: ScanId,
    /// eᵀ Σ⁻¹ e / 6.
    pub nees: f64,
}

/// How the true errors of a result compare with its covariances.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StatedErrorReport {
    /// Scans with a stated covariance that are not left out.
    pub scans: Vec<ScanNees>,
    /// Their median; [`EXPECTED_MEDIAN`] where covariances are true.
    pub median: Option<f64>,
    /// Their mean; [`EXPECTED_MEAN`] where covariances are true.
    pub mean: Option<f64>,
    /// Share of them whose squared error eᵀ Σ⁻¹ e lies below the 95 % quantile of its distribution; 0.95
    /// where covariances are true.
    pub below_quantile_95: Option<f64>,
    /// Scans whose covariance has no inverse; they are not among `scans`.
    pub singular: usize,
}

impl StatedErrorReport {
    /// Compares the poses of all placed scans but the pivots with the true `world_from_scan`. Left out are
    /// scans for which `left_out` holds, and all of a component for whose pivot it does: poses are
    /// stated relative to the pivot.
    pub fn new(
        reconstruction: &Reconstruction,
        truth: &[RigidMotion],
        left_out: impl Fn(ScanId) -> bool,
    ) -> Self {
        let (mut scans, mut singular) = (Vec::new(), 0);
        for (at, outcome) in reconstruction.outcomes.iter().enumerate() {
            let scan = ScanId(at);
            let Some(placement) = outcome.placement() else { continue };
            let Some((pivot, world_from_pivot)) = pivot(reconstruction, placement.component) else {
                continue;
            };
            let covariance = placement.pose_uncertainty.as_ref().and_then(|u| u.covariance);
            let (Some(covariance), Some(centre)) = (covariance, stated_centre(placement)) else { continue };
            if scan == pivot || left_out(scan) || left_out(pivot) {
                continue;
            }
            let expected = world_from_pivot * truth[pivot.0].inverse() * truth[at];
            match nees(&error(&placement.world_from_scan, &expected, &centre), &covariance) {
                Some(nees) => scans.push(ScanNees { scan, nees }),
                None => singular += 1,
            }
        }
        let values: Vec<f64> = scans.iter().map(|s| s.nees).collect();
        let below = values.iter().filter(|&&v| 6.0 * v < QUANTILE_95).count();
        Self {
            median: median(values.clone()),
            mean: mean(&values),
            below_quantile_95: (!values.is_empty()).then(|| below as f64 / values.len() as f64),
            scans,
            singular,
        }
    }
}

/// The scan that a component grew from, and its pose.
fn pivot(reconstruction: &Reconstruction, component: usize) -> Option<(ScanId, RigidMotion)> {
    let placed = reconstruction.outcomes.iter().enumerate();
    let placed = placed.filter_map(|(scan, o)| Some((ScanId(scan), o.placement()?)));
    let members = placed.filter(|(_, p): &(ScanId, &Placement)| p.component == component);
    members.min_by_key(|(_, p)| p.step).map(|(scan, p)| (scan, p.world_from_scan))
}

/// Rotation vector (radians) and displacement of `centre` (metres) from the true to the estimated
/// `world_from_scan`, in the frame of the world.
fn error(estimate: &RigidMotion, truth: &RigidMotion, centre: &Point3<f64>) -> Vector6<f64> {
    let turn = (estimate.rotation * truth.rotation.inverse()).scaled_axis();
    let shift = estimate * centre - truth * centre;
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

/// eᵀ Σ⁻¹ e / 6; `None` where Σ is not positive definite.
fn nees(error: &Vector6<f64>, covariance: &Matrix6<f64>) -> Option<f64> {
    let whitened = covariance.cholesky()?.solve(error);
    Some(error.dot(&whitened) / 6.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{Outcome, PoseUncertainty};
    use approx::assert_relative_eq;
    use nalgebra::{Matrix3, Vector3};

    fn placed(
        world_from_scan: RigidMotion,
        step: usize,
        covariance: Matrix6<f64>,
        centre: Option<Point3<f64>>,
    ) -> Outcome {
        let uncertainty = PoseUncertainty { weakest_edge: None, covariance: Some(covariance), centre };
        let mut placement = Placement::at(world_from_scan, 0);
        placement.step = step;
        placement.pose_uncertainty = Some(Box::new(uncertainty));
        Outcome::Placed(placement)
    }

    fn truth() -> Vec<RigidMotion> {
        let pose = |x: f64, turn: f64| {
            RigidMotion::new(Vector3::new(x, -0.4 * x, 2.0), Vector3::new(0.3, turn, -1.1 * turn))
        };
        vec![pose(1.0, 0.2), pose(2.0, -0.7), pose(-3.0, 1.3)]
    }

    const CENTRE: Point3<f64> = Point3::new(0.5, -2.0, 4.0);

    /// Variances 0.01² rad² and (0.02, 0.05, 0.1)² m² along the axes of the component's frame.
    fn covariance() -> Matrix6<f64> {
        Matrix6::from_diagonal(&Vector6::new(1e-4, 1e-4, 1e-4, 4e-4, 25e-4, 1e-2))
    }

    /// The true pose in a component's frame, then turned about the centre by `turn` and shifted by `shift`.
    fn disturbed(expected: RigidMotion, turn: Vector3<f64>, shift: Vector3<f64>) -> RigidMotion {
        let centre = (expected * CENTRE).coords;
        let about = RigidMotion::new(centre + shift, turn) * RigidMotion::new(-centre, Vector3::zeros());
        about * expected
    }

    /// A component in the frame `component_from_truth`, with the covariances turned alike.
    fn component(component_from_truth: RigidMotion) -> Reconstruction {
        let frame = component_from_truth.rotation.to_rotation_matrix().into_inner();
        let mut turn = Matrix6::zeros();
        turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&frame);
        turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&frame);
        let covariance = turn * covariance() * turn.transpose();
        let expected: Vec<RigidMotion> = truth().iter().map(|t| component_from_truth * t).collect();
        // One standard deviation about x and two along z; three along y.
        let one = disturbed(expected[1], frame * Vector3::x() * 0.01, frame * Vector3::z() * 0.2);
        let two = disturbed(expected[2], Vector3::zeros(), frame * Vector3::y() * 0.15);
        let outcomes = vec![
            placed(expected[0], 0, Matrix6::zeros(), Some(CENTRE)),
            placed(one, 1, covariance, Some(CENTRE)),
            placed(two, 1, covariance, Some(CENTRE)),
        ];
        Reconstruction::new(outcomes)
    }

    #[test]
    fn known_errors_in_standard_deviations_give_known_nees_in_every_frame() {
        let turned = RigidMotion::new(Vector3::new(-4.0, 9.0, 0.5), Vector3::new(1.0, -0.8, 2.0));
        for frame in [RigidMotion::identity(), truth()[0].inverse(), turned] {
            let r = StatedErrorReport::new(&component(frame), &truth(), |_| false);
            let found: Vec<usize> = r.scans.iter().map(|s| s.scan.0).collect();
            assert_eq!(found, [1, 2]);
            // (1² + 2²)/6 and 3²/6.
            assert_relative_eq!(r.scans[0].nees, 5.0 / 6.0, epsilon = 1e-9);
            assert_relative_eq!(r.scans[1].nees, 1.5, epsilon = 1e-9);
            assert_relative_eq!(r.mean.unwrap(), 7.0 / 6.0, epsilon = 1e-9);
            assert_relative_eq!(r.median.unwrap(), 7.0 / 6.0, epsilon = 1e-9);
            // 5 and 9 are below 12.592.
            assert_eq!((r.below_quantile_95, r.singular), (Some(1.0), 0));
        }
    }

    #[test]
    fn the_share_below_the_quantile_is_that_of_six_degrees_of_freedom() {
        let mut reconstruction = component(RigidMotion::identity());
        // 3.5 and 3.6 standard deviations along y: 12.25 and 12.96 on either side of 12.592.
        for (scan, sigmas) in [(1, 3.5), (2, 3.6)] {
            let pose = disturbed(truth()[scan], Vector3::zeros(), Vector3::y() * 0.05 * sigmas);
            reconstruction.outcomes[scan] = placed(pose, 1, covariance(), Some(CENTRE));
        }
        let r = StatedErrorReport::new(&reconstruction, &truth(), |_| false);
        assert_eq!(r.below_quantile_95, Some(0.5));
    }

    #[test]
    fn what_cannot_be_compared_is_left_out() {
        let with = |outcome: Outcome| {
            let mut reconstruction = component(RigidMotion::identity());
            reconstruction.outcomes[1] = outcome;
            StatedErrorReport::new(&reconstruction, &truth(), |_| false)
        };
        let pose = truth()[1];
        let no_centre = with(placed(pose, 1, covariance(), None));
        assert_eq!((no_centre.scans.len(), no_centre.singular), (1, 0));
        let singular = with(placed(pose, 1, Matrix6::zeros(), Some(CENTRE)));
        assert_eq!((singular.scans.len(), singular.singular), (1, 1));
        // A wrongly placed scan is left out itself, a wrongly placed pivot with all that is stated to it.
        let without = |wrong: usize| {
            StatedErrorReport::new(&component(RigidMotion::identity()), &truth(), |s| s.0 == wrong)
        };
        assert_eq!(without(1).scans.iter().map(|s| s.scan.0).collect::<Vec<_>>(), [2]);
        let none = without(0);
        assert_eq!((none.scans.len(), none.median, none.below_quantile_95), (0, None, None));
    }

    #[test]
    fn correlations_between_turn_and_shift_count() {
        // Σ = [[1, .6], [.6, 1]] of the turn about x and the shift along x, unit variances elsewhere:
        // for e = (1, 1) eᵀ Σ⁻¹ e = 2/1.6, for (1, −1) it is 2/0.4.
        let mut covariance = Matrix6::identity();
        covariance
            .fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&Matrix3::from_diagonal(&Vector3::new(0.6, 0.0, 0.0)));
        covariance
            .fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&Matrix3::from_diagonal(&Vector3::new(0.6, 0.0, 0.0)));
        let of = |shift: f64| nees(&Vector6::new(1.0, 0.0, 0.0, shift, 0.0, 0.0), &covariance).unwrap();
        assert_relative_eq!(of(1.0), 1.25 / 6.0, epsilon = 1e-12);
        assert_relative_eq!(of(-1.0), 5.0 / 6.0, epsilon = 1e-12);
    }
}
