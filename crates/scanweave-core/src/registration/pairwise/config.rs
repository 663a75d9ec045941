//! Settings of the robust estimator of a pair.

use crate::error::Result;
use crate::registration::config::{positive, share};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How a pose is estimated from matches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case")]
#[non_exhaustive]
pub enum EstimatorConfig {
    /// Random sample consensus over triples of matches (Fischler & Bolles 1981), as in the paper.
    Ransac(RansacConfig),
    /// Second-order spatial compatibility between matches (after Chen et al. 2022, SC²-PCR).
    SpatialCompatibility(SpatialCompatibilityConfig),
}

impl Default for EstimatorConfig {
    fn default() -> Self {
        Self::SpatialCompatibility(SpatialCompatibilityConfig::default())
    }
}

/// Settings of random sample consensus.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct RansacConfig {
    /// Triples that are scored: those that pass the edge-length check.
    pub hypotheses: usize,
    /// Triples drawn at most, with or without passing the check.
    pub max_draws: usize,
    /// Two corresponding edges of a triple may differ by this ratio, in `(0, 1]`.
    pub edge_ratio: f64,
    /// Matches considered at most; beyond it the nearest in descriptor space are kept.
    pub max_matches: usize,
}

impl Default for RansacConfig {
    fn default() -> Self {
        Self { hypotheses: 1000, max_draws: 50_000, edge_ratio: 0.9, max_matches: 3000 }
    }
}

/// Settings of the spatial compatibility estimator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct SpatialCompatibilityConfig {
    /// Seeds whose consensus sets are fitted and scored.
    pub hypotheses: usize,
    /// Matches considered at most; beyond it the nearest in descriptor space are kept.
    pub max_matches: usize,
}

impl Default for SpatialCompatibilityConfig {
    fn default() -> Self {
        Self { hypotheses: 200, max_matches: 3000 }
    }
}

impl EstimatorConfig {
    /// Matches considered at most.
    pub fn max_matches(&self) -> usize {
        match self {
            Self::Ransac(c) => c.max_matches,
            Self::SpatialCompatibility(c) => c.max_matches,
        }
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`crate::Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        positive("estimator.max_matches", self.max_matches())?;
        match self {
            Self::Ransac(c) => {
                positive("estimator.hypotheses", c.hypotheses)?;
                positive("estimator.max_draws", c.max_draws)?;
                share("estimator.edge_ratio", c.edge_ratio)
            }
            Self::SpatialCompatibility(c) => positive("estimator.hypotheses", c.hypotheses),
        }
    }
}
