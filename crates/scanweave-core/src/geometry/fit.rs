//! Closed-form rigid fits to point pairs.

use super::rigid::{RigidMotion, motion, nearest_rotation};
use nalgebra::{Matrix3, Point3, Rotation3, Vector3};

/// Weighted least-squares rigid fit `target_from_source` (Kabsch/Umeyama without scale):
/// minimises Σ wᵢ‖R sᵢ + t − qᵢ‖².
///
/// `pairs` yields `(source, target, weight)`, metres, weights ≥ 0. Returns `None`
/// with fewer than three pairs of positive weight, or when the points lie on a line,
/// where the rotation about that line is not fixed.
pub fn fit_rigid<I>(pairs: I) -> Option<RigidMotion>
where
    I: IntoIterator<Item = (Point3<f64>, Point3<f64>, f64)>,
    I::IntoIter: Clone,
{
    let pairs = pairs.into_iter();
    let (mut total, mut count) = (0.0, 0usize);
    let (mut source_mean, mut target_mean) = (Vector3::zeros(), Vector3::zeros());
    for (s, q, w) in pairs.clone().filter(|p| p.2 > 0.0) {
        total += w;
        count += 1;
        source_mean += s.coords * w;
        target_mean += q.coords * w;
    }
    if count < 3 {
        return None;
    }
    source_mean /= total;
    target_mean /= total;
    let mut covariance = Matrix3::zeros();
    for (s, q, w) in pairs.filter(|p| p.2 > 0.0) {
        covariance += (q.coords - target_mean) * (s.coords - source_mean).transpose() * w;
    }
    let rotation = nearest_rotation(&covariance)?;
    Some(motion(rotation, target_mean - rotation * source_mean))
}

/// Rigid fit to exactly three pairs by aligning the orthonormal frames of both
/// triangles (TRIAD, Black 1964), centred on their centroids.
///
/// Returns `None` when either triangle is degenerate. Faster than an SVD and exact
/// where the triangles are congruent; the cheap proposal of a sample consensus.
pub fn fit_triangle(source: [Point3<f64>; 3], target: [Point3<f64>; 3]) -> Option<RigidMotion> {
    let frame = |p: &[Point3<f64>; 3]| -> Option<Matrix3<f64>> {
        let a = p[1] - p[0];
        let n = a.cross(&(p[2] - p[0]));
        let (la, ln) = (a.norm(), n.norm());
        if !(la > 0.0 && ln > 1e-9 * la * la) {
            return None;
        }
        let (x, z) = (a / la, n / ln);
        Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
    };
    let (fs, ft) = (frame(&source)?, frame(&target)?);
    let rotation = Rotation3::from_matrix_unchecked(ft * fs.transpose());
    let centroid = |p: &[Point3<f64>; 3]| (p[0].coords + p[1].coords + p[2].coords) / 3.0;
    Some(motion(rotation, centroid(&target) - rotation * centroid(&source)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rigid::{rotation_error_rad, translation_error_m};
    use proptest::prelude::*;

    fn any_motion() -> impl Strategy<Value = RigidMotion> {
        prop::array::uniform6(-3.0f64..3.0)
            .prop_map(|v| RigidMotion::new(Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5])))
    }

    const CORNERS: [[f64; 3]; 5] =
        [[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [0.0, 2.0, 0.3], [0.5, 0.4, 1.0], [-0.3, 0.7, 0.2]];

    proptest! {
        #[test]
        fn exact_pairs_give_the_motion_back(truth in any_motion()) {
            let pairs = CORNERS.map(|c| (Point3::from(c), truth * Point3::from(c), 1.0));
            let fitted = fit_rigid(pairs).unwrap();
            prop_assert!(rotation_error_rad(&fitted, &truth) < 1e-7);
            prop_assert!(translation_error_m(&fitted, &truth) < 1e-9);
            let triangle = [0, 1, 2].map(|i| Point3::from(CORNERS[i]));
            let fitted = fit_triangle(triangle, triangle.map(|p| truth * p)).unwrap();
            prop_assert!(rotation_error_rad(&fitted, &truth) < 1e-7);
            prop_assert!(translation_error_m(&fitted, &truth) < 1e-9);
        }

        #[test]
        fn a_planar_set_is_fitted_without_reflection(truth in any_motion()) {
            // Coplanar points leave the SVD a sign to choose; the wrong one mirrors the scan.
            let flat = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.7, 0.9]];
            let pairs = flat.map(|c| Point3::new(c[0], c[1], 0.0)).map(|p| (p, truth * p, 2.0));
            let fitted = fit_rigid(pairs).unwrap();
            prop_assert!(rotation_error_rad(&fitted, &truth) < 1e-7);
        }
    }

    #[test]
    fn zero_weight_pairs_are_ignored() {
        let truth = RigidMotion::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(0.1, 0.2, 0.3));
        let mut pairs = CORNERS.map(|c| (Point3::from(c), truth * Point3::from(c), 1.0));
        pairs[4].1 = Point3::new(100.0, 0.0, 0.0);
        pairs[4].2 = 0.0;
        assert!(translation_error_m(&fit_rigid(pairs).unwrap(), &truth) < 1e-9);
    }

    #[test]
    fn lines_and_too_few_pairs_have_no_fit() {
        let line = [0.0, 1.0, 2.0, 5.0].map(|x| Point3::new(x, 2.0 * x, -x));
        assert!(fit_rigid(line.map(|p| (p, p, 1.0))).is_none());
        assert!(fit_triangle([line[0], line[1], line[2]], [line[0], line[1], line[2]]).is_none());
        assert!(fit_rigid([(Point3::origin(), Point3::origin(), 1.0)]).is_none());
    }
}
