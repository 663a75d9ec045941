//! Settings of a fusion.

use crate::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of a fusion. Voxel and truncation are those of the 3DMatch test set (Zeng et al. 2017,
/// its published script: 6 mm, five voxels).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FusionConfig {
    /// Width of a voxel, metres.
    pub voxel_m: f64,
    /// Distance to the surface beyond which only its side is kept, metres.
    pub truncation_m: f64,
    /// Depth beyond which a camera's measurements are left out, metres.
    pub max_depth_m: f64,
    /// Images that must have seen a place for a surface there.
    pub min_observations: u32,
    /// Most memory for voxels, MiB.
    pub memory_mib: usize,
}

impl Default for FusionConfig {
    fn default() -> Self {
        Self { voxel_m: 0.006, truncation_m: 0.03, max_depth_m: 4.0, min_observations: 1, memory_mib: 2048 }
    }
}

impl FusionConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the first that cannot be used.
    pub fn validate(&self) -> Result<()> {
        let refuse = |key: &str, found: String, expected: &str| {
            Err(Error::setting(format!("fusion.{key}"), found, expected, "give another value"))
        };
        for (key, value) in [("voxel_m", self.voxel_m), ("max_depth_m", self.max_depth_m)] {
            if !(value.is_finite() && value > 0.0) {
                return refuse(key, value.to_string(), "a positive length in metres");
            }
        }
        // Below two voxels the distance reaches its limit next to the surface, and where it is
        // zero cannot be told any more.
        if !(self.truncation_m.is_finite() && self.truncation_m >= 2.0 * self.voxel_m) {
            return refuse("truncation_m", self.truncation_m.to_string(), "at least two voxels");
        }
        // Keeps voxel coordinates exact in single precision and in 32 bits.
        if self.max_depth_m / self.voxel_m > 1e6 {
            return refuse("voxel_m", self.voxel_m.to_string(), "at least a millionth of max_depth_m");
        }
        if self.min_observations == 0 || self.memory_mib == 0 {
            let key = if self.memory_mib == 0 { "memory_mib" } else { "min_observations" };
            return refuse(key, "0".into(), "at least 1");
        }
        Ok(())
    }
}
