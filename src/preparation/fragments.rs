//! Fragments of a walk with a depth camera, as the 3DMatch test set is made of them.

use crate::Monitor;
use crate::fusion::{FusedSurface, FusionConfig, Volume};
use crate::geometry::RigidMotion;
use crate::io::SceneWriter;
use crate::io::{self, Note, PlyCloud, ReadOptions};
use crate::{Error, Result};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

const STAGE: &str = "fusing depth images";

/// Which frames go into which fragment, and how they are fused.
#[derive(Debug, Clone, PartialEq)]
pub struct FragmentConfig {
    /// Frames fused into one fragment; the published 3DMatch test set uses 50.
    pub frames_per_fragment: usize,
    /// Frames between the starts of fragments that follow each other.
    pub step: usize,
    /// What the images do not say themselves: their unit and intrinsics.
    pub reading: ReadOptions,
    /// How they are fused.
    pub fusion: FusionConfig,
}

impl Default for FragmentConfig {
    fn default() -> Self {
        Self {
            frames_per_fragment: 50,
            step: 50,
            reading: ReadOptions::default(),
            fusion: FusionConfig::default(),
        }
    }
}

/// A fragment that was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fragment {
    /// Its frames, counted from 0 in sorted order.
    pub frames: Range<usize>,
    /// Its points; a fragment without one is not written.
    pub points: usize,
}

/// What images say of how they were read, and how many say it.
pub type Notes = BTreeMap<Note, usize>;

impl FragmentConfig {
    /// The frames of every fragment of a walk of `total` frames. A short rest at the end is left
    /// out unless it is all there is: it would be a scan unlike the others.
    ///
    /// # Errors
    /// [`Error::Setting`] for a number of zero.
    pub fn fragments(&self, total: usize) -> Result<Vec<Range<usize>>> {
        for (key, value) in [("frames per fragment", self.frames_per_fragment), ("step", self.step)] {
            if value == 0 {
                return Err(Error::setting(key, "0", "at least 1", "give a positive number"));
            }
        }
        let starts = (0..total).step_by(self.step);
        let whole = starts.filter(|s| *s == 0 || s + self.frames_per_fragment <= total);
        Ok(whole.map(|s| s..(s + self.frames_per_fragment).min(total)).collect())
    }
}

/// Fuses the depth images of the walk in `folder` into fragments and writes them, numbered in the
/// order of the walk, with their poses in the 3DMatch layout into `output`;
/// with what is worth knowing of how the images were read.
///
/// A fragment is in the frame of its first image's camera, as in 3DMatch (checked: the poses of
/// its kitchen's fragments are those of the frames 0, 50, 100, …). Fragments are made one at a time, so that memory does not grow
/// with the walk.
///
/// # Errors
/// Settings, images or poses that cannot be used; a walk without any surface; output that
/// cannot be written; or the user asked to stop. Nothing is then left in `output`.
pub fn write_fragments(
    folder: &Path,
    output: &Path,
    replace: bool,
    config: &FragmentConfig,
    monitor: &dyn Monitor,
) -> Result<(Vec<Fragment>, Notes)> {
    config.fusion.validate()?;
    let scene = io::read_scene(folder)?;
    let poses = &scene.true_poses(folder)?.value;
    let ranges = config.fragments(scene.scans.len())?;
    let writer = SceneWriter::begin(output, replace)?;
    monitor.begin(STAGE, ranges.iter().map(Range::len).sum());
    let mut fragments = Vec::with_capacity(ranges.len());
    let mut notes = Notes::new();
    for (number, frames) in ranges.into_iter().enumerate() {
        let files = &scene.scans[frames.clone()];
        let surface = fuse(files, &poses[frames.clone()], config, &mut notes, monitor)?;
        if !surface.points.is_empty() {
            let cloud =
                PlyCloud { points: &surface.points, normals: Some(&surface.normals), ..PlyCloud::default() };
            let origin = format!("{}\t fused\t {}\t {}", scene.name, frames.start, frames.end - 1);
            writer.add(number, &cloud, &poses[frames.start], &origin)?;
        }
        fragments.push(Fragment { frames, points: surface.points.len() });
    }
    monitor.end();
    if fragments.iter().all(|f| f.points == 0) {
        return Err(Error::file(
            folder,
            "depth images without a surface",
            format!("depths up to {} m", config.fusion.max_depth_m),
            "check the unit of the images (millimetres), or allow a larger depth",
        ));
    }
    writer.finish()?;
    Ok((fragments, notes))
}

/// Surface that depth images show, in the frame of the first one's camera; what is worth knowing of how they
/// were read is added to `notes`.
///
/// # Errors
/// An image that cannot be read, more surface than memory allows, or the user asked to stop.
pub fn fuse(
    images: &[PathBuf],
    world_from_camera: &[RigidMotion],
    config: &FragmentConfig,
    notes: &mut Notes,
    monitor: &dyn Monitor,
) -> Result<FusedSurface> {
    let FragmentConfig { reading, fusion, .. } = config;
    let Some(first) = world_from_camera.first() else { return Ok(FusedSurface::default()) };
    let first_from_world = first.inverse();
    let mut volume = Volume::new(&FusionConfig {
        // Fewer images than asked for cannot see anything often enough.
        min_observations: fusion.min_observations.min(images.len().max(1) as u32),
        ..fusion.clone()
    })?;
    let at_once = rayon::current_num_threads();
    for (files, poses) in images.chunks(at_once).zip(world_from_camera.chunks(at_once)) {
        monitor.check(STAGE)?;
        let read: Vec<_> = files.par_iter().map(|file| io::read_frame(file, reading)).collect();
        for (image, world_from_camera) in read.into_iter().zip(poses) {
            let (image, told) = image?;
            told.into_iter().for_each(|note| *notes.entry(note).or_default() += 1);
            volume.integrate(&image, &(first_from_world * world_from_camera))?;
            monitor.advance(1);
        }
    }
    Ok(volume.surface())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_rest_is_left_out_unless_it_is_all() {
        let config = |frames_per_fragment, step| FragmentConfig {
            frames_per_fragment,
            step,
            ..FragmentConfig::default()
        };
        assert_eq!(config(50, 50).fragments(149).unwrap(), [0..50, 50..100]);
        assert_eq!(config(50, 50).fragments(30).unwrap(), std::iter::once(0..30).collect::<Vec<_>>());
        assert_eq!(config(4, 3).fragments(10).unwrap(), [0..4, 3..7, 6..10]);
        assert!(config(50, 50).fragments(0).unwrap().is_empty());
        assert!(config(0, 1).fragments(9).is_err() && config(1, 0).fragments(9).is_err());
    }
}
