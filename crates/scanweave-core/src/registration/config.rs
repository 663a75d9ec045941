//! Settings of the registration; every room owns its own.

pub use super::agglomerative::config::AgglomerativeConfig;
pub use super::incremental::config::{AveragingConfig, IncrementalConfig, MergeRule, Ordering};
pub use super::multiview_icp::config::{FineRefinementConfig, MultiviewIcpConfig};
pub use super::pairwise::config::{EstimatorConfig, RansacConfig, SpatialCompatibilityConfig};
pub use super::prior_config::{Axis, PriorConfig};
pub use super::verification::config::{
    EvidenceWeights, InlierCountConfig, SurfaceVerification, VerificationConfig,
};

use crate::error::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How scans are put together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Strategy {
    /// One meta-shape grows from a pivot, a scan a step (the paper's method).
    Incremental(IncrementalConfig),
    /// Every scan starts alone, and components join, the most certain join first.
    Agglomerative(AgglomerativeConfig),
}

impl Default for Strategy {
    fn default() -> Self {
        Self::Agglomerative(AgglomerativeConfig::default())
    }
}

impl std::fmt::Display for Strategy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Strategy::Incremental(_) => "incremental",
            Strategy::Agglomerative(_) => "agglomerative",
        })
    }
}

/// Settings of the registration.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct RegistrationConfig {
    /// How scans are put together.
    pub strategy: Strategy,
    /// What is known of poses before.
    pub prior: PriorConfig,
    /// The robust estimator of a pair.
    pub estimator: EstimatorConfig,
    /// What it takes to be placed.
    pub verification: VerificationConfig,
    /// The multiview ICP.
    pub multiview_icp: MultiviewIcpConfig,
    /// The fine refinement after it; none without multiview ICP.
    pub fine_refinement: FineRefinementConfig,
}

impl RegistrationConfig {
    /// The settings of the agglomerative strategy, where that is chosen.
    pub fn agglomerative(&self) -> Option<&AgglomerativeConfig> {
        match &self.strategy {
            Strategy::Agglomerative(c) => Some(c),
            Strategy::Incremental(_) => None,
        }
    }

    /// Points of a scan's surface that are compared with others.
    pub fn compared_points(&self) -> usize {
        let usual = SurfaceVerification::default().points_per_scan;
        self.verification.surfaces().map_or(usual, |c| c.points_per_scan)
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        self.prior.validate()?;
        self.estimator.validate()?;
        self.verification.validate()?;
        self.multiview_icp.validate()?;
        self.fine_refinement.validate()?;
        if self.prior.is_in_use() && self.agglomerative().is_none() {
            return Err(Error::setting(
                "registration.prior",
                "a prior, with registration.strategy.kind = \"incremental\"",
                "the strategy \"agglomerative\", which weighs it",
                "choose that strategy, or leave out what is known of poses",
            ));
        }
        let surfaces = self.verification.surfaces().is_some();
        match &self.strategy {
            Strategy::Agglomerative(_) if !surfaces => {
                Err(needs_surfaces("registration.strategy.kind", "agglomerative"))
            }
            Strategy::Agglomerative(c) => c.validate(),
            Strategy::Incremental(c) if !surfaces && c.ordering == Ordering::Probability => {
                Err(needs_surfaces("registration.strategy.ordering", "probability"))
            }
            Strategy::Incremental(c) => c.validate(),
        }
    }
}

/// A choice that goes by a probability, which inlier counts do not give.
pub(super) fn needs_surfaces(key: &str, found: &str) -> Error {
    Error::setting(
        key,
        format!("{found}, with registration.verification.kind = \"inlier-count\""),
        "the verification \"surfaces\", which gives the probability that this goes by",
        "set registration.verification.kind to \"surfaces\", or choose another value here",
    )
}

/// Refuses zero.
pub(super) fn positive(key: &str, value: usize) -> Result<()> {
    if value > 0 {
        return Ok(());
    }
    Err(Error::setting(format!("registration.{key}"), "0", "a positive number", "raise it"))
}

/// Refuses what is no share.
pub(super) fn share(key: &str, value: f64) -> Result<()> {
    if (0.0..=1.0).contains(&value) {
        return Ok(());
    }
    let key = format!("registration.{key}");
    Err(Error::setting(key, value.to_string(), "a share between 0 and 1", "correct it"))
}
