//! Settings of the multiview ICP.

use crate::error::{Error, Result};
use crate::registration::config::{positive, share};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of the multiview point-to-plane ICP of all poses of a component.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct MultiviewIcpConfig {
    /// Whether poses are refined together at the end.
    pub enabled: bool,
    /// Pairs of scans that overlap by at least this are used, in `[0, 1]`.
    pub min_overlap: f64,
    /// Radii in units of τ, one round of correspondences or more each, coarse to fine.
    pub radii: Vec<f64>,
    /// Rounds of new correspondences per radius.
    pub rounds: usize,
    /// Points of a scan that look for a counterpart in each overlapping scan.
    pub points_per_scan: usize,
    /// What a difference from black to white counts as in the last radius, in units of τ, where both
    /// scans have colour; 0 does not look at colour.
    pub colour: f64,
}

/// Settings of the fine refinement: a last multiview ICP on surfaces thinned more finely than those that
/// scans were joined by.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct FineRefinementConfig {
    /// Whether it is made.
    pub enabled: bool,
    /// How many times smaller its voxels are than those that scans were joined by, more than 1.
    pub fineness: f64,
    /// Points of a scan that look for a counterpart in each overlapping scan.
    pub points_per_scan: usize,
    /// Points of the thinned scans of a component at most: where there are more, voxels are larger.
    pub most_points: usize,
}

impl Default for FineRefinementConfig {
    fn default() -> Self {
        Self { enabled: true, fineness: 3.0, points_per_scan: 3000, most_points: 4_000_000 }
    }
}

impl FineRefinementConfig {
    /// The first radius that surfaces are compared at, in units of τ: the last of the multiview ICP
    /// that came before, and half of it after.
    pub const FIRST_RADIUS: f64 = 0.5;

    /// The multiview ICP that it is, with radii in units of the first of them.
    pub fn multiview_icp(&self, coarse: &MultiviewIcpConfig) -> MultiviewIcpConfig {
        MultiviewIcpConfig {
            radii: vec![1.0, 0.5],
            rounds: 8,
            points_per_scan: self.points_per_scan,
            ..coarse.clone()
        }
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        positive("fine_refinement.points_per_scan", self.points_per_scan)?;
        positive("fine_refinement.most_points", self.most_points)?;
        if !(self.fineness > 1.0 && self.fineness.is_finite()) {
            return Err(Error::setting(
                "registration.fine_refinement.fineness",
                self.fineness.to_string(),
                "a number above 1",
                "correct it, or set registration.fine_refinement.enabled to false to do without",
            ));
        }
        Ok(())
    }
}

impl Default for MultiviewIcpConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            min_overlap: 0.1,
            radii: vec![2.0, 1.0, 0.5],
            rounds: 4,
            points_per_scan: 1500,
            colour: 1.0,
        }
    }
}

impl MultiviewIcpConfig {
    /// Largest radius that surfaces are compared at, in units of τ: at least 1.
    pub fn widest_radius(&self) -> f64 {
        self.radii.iter().fold(1.0, |widest, &r| r.max(widest))
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        positive("multiview_icp.rounds", self.rounds)?;
        positive("multiview_icp.points_per_scan", self.points_per_scan)?;
        share("multiview_icp.min_overlap", self.min_overlap)?;
        let positive_radii = self.radii.iter().all(|&r| r > 0.0 && r.is_finite());
        if self.enabled && (self.radii.is_empty() || !positive_radii) {
            return Err(Error::setting(
                "registration.multiview_icp.radii",
                format!("{:?}", self.radii),
                "one or more positive multiples of the inlier radius",
                "correct the list, or set registration.multiview_icp.enabled to false to do without",
            ));
        }
        if !(self.colour >= 0.0 && self.colour.is_finite()) {
            return Err(Error::setting(
                "registration.multiview_icp.colour",
                self.colour.to_string(),
                "a multiple of the inlier radius, 0 or more",
                "correct it",
            ));
        }
        Ok(())
    }
}
