//! Samples of a walk with a depth camera: the ScanNet protocol's scans.

use crate::Monitor;
use crate::geometry::RigidMotion;
use crate::io::SceneWriter;
use crate::io::{self, PlyCloud};
use crate::random::generator;
use crate::{Error, Result};
use rand::seq::SliceRandom;
use rayon::prelude::*;
use std::path::Path;

const STAGE: &str = "sampling frames";

/// Which frames are taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SampleConfig {
    /// Frames taken; the published protocol has 30.
    pub frames: usize,
    /// Frames from one to the next; the published protocol has 20.
    pub every: usize,
    /// The first of them, counted from 0 in sorted order.
    pub first_frame: usize,
    /// Decides the order of the scans.
    pub seed: u64,
}

impl Default for SampleConfig {
    fn default() -> Self {
        Self { frames: 30, every: 20, first_frame: 0, seed: 0 }
    }
}

impl SampleConfig {
    /// The frames to take of a walk of `total`, in the walk's order.
    ///
    /// # Errors
    /// [`Error::Setting`] when a number is zero, or when the walk is too short: it then names the
    /// largest numbers that fit.
    pub fn picked(&self, total: usize) -> Result<Vec<usize>> {
        for (key, value, least) in [("frames", self.frames, 2), ("every", self.every, 1)] {
            if value < least {
                let remedy = "give a larger number";
                return Err(Error::setting(key, value.to_string(), format!("at least {least}"), remedy));
            }
        }
        let left = total.saturating_sub(self.first_frame);
        let steps = self.frames - 1;
        if left > 0 && steps.checked_mul(self.every).is_some_and(|span| span < left) {
            return Ok((0..self.frames).map(|k| self.first_frame + k * self.every).collect());
        }
        let most = left.div_ceil(self.every);
        let remedy = match (left.saturating_sub(1) / steps, most) {
            (0, 0..2) => "start earlier, or name a longer walk".to_owned(),
            (0, most) => format!("take at most {most} frames"),
            (every, 0..2) => format!("take frames at most {every} apart"),
            (every, most) => format!("take frames at most {every} apart, or at most {most} of them"),
        };
        Err(Error::setting(
            "frames",
            format!("{} of them {} apart", self.frames, self.every),
            format!("what fits into the {left} frames from frame {} on", self.first_frame),
            remedy,
        ))
    }
}

/// Writes frames of the walk in `folder` as scans with their poses in the 3DMatch layout into
/// `output`, numbered at random so that the order of the walk is forgotten.
///
/// Returns the frame of every scan, by the scan's number.
///
/// # Errors
/// A walk that is too short, frames or poses that cannot be used, output that cannot be
/// written, or the user asked to stop. Nothing is then left in `output`.
pub fn write_sample(
    folder: &Path,
    output: &Path,
    replace: bool,
    config: &SampleConfig,
    monitor: &dyn Monitor,
) -> Result<Vec<usize>> {
    let scene = io::read_scene(folder)?;
    let poses = &scene.true_poses(folder)?.value;
    let mut picked = config.picked(scene.scans.len())?;
    picked.shuffle(&mut generator(config.seed, "order of a sample", 0));
    let writer = SceneWriter::begin(output, replace)?;
    monitor.begin(STAGE, picked.len());
    let written: Vec<Result<()>> = picked
        .par_iter()
        .enumerate()
        .map(|(number, &frame)| {
            monitor.check(STAGE)?;
            let path = &scene.scans[frame];
            let cloud = io::read_cloud(path)?;
            if cloud.is_empty() {
                let remedy = "choose other frames";
                return Err(Error::file(path, "no measurement", "at least one finite point", remedy));
            }
            // A pose of the file's coordinates, moved to those of the points.
            let origin = RigidMotion::from_parts(cloud.origin_m.into(), nalgebra::UnitQuaternion::identity());
            let ply =
                PlyCloud { points: &cloud.points, colors: cloud.colors.as_deref(), ..PlyCloud::default() };
            let from = format!("{}\t frame\t {frame}\t {frame}", scene.name);
            writer.add(number, &ply, &(poses[frame] * origin), &from)?;
            monitor.advance(1);
            Ok(())
        })
        .collect();
    monitor.end();
    written.into_iter().collect::<Result<()>>()?;
    writer.finish()?;
    Ok(picked)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_picked_evenly_or_the_largest_setting_is_named() {
        let config = |frames, every, first_frame| SampleConfig { frames, every, first_frame, seed: 0 };
        // The last of 30 frames 20 apart is the 581st.
        assert_eq!(config(30, 20, 0).picked(581).unwrap().last(), Some(&580));
        let refused = |c: SampleConfig, total| c.picked(total).unwrap_err().to_string();
        assert!(refused(config(30, 20, 0), 580).contains("at most 19 apart, or at most 29 of them"));
        assert_eq!(config(30, 19, 0).picked(580).unwrap().len(), 30);
        assert_eq!(config(29, 20, 0).picked(580).unwrap().len(), 29);
        assert_eq!(config(3, 2, 5).picked(10).unwrap(), [5, 7, 9]);
        assert!(refused(config(3, 2, 5), 9).contains("the 4 frames from frame 5 on"));
        assert!(refused(config(30, 20, 0), 21).contains("take at most 2 frames"));
        assert!(refused(config(2, 20, 0), 1).contains("start earlier"));
        assert!(refused(config(2, 20, 9), 3).contains("start earlier"));
        assert!(refused(config(2, 0, 0), 3).contains("every: found 0"));
        assert!(refused(config(1, 1, 0), 3).contains("frames: found 1"));
        assert!(config(usize::MAX, 2, 0).picked(3).is_err());
    }
}
