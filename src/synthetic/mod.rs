//! Seeded synthetic interiors: furnished rooms, a depth camera with a real one's faults, and
//! the partial scans a person walking through would take, with their true poses.
//!
//! [`generate`] makes a whole set. [`Site`] makes scans one by one, for sets that do not fit in
//! memory. [`render_depth`] and [`observe`] give single depth images, [`fuse`] joins them.
//! Everything follows from [`SynthConfig::seed`], whatever the number of threads.

pub(crate) mod adversarial;
pub(crate) mod ambiguous;
mod building;
mod camera;
mod fragment;
mod furniture;
mod noise;
mod pieces;
mod plan;
pub(crate) mod pose_graph;
mod scene;
mod shape;
mod walk;

pub use crate::scan::{DepthImage, Intrinsics};
pub use camera::render_depth;
pub use fragment::fuse;
pub use noise::{DepthFrame, SensorNoise, observe};
pub use plan::Site;
pub use scene::{Hit, Scene};
pub use shape::{Entry, Primitive, Shape};

use crate::Monitor;
use crate::geometry::RigidMotion;
use crate::scan::{Scan, ScanId};
use crate::{Error, Result};
use plan::generator;
use rand::RngExt;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A synthetic set of scans.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SynthConfig {
    /// Everything random follows from it.
    pub seed: u64,
    /// Rooms of the building, on a grid, joined by doors.
    pub rooms: usize,
    /// Scans taken in the building.
    pub scans: usize,
    /// Scans mixed in that belong nowhere: each from a building of its own.
    pub unrelated: usize,
    /// Depth frames fused into one scan.
    pub frames_per_scan: usize,
    /// Columns of a depth frame.
    pub width: usize,
    /// Rows of a depth frame.
    pub height: usize,
    /// Horizontal field of view, degrees.
    pub horizontal_fov_deg: f64,
    /// Farthest depth the camera sees, metres.
    pub max_range_m: f64,
    /// Factor on the camera's noise: 0 is exact, 1 like the first Kinect.
    pub noise: f64,
    /// Two-way overlap aimed at between scans that follow each other, in `[0, 1]`.
    pub overlap: f64,
    /// Width of the voxels that a scan's points are averaged in, metres.
    pub voxel_m: f64,
}

impl Default for SynthConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            rooms: 2,
            scans: 16,
            unrelated: 0,
            frames_per_scan: 5,
            width: 320,
            height: 240,
            horizontal_fov_deg: 57.0,
            max_range_m: 4.0,
            noise: 1.0,
            overlap: 0.55,
            voxel_m: 0.02,
        }
    }
}

impl SynthConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the first unusable key.
    pub fn validate(&self) -> Result<()> {
        let counts: [(&str, usize, usize, usize); 6] = [
            ("synthetic.rooms", self.rooms, 1, 2500),
            ("synthetic.scans", self.scans, 0, 100_000),
            ("synthetic.unrelated", self.unrelated, 0, 10_000),
            ("synthetic.frames_per_scan", self.frames_per_scan, 1, 1000),
            ("synthetic.width", self.width, 16, 4096),
            ("synthetic.height", self.height, 16, 4096),
        ];
        for (key, value, low, high) in counts {
            if !(low..=high).contains(&value) {
                let range = format!("a whole number from {low} to {high}");
                return Err(Error::setting(key, value.to_string(), range, "change it in the config"));
            }
        }
        let numbers = [
            ("synthetic.horizontal_fov_deg", self.horizontal_fov_deg, 20.0, 120.0),
            ("synthetic.max_range_m", self.max_range_m, 1.0, 50.0),
            ("synthetic.noise", self.noise, 0.0, 10.0),
            ("synthetic.overlap", self.overlap, 0.1, 0.9),
            ("synthetic.voxel_m", self.voxel_m, 0.002, 0.5),
        ];
        for (key, value, low, high) in numbers {
            if !(low..=high).contains(&value) {
                let range = format!("a number from {low} to {high}");
                return Err(Error::setting(key, value.to_string(), range, "change it in the config"));
            }
        }
        if self.scans + self.unrelated == 0 {
            return Err(Error::setting("synthetic.scans", "0", "at least one scan", "ask for more scans"));
        }
        Ok(())
    }
}

/// Scans in random order with their truth.
#[derive(Debug, Clone)]
pub struct SyntheticSet {
    /// The scans, each in a frame of its own with the sensor at the origin.
    pub scans: Vec<Scan>,
    /// True `world_from_scan` of each, in the frame of its building.
    pub world_from_scan: Vec<RigidMotion>,
    /// Building of each scan: 0 is the one that was asked for, the others hold one unrelated
    /// scan each. Poses in different buildings have nothing to do with each other.
    pub building: Vec<usize>,
    /// `walk[k]` is the scan that was taken as the `k`-th of the building, for those who want
    /// to know which scans follow each other.
    pub walk: Vec<ScanId>,
}

/// Makes the set that `config` describes. Parallel over scans.
///
/// # Errors
/// An invalid config, or [`Error::Interrupted`] once `monitor` says so.
pub fn generate(config: &SynthConfig, monitor: &dyn Monitor) -> Result<SyntheticSet> {
    const STAGE: &str = "synthetic scans";
    config.validate()?;
    let total = config.scans + config.unrelated;
    monitor.begin(STAGE, total);
    let main = Site::new(config, config.seed, config.rooms, config.scans);
    let made = (0..total)
        .into_par_iter()
        .map(|k| {
            monitor.check(STAGE)?;
            let made = if k < config.scans {
                main.scan(k)
            } else {
                let seed = config.seed ^ (0x9e37_79b9_7f4a_7c15u64.wrapping_mul(1 + k as u64));
                Site::new(config, seed, 1, 1).scan(0)
            };
            monitor.advance(1);
            Ok(made)
        })
        .collect::<Result<Vec<_>>>();
    monitor.end();
    let made = made?;
    let mut order: Vec<usize> = (0..total).collect();
    let mut rng = generator(config.seed, u64::MAX);
    for i in (1..total).rev() {
        order.swap(i, rng.random_range(0..=i));
    }
    let mut set = SyntheticSet {
        scans: Vec::with_capacity(total),
        world_from_scan: Vec::with_capacity(total),
        building: Vec::with_capacity(total),
        walk: vec![ScanId(0); config.scans],
    };
    let mut made: Vec<Option<_>> = made.into_iter().map(Some).collect();
    let digits = (total - 1).to_string().len().max(2);
    for (id, &k) in order.iter().enumerate() {
        let Some((cloud, world_from_scan)) = made[k].take() else { continue };
        let name = format!("scan_{id:0digits$}");
        set.scans.push(Scan { id: ScanId(id), name, cloud, ..Scan::default() });
        set.world_from_scan.push(world_from_scan);
        if k < config.scans {
            set.walk[k] = ScanId(id);
        }
        set.building.push((k + 1).saturating_sub(config.scans));
    }
    Ok(set)
}

#[cfg(test)]
mod tests;

pub use adversarial::{AdversarialSet, Trouble, adversarial_scans};
pub use ambiguous::{AmbiguousSet, Place, ambiguous_scans};
pub use pose_graph::{KnownPoseGraph, PoseGraphConfig};
