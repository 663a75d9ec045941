//! What files of terrestrial scanners share: a sensor at the zero of its scan, and a pose of every scan.

use super::scan_file::StoredScan;
use crate::geometry::RigidMotion;
use crate::scan::PointCloud;

/// Points looked at to see where a scan lies.
const SAMPLES: usize = 1001;
/// A scanner sees around itself, so that its place lies within its points. A crop of a scan may lie aside
/// of it by its own size or two. Coordinates of a map or a building site are hundreds of times further away.
const FAR_IN_SIZES: f32 = 5.0;

/// Forgets a viewpoint that lies further from the points than [`FAR_IN_SIZES`] times their extent, and
/// says whether it did: the points are then not in the scanner's coordinates.
pub(super) fn drop_implausible_viewpoint(cloud: &mut PointCloud) -> bool {
    let Some(viewpoint) = cloud.viewpoint else { return false };
    let step = cloud.len().div_ceil(SAMPLES).max(1);
    let (mut size, mut distance) = (0.0f32, 0.0f32);
    for axis in 0..3 {
        let mut values: Vec<f32> = cloud.points.iter().step_by(step).map(|p| p[axis]).collect();
        values.sort_unstable_by(f32::total_cmp);
        // A hundredth at either end is left out: stray returns must not widen the box.
        let tail = values.len() / 100;
        let (Some(low), Some(high)) = (values.get(tail), values.iter().rev().nth(tail)) else { return false };
        size = size.hypot(high - low);
        distance = distance.hypot((low - viewpoint[axis]).max(viewpoint[axis] - high).max(0.0));
    }
    let far = distance > FAR_IN_SIZES * size;
    if far {
        cloud.viewpoint = None;
    }
    far
}

/// Forgets the poses of several scans that are all the identity: what programs write where nothing is
/// registered yet.
pub(super) fn drop_poses_that_say_nothing(scans: &mut [StoredScan]) {
    let identity = RigidMotion::identity();
    if scans.len() > 1 && scans.iter().all(|scan| scan.pose.is_none_or(|pose| pose == identity)) {
        scans.iter_mut().for_each(|scan| scan.pose = None);
    }
}

/// The rows with those at zero as NaN, where there are several: many writers put directions without a
/// return there, and no two points of a scan are the same to the last digit.
///
/// They would be points at the sensor, and where the others are far from zero they stretch the scan.
pub(super) fn without_zeros(rows: usize, xyz_m: impl Fn(usize) -> [f64; 3]) -> impl Fn(usize) -> [f64; 3] {
    let is_zero = |i: usize| xyz_m(i) == [0.0; 3];
    let several = (0..rows).filter(|&i| is_zero(i)).nth(1).is_some() && !(0..rows).all(is_zero);
    move |i| {
        let xyz = xyz_m(i);
        if several && xyz == [0.0; 3] { [f64::NAN; 3] } else { xyz }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;

    #[test]
    fn a_viewpoint_far_from_the_points_is_forgotten() {
        // A box of 2 x 2 x 1 m (diagonal 3 m) whose near corner is `away` from zero along x.
        let cloud = |away: f32| {
            let corner =
                |i: usize| Point::new(away + 2.0 * (i & 1) as f32, (i & 2) as f32, (i >> 2 & 1) as f32);
            let mut points: Vec<Point> = (0..800).map(|i| corner(i % 8)).collect();
            // One stray return at zero.
            points.push(Point::origin());
            PointCloud { viewpoint: Some(Point::origin()), ..PointCloud::from_points(points) }
        };
        for (away, far) in [(-1.0, false), (0.0, false), (14.9, false), (15.1, true), (5e5, true)] {
            let mut cloud = cloud(away);
            assert_eq!(drop_implausible_viewpoint(&mut cloud), far, "{away} m away");
            assert_eq!(cloud.viewpoint.is_none(), far);
        }
        assert!(!drop_implausible_viewpoint(&mut PointCloud::default()));
    }

    #[test]
    fn several_rows_at_zero_are_none() {
        let kept = |rows: &[[f64; 3]]| {
            let read = without_zeros(rows.len(), |i| rows[i]);
            (0..rows.len()).filter(|&i| read(i).iter().all(|v| v.is_finite())).collect::<Vec<usize>>()
        };
        assert_eq!(kept(&[[0.0; 3], [0.0, 0.0, 1.0], [-0.0, 0.0, -0.0], [2.0, 0.0, 0.0]]), [1, 3]);
        // One alone may be a point of a model that begins at zero.
        assert_eq!(kept(&[[0.0; 3], [0.0, 0.0, 1.0]]), [0, 1]);
        // Nothing tells what a file of zeros alone is.
        assert_eq!(kept(&[[0.0; 3]; 3]), [0, 1, 2]);
    }

    #[test]
    fn poses_that_are_all_the_identity_say_nothing() {
        let scan = |x: f64| StoredScan {
            pose: Some(RigidMotion::translation(x, 0.0, 0.0)),
            ..StoredScan::default()
        };
        let left = |mut scans: Vec<StoredScan>| {
            drop_poses_that_say_nothing(&mut scans);
            scans.iter().filter(|s| s.pose.is_some()).count()
        };
        assert_eq!(left(vec![scan(0.0), scan(0.0)]), 0);
        assert_eq!(left(vec![scan(0.0), scan(1.0)]), 2);
        // One alone may be the scan that the others are registered to.
        assert_eq!(left(vec![scan(0.0)]), 1);
    }
}
