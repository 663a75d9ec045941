//! Depth images with poses, fused into scans of several frames.

use super::{PosedScans, RgbdEntry};
use crate::Monitor;
use crate::geometry::PointMover;
use crate::geometry::voxel_means;
use crate::geometry::{Point, RigidMotion};
use crate::io;
use crate::scan::{PointCloud, Scan, ScanId};
use crate::{Error, Result};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Scans of a stretch of frames: points of every group of consecutive frames, moved by the frames'
/// poses into the camera of the middle frame and averaged over voxels.
///
/// # Errors
/// When frames or poses cannot be read, or the stretch has no frame.
pub(super) fn fuse(entry: &RgbdEntry, root: &Path, monitor: &dyn Monitor) -> Result<PosedScans> {
    const STAGE: &str = "fusing depth images";
    let folder = root.join(&entry.folder);
    let scene = io::read_scene(&folder)?;
    let poses = &scene.true_poses(&folder)?.value;
    let end = scene.scans.len().min(entry.frames.map_or(usize::MAX, |n| entry.first_frame.saturating_add(n)));
    if entry.first_frame >= end {
        return Err(Error::setting(
            "rgbd.first_frame",
            format!("{}, of {} frames in {}", entry.first_frame, scene.scans.len(), folder.display()),
            "a stretch of at least one frame",
            "correct first_frame or frames",
        ));
    }
    let starts: Vec<usize> = (entry.first_frame..end)
        .step_by(entry.fragment_step)
        // A short rest at the end would be a scan unlike the others.
        .filter(|&s| s == entry.first_frame || s + entry.frames_per_fragment <= end)
        .collect();
    monitor.begin(STAGE, starts.len());
    let fragments: Vec<Result<(Scan, RigidMotion)>> = starts
        .par_iter()
        .enumerate()
        .map(|(id, &start)| {
            monitor.check(STAGE)?;
            let frames = start..(start + entry.frames_per_fragment).min(end);
            let middle = poses[frames.start + frames.len() / 2];
            let points = fused_points(&scene.scans[frames.clone()], &poses[frames], &middle, entry)?;
            let cloud = PointCloud::from_points(points);
            monitor.advance(1);
            Ok((Scan { id: ScanId(id), name: format!("frame_{start}"), cloud, ..Scan::default() }, middle))
        })
        .collect();
    monitor.end();
    let fragments: Vec<(Scan, RigidMotion)> = fragments.into_iter().collect::<Result<_>>()?;
    let (scans, world_from_scan) = fragments.into_iter().unzip();
    let (first, each) = (entry.first_frame, entry.frames_per_fragment);
    Ok(PosedScans {
        name: format!("{} frames {first} to {}, {each} a scan", scene.name, end - 1),
        scans,
        world_from_scan,
    })
}

fn fused_points(
    frames: &[PathBuf],
    world_from_frame: &[RigidMotion],
    world_from_middle: &RigidMotion,
    entry: &RgbdEntry,
) -> Result<Vec<Point>> {
    let mut points = Vec::new();
    for (frame, pose) in frames.iter().zip(world_from_frame) {
        let mut cloud = io::read_cloud(frame)?;
        // A depth image is seen from its zero.
        cloud.points.retain(|p| p.coords.norm() <= entry.max_depth_m as f32);
        let middle_from_frame = PointMover::new(&(world_from_middle.inverse() * pose));
        points.extend(middle_from_frame.points(&cloud.points));
    }
    Ok(voxel_means(&points, entry.voxel_m as f32))
}
