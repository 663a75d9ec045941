//! Scans that fix no pose, whatever they are registered with.

use super::input::{Lengths, MIN_KEYPOINTS, ScanInput};
use crate::geometry::Point;
use crate::scan::strays::middle_and_size;
use crate::scan::{DeclineReason, ScanId};
use nalgebra::{Matrix3, Vector3};

/// The scans that can be registered.
pub(crate) fn usable(scans: &[ScanInput<'_>], lengths: Lengths) -> Vec<ScanId> {
    let is_usable = |&i: &usize| unusable(&scans[i], MIN_KEYPOINTS, lengths.voxel_m).is_none();
    (0..scans.len()).filter(is_usable).map(ScanId).collect()
}

/// Why a scan cannot be registered at all, before anything is tried.
///
/// `voxel_m` is the working resolution: a scan thinner than a third of it is a plane.
pub fn unusable(scan: &ScanInput<'_>, min_keypoints: usize, voxel_m: f64) -> Option<DeclineReason> {
    let keypoints = scan.features.len();
    if keypoints < min_keypoints {
        return Some(DeclineReason::TooFewKeypoints { keypoints, needed: min_keypoints });
    }
    let points = if scan.surface.is_empty() { &scan.features.keypoints } else { &scan.surface.points };
    let [thickness, width, _] = principal_extents_m(&near(points));
    let limit = voxel_m / 3.0;
    if width < limit {
        return Some(DeclineReason::Degenerate { detail: "all its points lie on one line".into() });
    }
    if thickness < limit {
        let detail = format!("all its points lie on one plane (spread across it {thickness:.2e} m)");
        return Some(DeclineReason::Degenerate { detail });
    }
    None
}

/// Points that are not much farther out than half of all are: what floats far from a plane does not make it
/// a shape, and what floats far out along it does not make it one.
fn near(points: &[Point]) -> Vec<Point> {
    /// Times the median distance from the middle. Of a plane or a room evenly seen all are within three.
    const FAR: f64 = 10.0;
    let Some((middle, size_m)) = middle_and_size(points) else { return points.to_vec() };
    points.iter().filter(|p| (p.cast::<f64>() - middle).norm() <= FAR * size_m).copied().collect()
}

/// Standard deviations of a point set along its principal axes, ascending, metres.
fn principal_extents_m(points: &[Point]) -> [f64; 3] {
    let n = points.len().max(1) as f64;
    let mean = points.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords.cast::<f64>()) / n;
    let mut covariance = Matrix3::zeros();
    for p in points {
        let d = p.coords.cast::<f64>() - mean;
        covariance += d * d.transpose();
    }
    let mut extents: [f64; 3] = (covariance / n).symmetric_eigenvalues().map(|v| v.max(0.0).sqrt()).into();
    extents.sort_by(f64::total_cmp);
    extents
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn extents_of_a_box_are_its_closed_form() {
        // Uniform on [0, L]: standard deviation L/√12; a lattice of n points L·√((n+1)/(12(n−1))).
        let points: Vec<Point> = (0..1000)
            .map(|i| Point::new((i % 10) as f32, 2.0 * (i / 10 % 10) as f32, 3.0 * (i / 100) as f32))
            .collect();
        let unit = 9.0 * (11f64 / (12.0 * 9.0)).sqrt();
        let [a, b, c] = principal_extents_m(&points);
        for (found, expected) in [(a, unit), (b, 2.0 * unit), (c, 3.0 * unit)] {
            assert_relative_eq!(found, expected, epsilon = 1e-9);
        }
    }
}
