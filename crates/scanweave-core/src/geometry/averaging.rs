//! Averages of several observations of one pose (Li et al. 2025, algorithm 1).

use super::rigid::{RigidMotion, motion, nearest_rotation};
use nalgebra::{Matrix3, SMatrix, Vector3};

type Vector9 = SMatrix<f64, 9, 1>;

/// Weighted geometric median of rotations (Weiszfeld iteration in R⁹), started at
/// `start`, then projected to SO(3).
///
/// Each round moves `s ← s + Σ(wᵢvᵢ/dᵢ)/Σ(wᵢ/dᵢ)` with `vᵢ = vec(Rᵢ) − s`, `dᵢ = ‖vᵢ‖`.
/// Stops after `max_rounds` or when a step is shorter than `tolerance`. An observation
/// that `s` lies on attracts it with a bounded weight instead of an infinite one.
/// Source: Lee & Civera, robust single rotation averaging, as used by Li et al. 2025
/// (their printed update drops `s +`).
pub fn rotation_median(
    start: &Matrix3<f64>,
    observations: &[(Matrix3<f64>, f64)],
    max_rounds: usize,
    tolerance: f64,
) -> Option<nalgebra::Rotation3<f64>> {
    const SMALLEST_DISTANCE: f64 = 1e-9;
    let mut s = Vector9::from_column_slice(start.as_slice());
    for _ in 0..max_rounds {
        let (mut step, mut weight) = (Vector9::zeros(), 0.0);
        for (r, w) in observations {
            let v = Vector9::from_column_slice(r.as_slice()) - s;
            let pull = w / v.norm().max(SMALLEST_DISTANCE);
            step += v * pull;
            weight += pull;
        }
        if weight <= 0.0 {
            break;
        }
        step /= weight;
        s += step;
        if step.norm() < tolerance {
            break;
        }
    }
    nearest_rotation(&Matrix3::from_column_slice(s.as_slice()))
}

/// Average of pose observations `(target_from_source, weight)` around a first estimate:
/// the rotation by [`rotation_median`], the translation as the weighted least-squares
/// solution of `R̄ R̂ᵢᵀ t̂ᵢ = t`, that is of `‖t̂ᵢ − R̂ᵢ R̄ᵀ t‖`.
///
/// Returns `None` without an observation of positive weight.
pub fn average_motion(
    start: &RigidMotion,
    observations: &[(RigidMotion, f64)],
    max_rounds: usize,
    tolerance: f64,
) -> Option<RigidMotion> {
    let total: f64 = observations.iter().map(|o| o.1).sum();
    if total.is_nan() || total <= 0.0 {
        return None;
    }
    let matrix = |t: &RigidMotion| t.rotation.to_rotation_matrix().into_inner();
    let rotations: Vec<_> = observations.iter().map(|(t, w)| (matrix(t), *w)).collect();
    let mean = rotation_median(&matrix(start), &rotations, max_rounds, tolerance)?;
    let mut t = Vector3::zeros();
    for ((observed, w), (r, _)) in observations.iter().zip(&rotations) {
        t += mean.matrix() * r.transpose() * observed.translation.vector * *w;
    }
    Some(motion(mean, t / total))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::Rotation3;

    fn about_z(deg: f64) -> Matrix3<f64> {
        Rotation3::from_axis_angle(&Vector3::z_axis(), deg.to_radians()).into_inner()
    }

    #[test]
    fn median_of_three_rotations_about_one_axis_is_the_middle_one() {
        // In R⁹ the three lie on one circle and the heaviest observation holds more than
        // half of the weight: the geometric median is that observation itself.
        let observations = [(about_z(10.0), 1.0), (about_z(12.0), 5.0), (about_z(90.0), 1.0)];
        let r = rotation_median(&about_z(0.0), &observations, 200, 1e-12).unwrap();
        assert_relative_eq!(*r.matrix(), about_z(12.0), epsilon = 1e-6);
    }

    #[test]
    fn an_update_without_the_old_value_would_fail_here() {
        // The printed algorithm replaces s by the mean residual; with identical observations
        // away from the start that gives residual, rotation, residual … instead of the rotation.
        let observations = [(about_z(30.0), 1.0); 3];
        for rounds in [1, 2, 3, 10] {
            let r = rotation_median(&about_z(0.0), &observations, rounds, 0.0).unwrap();
            assert_relative_eq!(*r.matrix(), about_z(30.0), epsilon = 1e-9);
        }
    }

    #[test]
    fn one_outlier_among_five_moves_the_median_less_than_the_mean() {
        let mut observations = [-1.0, -0.5, 0.5, 1.0].map(|d| (about_z(d), 1.0)).to_vec();
        observations.push((about_z(120.0), 1.0));
        let r = rotation_median(&about_z(0.0), &observations, 100, 1e-9).unwrap();
        assert!(r.angle().to_degrees() < 1.0, "median moved by {}°", r.angle().to_degrees());
    }

    #[test]
    fn translation_is_averaged_after_each_rotation_is_taken_out() {
        // Every observation is the truth followed by a small own rotation E: t̂ = E t, R̂ = E R.
        // Then R̄ R̂ᵀ t̂ = R̄ Rᵀ t exactly, so a symmetric pair gives t back.
        let truth = RigidMotion::new(Vector3::new(5.0, -1.0, 2.0), Vector3::new(0.2, 0.1, -0.4));
        let tilt = |a: f64| RigidMotion::rotation(Vector3::new(0.0, 0.0, a));
        let observations = [(tilt(0.05) * truth, 1.0), (tilt(-0.05) * truth, 1.0)];
        let mean = average_motion(&truth, &observations, 50, 1e-12).unwrap();
        assert_relative_eq!(mean.translation.vector, truth.translation.vector, epsilon = 1e-9);
        assert!(mean.rotation.angle_to(&truth.rotation) < 1e-7);
        assert!(average_motion(&truth, &[], 10, 1e-3).is_none());
    }
}
