//! What a recipe may name as data.

use super::PosedScans;
use crate::Monitor;
use crate::io;
use crate::synthetic::SynthConfig;
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// What scenes are used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// To train on.
    #[default]
    Train,
    /// To choose the best epoch by, and never to train on.
    Valid,
}

/// Folders of scans with a true pose each: the 3DMatch layout, or any other that
/// [`io::read_scene`] knows.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ScenesEntry {
    /// What they are used for.
    pub split: Split,
    /// One folder a scene.
    pub folders: Vec<PathBuf>,
}

/// A stretch of a walk with a depth camera: consecutive frames are fused into scans.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RgbdEntry {
    /// What it is used for.
    pub split: Split,
    /// Folder of depth images with camera intrinsics and a pose a frame.
    pub folder: PathBuf,
    /// First frame used, counted from 0 in sorted order.
    pub first_frame: usize,
    /// Frames from there on; all where not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<usize>,
    /// Frames fused into one scan, in the frame of the middle one.
    pub frames_per_fragment: usize,
    /// Frames between the starts of scans that follow each other.
    pub fragment_step: usize,
    /// Voxel over which points of a scan are averaged, metres.
    pub voxel_m: f64,
    /// Points farther from the camera are left out, metres.
    pub max_depth_m: f64,
}

impl Default for RgbdEntry {
    fn default() -> Self {
        Self {
            split: Split::Train,
            folder: PathBuf::new(),
            first_frame: 0,
            frames: None,
            frames_per_fragment: 8,
            fragment_step: 4,
            voxel_m: 0.02,
            max_depth_m: 5.0,
        }
    }
}

impl RgbdEntry {
    pub(super) fn validate(&self) -> Result<()> {
        let refuse = |key: &str, found: String, expected: &str| {
            Err(Error::setting(format!("rgbd.{key}"), found, expected, "correct the recipe"))
        };
        if self.frames_per_fragment == 0 || self.fragment_step == 0 {
            let key = if self.fragment_step == 0 { "fragment_step" } else { "frames_per_fragment" };
            return refuse(key, "0".into(), "at least 1");
        }
        for (key, value) in [("voxel_m", self.voxel_m), ("max_depth_m", self.max_depth_m)] {
            if !(value.is_finite() && value > 0.0) {
                return refuse(key, value.to_string(), "a positive length in metres");
            }
        }
        Ok(())
    }
}

/// Synthetic buildings, one a seed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SynthEntry {
    /// What they are used for.
    pub split: Split,
    /// Seed of every building.
    pub seeds: Vec<u64>,
    /// Rooms of each building.
    pub rooms: usize,
    /// Scans taken in each.
    pub scans: usize,
    /// Depth frames fused into one scan.
    pub frames_per_scan: usize,
    /// Overlap aimed at between scans that follow each other.
    pub overlap: f64,
    /// Factor on the camera's noise: 0 is exact, 1 like the first Kinect.
    pub noise: f64,
}

impl Default for SynthEntry {
    fn default() -> Self {
        let SynthConfig { rooms, scans, frames_per_scan, overlap, noise, .. } = SynthConfig::default();
        Self { split: Split::Train, seeds: vec![0], rooms, scans, frames_per_scan, overlap, noise }
    }
}

impl SynthEntry {
    pub(super) fn config(&self, seed: u64) -> SynthConfig {
        SynthConfig {
            seed,
            rooms: self.rooms,
            scans: self.scans,
            frames_per_scan: self.frames_per_scan,
            overlap: self.overlap,
            noise: self.noise,
            ..SynthConfig::default()
        }
    }

    pub(super) fn validate(&self) -> Result<()> {
        self.config(0).validate()
    }
}

/// Scans of a folder with their poses.
///
/// # Errors
/// When scans or poses cannot be read, or there are no poses.
pub(super) fn read_posed(folder: &Path, monitor: &dyn Monitor) -> Result<PosedScans> {
    let scene = io::read_scene(folder)?;
    let scans = io::read_scans(&scene.scans, monitor)?;
    let world_from_scan = scene.true_poses(folder)?.value.clone();
    Ok(PosedScans { name: scene.name, scans, world_from_scan })
}
