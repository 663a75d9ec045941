//! Settings of the incremental registration and their ablations.

use crate::error::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which candidate joins the meta-shape next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Ordering {
    /// The one of the shortlist with most inliers (the method).
    Inliers,
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

/// How a pose is estimated from matches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum EstimatorKind {
    /// Random sample consensus over triples of matches (Fischler & Bolles 1981), as in the paper.
    Ransac,
    /// Second-order spatial compatibility between matches (after Chen et al. 2022, SC²-PCR).
    SpatialCompatibility,
}

/// Settings of the robust estimator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EstimatorConfig {
    /// Which estimator.
    pub kind: EstimatorKind,
    /// Hypotheses that are scored: triples that pass the edge-length check, or seeds.
    pub hypotheses: usize,
    /// Triples drawn at most, with or without passing the check (RANSAC only).
    pub max_draws: usize,
    /// Two corresponding edges of a triple may differ by this ratio, in `(0, 1]` (RANSAC only).
    pub edge_ratio: f64,
    /// Matches considered at most; beyond it the nearest in descriptor space are kept.
    pub max_matches: usize,
}

impl Default for EstimatorConfig {
    fn default() -> Self {
        Self {
            kind: EstimatorKind::SpatialCompatibility,
            hypotheses: 200,
            max_draws: 50_000,
            edge_ratio: 0.9,
            max_matches: 3000,
        }
    }
}

/// Settings of the transformation averaging of a newly selected scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
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

/// What a registration must show before a scan is placed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EvidenceConfig {
    /// Inliers needed in any case.
    pub min_inliers: usize,
    /// Inliers needed beyond `min_inliers`, as a share of the matches: more matches
    /// agree by chance when there are more of them.
    pub min_inlier_ratio: f64,
    /// Share of the points in the overlap whose normals must agree (within 45°), in `[0, 1]`.
    pub min_normal_agreement: f64,
    /// Share of a scan's points that may lie in space the other scans saw as empty, in `[0, 1]`.
    pub max_free_space_violation: f64,
}

impl Default for EvidenceConfig {
    fn default() -> Self {
        Self {
            min_inliers: 12,
            min_inlier_ratio: 0.0,
            min_normal_agreement: 0.0,
            max_free_space_violation: 1.0,
        }
    }
}

/// Settings of the joint point-to-plane refinement of all poses of a component.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct JointConfig {
    /// Whether poses are refined jointly at the end.
    pub enabled: bool,
    /// Also refine whenever this many scans joined since the last time; 0 only at the end.
    pub every: usize,
    /// Pairs of scans that overlap by at least this are used, in `[0, 1]`.
    pub min_overlap: f64,
    /// Radii in units of τ, one round of correspondences or more each, coarse to fine.
    pub radii: Vec<f64>,
    /// Rounds of new correspondences per radius.
    pub rounds: usize,
    /// Points of a scan that look for a counterpart in each overlapping scan.
    pub points_per_scan: usize,
}

impl Default for JointConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            every: 0,
            min_overlap: 0.1,
            radii: vec![2.0, 1.0, 0.5],
            rounds: 4,
            points_per_scan: 1500,
        }
    }
}

/// Settings of the incremental registration (SPEC: pipeline).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RegistrationConfig {
    /// Scans most similar to the meta-shape that are registered in a step (k).
    pub shortlist: usize,
    /// Off is ablation a: every scan left is registered in every step.
    pub semantic: bool,
    /// What decides among the shortlist.
    pub ordering: Ordering,
    /// The robust estimator.
    pub estimator: EstimatorConfig,
    /// The transformation averaging.
    pub averaging: AveragingConfig,
    /// The merge of redundant keypoints.
    pub merge: MergeRule,
    /// What it takes to be placed.
    pub evidence: EvidenceConfig,
    /// The joint refinement.
    pub joint: JointConfig,
}

impl Default for RegistrationConfig {
    fn default() -> Self {
        Self {
            shortlist: 10,
            semantic: true,
            ordering: Ordering::Inliers,
            estimator: EstimatorConfig::default(),
            averaging: AveragingConfig::default(),
            merge: MergeRule::Reservoir,
            evidence: EvidenceConfig::default(),
            joint: JointConfig::default(),
        }
    }
}

impl RegistrationConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        let positive = |key: &str, value: usize| {
            if value > 0 {
                return Ok(());
            }
            Err(Error::setting(format!("registration.{key}"), "0", "a positive number", "raise it"))
        };
        let share = |key: &str, value: f64| {
            if (0.0..=1.0).contains(&value) {
                return Ok(());
            }
            let key = format!("registration.{key}");
            Err(Error::setting(key, value.to_string(), "a share between 0 and 1", "correct it"))
        };
        positive("shortlist", self.shortlist)?;
        positive("estimator.hypotheses", self.estimator.hypotheses)?;
        positive("estimator.max_draws", self.estimator.max_draws)?;
        positive("estimator.max_matches", self.estimator.max_matches)?;
        positive("joint.rounds", self.joint.rounds)?;
        positive("joint.points_per_scan", self.joint.points_per_scan)?;
        share("estimator.edge_ratio", self.estimator.edge_ratio)?;
        share("averaging.min_overlap", self.averaging.min_overlap)?;
        share("evidence.min_inlier_ratio", self.evidence.min_inlier_ratio)?;
        share("evidence.min_normal_agreement", self.evidence.min_normal_agreement)?;
        share("evidence.max_free_space_violation", self.evidence.max_free_space_violation)?;
        share("joint.min_overlap", self.joint.min_overlap)?;
        if self.joint.enabled && !self.joint.radii.iter().all(|&r| r > 0.0 && r.is_finite()) {
            return Err(Error::setting(
                "registration.joint.radii",
                format!("{:?}", self.joint.radii),
                "positive multiples of the inlier radius",
                "correct the list",
            ));
        }
        Ok(())
    }
}
