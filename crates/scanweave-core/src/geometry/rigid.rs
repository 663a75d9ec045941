//! Rigid motions: conversion, errors, application to single-precision points.

use super::{Direction, Point};
use nalgebra::{Isometry3, Matrix3, Matrix4, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// A rotation and a translation, `target_from_source`.
pub type RigidMotion = Isometry3<f64>;

/// The proper rotation nearest to `m` in the Frobenius norm: `U·diag(1,1,det)·Vᵀ` of its SVD.
///
/// Returns `None` when `m` has a non-finite entry or its rank is below two,
/// where the nearest rotation is not unique.
pub fn nearest_rotation(m: &Matrix3<f64>) -> Option<Rotation3<f64>> {
    if m.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let svd = m.svd(true, true);
    let (mut u, s, v_t) = (svd.u?, svd.singular_values, svd.v_t?);
    let largest = s.max();
    if largest <= 0.0 || s.iter().filter(|&&x| x > 1e-12 * largest).count() < 2 {
        return None;
    }
    if (u * v_t).determinant() < 0.0 {
        let weakest = s.imin();
        u.column_mut(weakest).neg_mut();
    }
    Some(Rotation3::from_matrix_unchecked(u * v_t))
}

/// A rigid motion from a 4×4 matrix, and how far its rotation was from orthonormal
/// (largest absolute entry of `RᵀR − I`), so that a caller can report the repair.
///
/// Returns `None` when an entry is not finite, the last row is not `0 0 0 1`,
/// the rotation is a reflection, or it is further than `tolerance` from orthonormal.
pub fn motion_from_matrix(m: &Matrix4<f64>, tolerance: f64) -> Option<(RigidMotion, f64)> {
    if m.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let last = m.row(3);
    if (last[0].abs() + last[1].abs() + last[2].abs() + (last[3] - 1.0).abs()) > 1e-6 {
        return None;
    }
    let r: Matrix3<f64> = m.fixed_view::<3, 3>(0, 0).into_owned();
    let deviation = (r.transpose() * r - Matrix3::identity()).abs().max();
    if deviation > tolerance || r.determinant() < 0.0 {
        return None;
    }
    let t: Vector3<f64> = m.fixed_view::<3, 1>(0, 3).into_owned();
    Some((motion(nearest_rotation(&r)?, t), deviation))
}

/// A rigid motion from its rotation and translation (metres).
pub fn motion(rotation: Rotation3<f64>, translation_m: Vector3<f64>) -> RigidMotion {
    Isometry3::from_parts(Translation3::from(translation_m), UnitQuaternion::from_rotation_matrix(&rotation))
}

/// Angle between two rotations, radians in `[0, π]`.
pub fn rotation_error_rad(a: &RigidMotion, b: &RigidMotion) -> f64 {
    a.rotation.angle_to(&b.rotation)
}

/// Distance between two translations, metres.
pub fn translation_error_m(a: &RigidMotion, b: &RigidMotion) -> f64 {
    (a.translation.vector - b.translation.vector).norm()
}

/// A rigid motion in single precision, for moving many points.
#[derive(Debug, Clone, Copy)]
pub struct PointMover {
    r: Matrix3<f32>,
    t: Vector3<f32>,
}

impl PointMover {
    /// Prepares `target_from_source` for single-precision points.
    pub fn new(target_from_source: &RigidMotion) -> Self {
        let r = target_from_source.rotation.to_rotation_matrix().into_inner().cast::<f32>();
        Self { r, t: target_from_source.translation.vector.cast::<f32>() }
    }

    /// The moved point.
    #[inline]
    pub fn point(&self, p: &Point) -> Point {
        Point::from(self.r * p.coords + self.t)
    }

    /// The turned direction.
    #[inline]
    pub fn direction(&self, d: &Direction) -> Direction {
        self.r * d
    }

    /// All points moved.
    pub fn points(&self, points: &[Point]) -> Vec<Point> {
        points.iter().map(|p| self.point(p)).collect()
    }
}

/// Whether two motions are the same but for what a refinement may change: less than 10° apart,
/// and taking `at` (a place among the source's points) to places less than 4τ apart.
pub fn same_motion(a: &RigidMotion, b: &RigidMotion, at: &Point3<f64>, radius_m: f64) -> bool {
    rotation_error_rad(a, b) < 10f64.to_radians() && (a * at - b * at).norm() < 4.0 * radius_m
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn nearest_rotation_of_a_reflection_is_proper() {
        // diag(1,1,-1) is a reflection; every proper rotation nearest to it has determinant +1.
        let m = Matrix3::from_diagonal(&Vector3::new(3.0, 2.0, -1.0));
        let r = nearest_rotation(&m).unwrap();
        assert_relative_eq!(r.matrix().determinant(), 1.0, epsilon = 1e-12);
        // The weakest axis is the one that turns: closed form for this diagonal case is the identity.
        assert_relative_eq!(*r.matrix(), Matrix3::identity(), epsilon = 1e-12);
    }

    #[test]
    fn rank_one_has_no_nearest_rotation() {
        let m = Matrix3::from_diagonal(&Vector3::new(1.0, 0.0, 0.0));
        assert!(nearest_rotation(&m).is_none());
        assert!(nearest_rotation(&Matrix3::from_element(f64::NAN)).is_none());
    }

    #[test]
    fn a_nearly_orthonormal_matrix_is_repaired_and_the_repair_reported() {
        let mut m = Matrix4::identity();
        m[(0, 0)] = 1.0 + 3e-4; // RᵀR − I = 2·3e-4 to first order
        let (t, deviation) = motion_from_matrix(&m, 1e-3).unwrap();
        assert_relative_eq!(deviation, 6.0009e-4, epsilon = 1e-9);
        assert_relative_eq!(t.rotation.angle(), 0.0, epsilon = 1e-12);
        assert!(motion_from_matrix(&m, 1e-4).is_none());
    }

    #[test]
    fn reflections_and_bad_last_rows_are_refused() {
        let mut m = Matrix4::identity();
        m[(2, 2)] = -1.0;
        assert!(motion_from_matrix(&m, 1e-3).is_none());
        let mut m = Matrix4::identity();
        m[(3, 0)] = 0.5;
        assert!(motion_from_matrix(&m, 1e-3).is_none());
    }

    #[test]
    fn point_mover_agrees_with_double_precision() {
        let t = RigidMotion::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.3, 1.1, -0.7));
        let mover = PointMover::new(&t);
        let p = Point::new(0.4, 5.0, -3.0);
        let exact = t * nalgebra::Point3::new(0.4f64, 5.0, -3.0);
        assert_relative_eq!(mover.point(&p).cast::<f64>(), exact, epsilon = 1e-5);
    }
}
