//! Settings of the agglomerative strategy.

use crate::error::Result;
use crate::registration::config::positive;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of the agglomerative strategy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct AgglomerativeConfig {
    /// Most similar scans that every scan is registered with at first.
    pub neighbours: usize,
    /// Number of retrieval rounds, which register scans that certain joins left apart with more of
    /// the others.
    pub retrieval_rounds: usize,
    /// Whether a join that the evidence falls short for is tried out with all poses refined
    /// (needs multiview ICP).
    pub trials: bool,
    /// A component that grew by this factor is refined coarsely before it grows on; 1 or less
    /// only at the end.
    pub refine_growth: f64,
    /// Whether contradictions around loops are spread by matched points before multiview ICP.
    pub close_loops: bool,
    /// Whether a join becomes less probable by likely poses of a third component that contradict it.
    pub cycle_consistency: bool,
}

impl Default for AgglomerativeConfig {
    fn default() -> Self {
        Self {
            neighbours: 12,
            retrieval_rounds: 2,
            trials: true,
            refine_growth: 1.5,
            close_loops: true,
            cycle_consistency: true,
        }
    }
}

impl AgglomerativeConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`crate::Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        positive("strategy.neighbours", self.neighbours)
    }
}
