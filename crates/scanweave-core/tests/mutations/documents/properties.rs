//! What holds of everything that was read.

use scanweave_core::geometry::RigidMotion;
use scanweave_core::io::{PointBlocks, ReadOptions, open_blocks, read_file};
use scanweave_core::nalgebra::Vector3;
use scanweave_core::scan::Features;
use scanweave_core::{PointCloud, Result};
use std::path::Path;

/// Reads a file of scans, whole and block by block; says whether it is one.
pub fn check_file(path: &Path, options: &ReadOptions) -> bool {
    let read = read_file(path, options);
    if let Ok(file) = &read {
        assert!(!file.scans.is_empty(), "a file of no scan");
        for scan in &file.scans {
            check_cloud(&scan.cloud);
            scan.pose.iter().for_each(check_pose);
        }
    }
    let parts = read.as_ref().map_or(1, |file| file.scans.len());
    for part in 0..parts {
        let Ok(Some(mut blocks)) = open_blocks(path, part, options) else { continue };
        let together = joined(&mut *blocks);
        if let (Ok(file), Ok(together)) = (&read, &together) {
            same_points(&file.scans[part].cloud, together);
        }
        if let (Ok(file), Err(error)) = (&read, &together) {
            panic!("{} points are read at once, and in blocks: {error}", file.scans[part].cloud.len());
        }
    }
    read.is_ok()
}

/// Steps of the least numbers of single precision, a thousand times as large in another unit.
const LEAST: f64 = 1e-42;

type Blocks = (Vec<Vector3<f64>>, Vec<f64>);

/// All points of the blocks in the coordinates of the file, and by how much single precision may be off.
fn joined(blocks: &mut dyn PointBlocks) -> Result<Blocks> {
    let mut all = Blocks::default();
    blocks.for_each(&mut |block| {
        check_cloud(&block);
        all.0.extend((0..block.len()).map(|i| in_file(&block, i)));
        all.1.extend((0..block.len()).map(|i| rounding(&block, i)));
        Ok(())
    })?;
    Ok(all)
}

fn in_file(cloud: &PointCloud, i: usize) -> Vector3<f64> {
    cloud.points[i].coords.cast::<f64>() + cloud.origin_m
}

/// The distance of neighbouring numbers of single precision, and of double precision at the origin.
fn rounding(cloud: &PointCloud, i: usize) -> f64 {
    f64::from(cloud.points[i].coords.amax()) * f64::from(f32::EPSILON)
        + cloud.origin_m.amax() * 4.0 * f64::EPSILON
        + LEAST
}

/// Several rows at zero are directions without a return: only all of the rows tell that, so that blocks have them.
fn same_points(whole: &PointCloud, (points, roundings): &Blocks) {
    // Near the end of single precision a point is finite beside one origin and not beside another.
    const NEAR_THE_END: f64 = 1e37;
    let at_once = (0..whole.len()).map(|i| in_file(whole, i));
    if points.iter().copied().chain(at_once).any(|p| p.amax() > NEAR_THE_END) {
        return;
    }
    let most = (0..whole.len()).map(|i| rounding(whole, i)).fold(0.0, f64::max);
    let mut next = 0;
    for (row, (point, off)) in points.iter().zip(roundings).enumerate() {
        let apart = off + most;
        let same = next < whole.len() && (point - in_file(whole, next)).amax() <= apart;
        // A zero may have been taken for a point that is hardly away from it.
        assert!(same || point.amax() <= 2.0 * apart, "row {row} in blocks is not point {next} at once");
        next += usize::from(same);
    }
    assert_eq!(next, whole.len(), "points in blocks, and at once");
}

/// Points are finite, and everything else is there for every point.
pub fn check_cloud(cloud: &PointCloud) {
    let n = cloud.len();
    assert!(cloud.points.iter().all(|p| finite(p.coords.as_slice())), "a point that is not finite");
    assert!(finite(cloud.origin_m.as_slice()), "the origin {}", cloud.origin_m);
    assert!(
        cloud.viewpoint.is_none_or(|v| finite(v.coords.as_slice())),
        "the viewpoint {:?}",
        cloud.viewpoint
    );
    let lengths = [
        ("colours", cloud.colors.as_ref().map(Vec::len)),
        ("intensities", cloud.intensities.as_ref().map(Vec::len)),
        ("normals", cloud.normals.as_ref().map(Vec::len)),
    ];
    for (what, length) in lengths {
        assert!(length.is_none_or(|length| length == n), "{length:?} {what} of {n} points");
    }
}

/// A rotation and a translation of finite numbers.
pub fn check_pose(pose: &RigidMotion) {
    let length = pose.rotation.coords.norm();
    assert!((length - 1.0).abs() < 1e-6, "a rotation of a quaternion of length {length}");
    assert!(finite(pose.translation.vector.as_slice()), "a translation {}", pose.translation);
}

/// As many of all parts, and numbers.
pub fn check_features(features: &Features) {
    let n = features.len();
    assert_eq!(features.descriptors.len(), n, "descriptors");
    assert!(features.normals.as_ref().is_none_or(|normals| normals.len() == n), "normals of {n} keypoints");
    assert!(features.keypoints.iter().all(|p| finite(p.coords.as_slice())), "a keypoint that is not finite");
    assert!(finite(features.descriptors.values()), "a descriptor that is not finite");
}

/// Whether all numbers are.
pub fn finite<T: Copy + Into<f64>>(values: &[T]) -> bool {
    values.iter().all(|&v| v.into().is_finite())
}
