//! The lengths that every stage works with.

use serde::{Deserialize, Serialize};

/// Radius of the neighbourhood that fixes a normal, in voxels.
pub const NORMAL_RADIUS_VOXELS: f64 = 5.0;
/// Radius of the neighbourhood a descriptor describes, in voxels.
pub const FEATURE_RADIUS_VOXELS: f64 = 12.0;
/// Inlier radius τ in voxels: 7 cm at 2.5 cm (Li et al. 2025).
pub const INLIER_RADIUS_VOXELS: f64 = 2.8;

/// The lengths every stage works with, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct WorkingScale {
    /// Voxel size to which scans are thinned.
    pub voxel_m: f64,
    /// Radius of the neighbourhood for normals.
    pub normal_radius_m: f64,
    /// Radius of the neighbourhood of a local descriptor.
    pub feature_radius_m: f64,
    /// Inlier radius τ.
    pub inlier_radius_m: f64,
}

impl WorkingScale {
    /// The default multiples of a voxel size (metres).
    pub fn from_voxel(voxel_m: f64) -> Self {
        Self {
            voxel_m,
            normal_radius_m: NORMAL_RADIUS_VOXELS * voxel_m,
            feature_radius_m: FEATURE_RADIUS_VOXELS * voxel_m,
            inlier_radius_m: INLIER_RADIUS_VOXELS * voxel_m,
        }
    }
}

impl std::fmt::Display for WorkingScale {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "voxel {}, normal radius {}, feature radius {}, inlier radius {}",
            length(self.voxel_m),
            length(self.normal_radius_m),
            length(self.feature_radius_m),
            length(self.inlier_radius_m)
        )
    }
}

/// A length with three significant digits in the unit a person would use.
pub(crate) fn length(metres: f64) -> String {
    let (value, unit) = match metres {
        m if m < 1e-3 => (m * 1e6, "µm"),
        m if m < 1e-2 => (m * 1e3, "mm"),
        m if m < 1.0 => (m * 1e2, "cm"),
        m if m < 1e3 => (m, "m"),
        m => (m * 1e-3, "km"),
    };
    format!("{} {unit}", rounded(value, 3))
}

/// `value` rounded to `digits` significant digits.
pub(crate) fn rounded(value: f64, digits: usize) -> f64 {
    // Through text, so that the result is the nearest number a person can write.
    format!("{value:.*e}", digits - 1).parse().unwrap_or(value)
}
