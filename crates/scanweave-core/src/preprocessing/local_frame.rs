//! A frame that belongs to the shape of a scan and not to the coordinates of its file.
//!
//! Voxel grids, single precision and the order in which things are drawn all depend on where zero
//! lies and how the axes point. Every scan is therefore worked on in a frame of its own: zero at
//! its geometric median, axes along its principal directions, and a point that a file holds twice
//! counted once. A rigid motion of a file's coordinates then changes its pose and nothing else.

use crate::geometry::rigid::RigidMotion;
use crate::geometry::{Point, occupancy::distinct_positions};
use crate::scan::{PointCloud, Scan};
use nalgebra::{Isometry3, Matrix3, Rotation3, SymmetricEigen, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use std::borrow::Cow;

/// Steps towards the geometric median. Each starts from the mean and is as invariant as the last:
/// nothing depends on how near they come.
const MEDIAN_STEPS: usize = 16;
/// Points that fix the frame at most.
const MOST_POINTS: usize = 1 << 18;

/// Scans in their own frames, and `scan_from_local` of each: `scan` are the coordinates of the file.
pub fn localize(scans: &[Scan]) -> (Vec<Scan>, Vec<RigidMotion>) {
    scans.par_iter().map(localized).unzip()
}

/// The zero of a file's coordinates in the frame of its scan.
pub fn file_zero(scan_from_local: &RigidMotion) -> Point {
    (scan_from_local.inverse() * nalgebra::Point3::origin()).cast()
}

/// The points of a scan in its own frame, repeated ones too.
pub fn local_points(scan: &Scan, scan_from_local: &RigidMotion) -> Vec<Point> {
    let local_from_points = scan_from_local.inverse() * scan.cloud.file_from_points();
    scan.cloud.points.iter().map(|p| (local_from_points * p.cast::<f64>()).cast()).collect()
}

fn localized(scan: &Scan) -> (Scan, RigidMotion) {
    let cloud = without_repetitions(&scan.cloud);
    let points_from_local = own_frame(&cloud.points);
    // Moved in double precision: the median may be far from the zero of the points.
    let local_from_points = points_from_local.inverse();
    let moved = |p: &Point| (local_from_points * p.cast::<f64>()).cast::<f32>();
    let viewpoint = cloud.viewpoint.as_ref().map(moved);
    let local = PointCloud {
        points: cloud.points.iter().map(moved).collect(),
        colors: cloud.colors.clone(),
        viewpoint,
        dropped_rows: cloud.dropped_rows,
        stray_points: cloud.stray_points,
        ..PointCloud::default()
    };
    let scan_from_local = scan.cloud.file_from_points() * points_from_local;
    let scan = Scan {
        id: scan.id,
        name: scan.name.clone(),
        path: scan.path.clone(),
        part: scan.part,
        initial_pose: scan.initial_pose.map(|world_from_scan| world_from_scan * scan_from_local),
        cloud: local,
    };
    (scan, scan_from_local)
}

/// The cloud with one point at every position; of several colours there the least.
fn without_repetitions(cloud: &PointCloud) -> Cow<'_, PointCloud> {
    /// Share of repeated points below which they change nothing that matters.
    const UNFELT: f64 = 0.01;
    let n = cloud.points.len();
    if distinct_positions(&cloud.points) as f64 >= (1.0 - UNFELT) * n as f64 {
        return Cow::Borrowed(cloud);
    }
    let colors = cloud.colors.as_deref();
    let key = |i: u32| {
        let p = &cloud.points[i as usize];
        let bits = [p.x, p.y, p.z].map(|v| (v + 0.0).to_bits());
        (bits, colors.map(|c| c[i as usize]), i)
    };
    let mut order: Vec<u32> = (0..n as u32).collect();
    order.sort_unstable_by_key(|&i| key(i));
    order.dedup_by_key(|i| key(*i).0);
    order.sort_unstable();
    Cow::Owned(PointCloud {
        points: order.iter().map(|&i| cloud.points[i as usize]).collect(),
        colors: colors.map(|c| order.iter().map(|&i| c[i as usize]).collect()),
        intensities: None,
        normals: None,
        ..*cloud
    })
}

