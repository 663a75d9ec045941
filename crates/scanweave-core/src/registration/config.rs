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
    /// The one whose evidence makes its pose most probable; falls back to inliers where
    /// `evidence.surfaces` is off.
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

/// Weights of the logistic model that turns the support of a pose into a probability.
///
/// The defaults are the rounded mean of three logistic fits to what `examples/evidence_calibration.rs`
/// measures (`--table`) on four 3DMatch test scenes, all but the kitchen: published MiniSpinNet
/// descriptors at 2500 keypoints, and FPFH at 2500 and at 1000.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EvidenceWeights {
    /// Constant term.
    pub constant: f64,
    /// Weight of the logarithm of the inlier count.
    pub ln_inliers: f64,
    /// Weight of the logarithm of inliers over those of the next distinct hypothesis.
    pub ln_lead: f64,
    /// Weight of the logarithm of the share of agreeing normals.
    pub normal_agreement: f64,
    /// Weight of the distance to tangent planes, in units of τ.
    pub plane_residual: f64,
    /// Weight of the logarithm of the touching surface, in scans.
    pub overlap: f64,
    /// Weight of the logarithm of the share of points in space seen to be empty.
    pub violation: f64,
    /// Weight of the logarithm of the stiffness.
    pub stiffness: f64,
    /// Weight of violations beyond a fifth, where viewpoints are believed.
    pub contradiction: f64,
    /// Weight of the logarithm of the share of the inliers that chance explains.
    pub chance: f64,
}

impl EvidenceWeights {
    /// The weights in the order of [`super::evidence::predictors`].
    pub fn as_array(&self) -> [f64; 10] {
        [
            self.constant,
            self.ln_inliers,
            self.ln_lead,
            self.normal_agreement,
            self.plane_residual,
            self.overlap,
            self.violation,
            self.stiffness,
            self.contradiction,
            self.chance,
        ]
    }
}

impl EvidenceWeights {
    /// Weights in the order of [`Self::as_array`].
    pub fn from_array(w: [f64; 10]) -> Self {
        let [
            constant,
            ln_inliers,
            ln_lead,
            normal_agreement,
            plane_residual,
            overlap,
            violation,
            stiffness,
            contradiction,
            chance,
        ] = w;
        Self {
            constant,
            ln_inliers,
            ln_lead,
            normal_agreement,
            plane_residual,
            overlap,
            violation,
            stiffness,
            contradiction,
            chance,
        }
    }
}

impl Default for EvidenceWeights {
    fn default() -> Self {
        Self {
            constant: -11.6,
            ln_inliers: 0.67,
            ln_lead: 0.66,
            normal_agreement: 1.8,
            plane_residual: -6.6,
            overlap: 1.2,
            violation: -2.65,
            stiffness: 0.83,
            contradiction: -12.9,
            chance: -1.5,
        }
    }
}

/// What a registration must show before a scan is placed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EvidenceConfig {
    /// Inliers needed in any case.
    pub min_inliers: usize,
    /// Whether surfaces are checked and a probability is computed. Off, as in the paper,
    /// only `min_inliers` decides.
    pub surfaces: bool,
    /// Distinct hypotheses of a candidate that are checked.
    pub hypotheses: usize,
    /// Points of a scan's surface that are compared with others.
    pub points_per_scan: usize,
    /// Point-to-plane steps that a hypothesis is aligned by before its evidence is measured
    /// (strategy `assemble`).
    pub align_rounds: usize,
    /// Probability below which a scan is not placed, in `[0, 1]`.
    pub accept: f64,
    /// Probability from which a scan is placed before the rest of the similarity list is
    /// looked at, in `[0, 1]`; less certain ones wait until nothing better is found.
    pub confident: f64,
    /// The model of the probability.
    pub weights: EvidenceWeights,
}

impl Default for EvidenceConfig {
    fn default() -> Self {
        Self {
            min_inliers: 6,
            surfaces: true,
            hypotheses: 3,
            points_per_scan: 400,
            align_rounds: 6,
            accept: 0.6,
            confident: 0.95,
            weights: EvidenceWeights::default(),
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
    /// A component that grew by this factor is refined coarsely before it grows on; 1 or less
    /// only at the end (strategy `assemble`).
    pub growth: f64,
    /// Whether contradictions around loops are spread by matched points first (strategy
    /// `assemble`).
    pub close_loops: bool,
    /// What a difference from black to white counts as in the last radius, in units of τ, where both
    /// scans have colour; 0 does not look at colour.
    pub colour: f64,
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
            growth: 1.5,
            close_loops: true,
            colour: 1.0,
        }
    }
}

/// How scans are put together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Strategy {
    /// One meta-shape grows from a pivot, a scan a step (the paper's method).
    Grow,
    /// Every scan starts alone, and components join, the most certain join first.
    Assemble,
}

/// Settings of the strategy `assemble`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AssemblyConfig {
    /// Most similar scans that every scan is registered with at first.
    pub neighbours: usize,
    /// Number of further looks, which register scans that certain joins left apart with more of the others.
    pub further_looks: usize,
    /// Whether placed scans are looked at again when everything is known, and moved or taken
    /// out where that speaks against their place.
    pub review: bool,
    /// Whether a join that the evidence falls short for is tried out with all poses refined.
    pub trials: bool,
}

impl Default for AssemblyConfig {
    fn default() -> Self {
        Self { neighbours: 12, further_looks: 2, review: true, trials: true }
    }
}

/// Settings of the registration (SPEC: pipeline).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RegistrationConfig {
    /// How scans are put together.
    pub strategy: Strategy,
    /// Settings of the strategy `assemble`.
    pub assembly: AssemblyConfig,
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
            strategy: Strategy::Assemble,
            assembly: AssemblyConfig::default(),
            shortlist: 10,
            semantic: true,
            ordering: Ordering::Probability,
            estimator: EstimatorConfig::default(),
            averaging: AveragingConfig::default(),
            merge: MergeRule::Reservoir,
            evidence: EvidenceConfig::default(),
            joint: JointConfig::default(),
        }
    }
}

impl RegistrationConfig {
    /// Whether candidates' surfaces are compared with the registered ones.
    pub fn checks_surfaces(&self) -> bool {
        self.evidence.surfaces || self.ordering == Ordering::Overlap
    }

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
        positive("assembly.neighbours", self.assembly.neighbours)?;
        positive("evidence.points_per_scan", self.evidence.points_per_scan)?;
        positive("estimator.hypotheses", self.estimator.hypotheses)?;
        positive("estimator.max_draws", self.estimator.max_draws)?;
        positive("estimator.max_matches", self.estimator.max_matches)?;
        positive("joint.rounds", self.joint.rounds)?;
        positive("joint.points_per_scan", self.joint.points_per_scan)?;
        share("estimator.edge_ratio", self.estimator.edge_ratio)?;
        share("averaging.min_overlap", self.averaging.min_overlap)?;
        positive("evidence.hypotheses", self.evidence.hypotheses)?;
        share("evidence.accept", self.evidence.accept)?;
        share("evidence.confident", self.evidence.confident)?;
        share("joint.min_overlap", self.joint.min_overlap)?;
        if self.strategy == Strategy::Assemble && !self.evidence.surfaces {
            return Err(Error::setting(
                "registration.evidence.surfaces",
                "false, with registration.strategy = \"assemble\"",
                "true: components join by the probability that surfaces are checked for",
                "set registration.strategy to \"grow\" to do without",
            ));
        }
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
