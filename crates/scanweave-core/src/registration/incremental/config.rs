//! Settings of the incremental strategy and their ablations (letters: Li et al. 2025, table 4).

use crate::error::Result;
use crate::registration::config::{positive, share};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which candidate joins the meta-shape next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Ordering {
    /// The one of the shortlist with most inliers (the method).
    Inliers,
    /// The one whose evidence makes its pose most probable. Needs surfaces in the verification.
    Probability,
    /// The most similar one, registered without comparing evidence (ablation b: no geometric stage).
    Similarity,
    /// The one of the shortlist that overlaps the meta-shape most (ablation c: Guo et al. 2014).
    Overlap,
}

/// How redundant keypoints are merged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MergeRule {
    /// Keep one of all that met, each with equal probability (the method).
    Reservoir,
    /// Keep every keypoint (ablation e).
    Concatenate,
    /// Average keypoints and descriptors (ablation f).
    Mean,
}

/// Settings of the transformation averaging of a newly selected scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct AveragingConfig {
    /// Off is ablation d.
    pub enabled: bool,
    /// Registered scans that overlap the new one by more than this contribute, in `[0, 1]`.
    pub min_overlap: f64,
    /// Rounds of the Weiszfeld iteration at most.
    pub max_rounds: usize,
    /// Step length (Frobenius norm) at which it stops.
    pub tolerance: f64,
}

impl Default for AveragingConfig {
    fn default() -> Self {
        Self { enabled: true, min_overlap: 0.3, max_rounds: 10, tolerance: 1e-3 }
    }
}

/// Settings of the incremental strategy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct IncrementalConfig {
    /// Scans most similar to the meta-shape that are registered in a step (k).
    pub shortlist: usize,
    /// Off is ablation a: every scan left is registered in every step.
    pub semantic: bool,
    /// What decides among the shortlist.
    pub ordering: Ordering,
    /// The transformation averaging.
    pub averaging: AveragingConfig,
    /// The merge of redundant keypoints.
    pub merge: MergeRule,
    /// Multiview ICP also whenever this many scans joined since the last time; 0 only at the end.
    pub refine_every: usize,
}

impl Default for IncrementalConfig {
    fn default() -> Self {
        Self {
            shortlist: 10,
            semantic: true,
            ordering: Ordering::Probability,
            averaging: AveragingConfig::default(),
            merge: MergeRule::Reservoir,
            refine_every: 0,
        }
    }
}

impl IncrementalConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`crate::Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        positive("strategy.shortlist", self.shortlist)?;
        share("strategy.averaging.min_overlap", self.averaging.min_overlap)
    }
}