/// `points_from_local`: the geometric median as zero, principal directions as axes, the longest
/// first, each turned to where more lies far out. The identity without points.
fn own_frame(points: &[Point]) -> RigidMotion {
    if points.is_empty() {
        return RigidMotion::identity();
    }
    let step = points.len().div_ceil(MOST_POINTS);
    let sample: Vec<Vector3<f64>> = points.iter().step_by(step).map(|p| p.coords.cast()).collect();
    let centre = geometric_median(&sample);
    let size = median(sample.iter().map(|p| (p - centre).norm()).collect());
    let translation = Translation3::from(centre);
    if !(size > 0.0 && size.is_finite()) {
        return Isometry3::from_parts(translation, UnitQuaternion::identity());
    }
    // What lies far out must not turn the axes: its weight falls faster than its square grows.
    let weighted = || {
        sample.iter().map(|p| {
            let d = (p - centre) / size;
            (d, (1.0 + d.norm_squared()).powi(-2))
        })
    };
    let covariance =
        weighted().fold(Matrix3::zeros(), |sum: Matrix3<f64>, (d, w)| sum + d * d.transpose() * w);
    let eigen = SymmetricEigen::new(covariance);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let axis = |k: usize| {
        let axis: Vector3<f64> = eigen.eigenvectors.column(order[k]).into_owned();
        let skew: f64 = weighted().map(|(d, w)| w * d.dot(&axis).powi(3)).sum();
        if skew < 0.0 { -axis } else { axis }
    };
    let (first, second) = (axis(0), axis(1));
    let third = first.cross(&second);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[first, second, third]));
    Isometry3::from_parts(translation, UnitQuaternion::from_rotation_matrix(&rotation))
}

/// A few steps of Weiszfeld's algorithm from the mean.
fn geometric_median(points: &[Vector3<f64>]) -> Vector3<f64> {
    let mut centre = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    for _ in 0..MEDIAN_STEPS {
        let (mut sum, mut weight) = (Vector3::zeros(), 0.0);
        for p in points {
            let w = 1.0 / (p - centre).norm().max(f64::MIN_POSITIVE.sqrt());
            sum += p * w;
            weight += w;
        }
        centre = sum / weight;
    }
    centre
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A lopsided cloud of three unlike widths.
    fn cloud(n: usize, seed: u64) -> Vec<[f64; 3]> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = |width: f64| width * (-rng.random_range(1e-3f64..1.0).ln());
        (0..n).map(|_| [draw(2.0), draw(1.0), draw(0.4)]).collect()
    }

    fn moved(points: &[[f64; 3]], motion: &RigidMotion) -> Vec<[f64; 3]> {
        points.iter().map(|p| (motion * nalgebra::Point3::from(*p)).coords.into()).collect()
    }

    #[test]
    fn a_motion_of_the_file_moves_the_frame_and_not_the_local_points() {
        let points = cloud(4000, 1);
        let motions = [
            RigidMotion::new(Vector3::new(1e6, -4e5, 381.0), Vector3::new(1.0, -2.0, 0.5)),
            RigidMotion::new(Vector3::new(0.0, 0.0, 381.0), Vector3::zeros()),
            RigidMotion::rotation(Vector3::new(0.0, 3.0, 0.2)),
        ];
        let scan = |points: &[[f64; 3]]| Scan::from_points("a", points);
        let (here, frames) = localize(&[scan(&points)]);
        for motion in motions {
            let (there, there_frames) = localize(&[scan(&moved(&points, &motion))]);
            for (p, q) in here[0].cloud.points.iter().zip(&there[0].cloud.points) {
                assert!((p - q).norm() < 1e-5, "{p} {q}");
            }
            let expected = motion * frames[0];
            // A tenth of a micrometre of a double at a thousand kilometres.
            assert!((expected.translation.vector - there_frames[0].translation.vector).norm() < 2e-6);
            assert!(expected.rotation.angle_to(&there_frames[0].rotation) < 1e-6);
        }
    }

    #[test]
    fn a_point_that_is_there_twice_counts_once_and_a_wild_one_turns_nothing() {
        let points = cloud(3000, 2);
        let doubled: Vec<[f64; 3]> = points.iter().chain(&points[..1000]).copied().collect();
        let mut wild = points.clone();
        wild.push([1e10, 1e10, -1e10]);
        let one = |points: &[[f64; 3]]| localize(&[Scan::from_points("a", points)]);
        let (plain, plain_frame) = one(&points);
        let (twice, twice_frame) = one(&doubled);
        assert_eq!(plain[0].cloud.points, twice[0].cloud.points);
        assert_eq!(plain_frame, twice_frame);
        let (_, frame) = one(&wild);
        assert!((frame[0].translation.vector - plain_frame[0].translation.vector).norm() < 0.01);
        assert!(frame[0].rotation.angle_to(&plain_frame[0].rotation) < 0.01);
    }

    #[test]
    fn clouds_without_shape_have_a_frame() {
        let at = |points: Vec<Point>| Scan { cloud: PointCloud::from_points(points), ..Scan::default() };
        let (_, frames) = localize(&[at(vec![]), at(vec![Point::new(1.0, 2.0, 3.0); 5])]);
        assert_eq!(frames[0], RigidMotion::identity());
        assert!((frames[1].translation.vector - Vector3::new(1.0, 2.0, 3.0)).norm() < 1e-9);
    }
}
