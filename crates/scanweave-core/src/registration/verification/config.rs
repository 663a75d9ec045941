//! Settings of the verification: what a pose must show before it counts as right.

use super::shipped;
use crate::error::{Error, Result};
use crate::registration::config::{positive, share};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How a pose is verified.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case")]
#[non_exhaustive]
pub enum VerificationConfig {
    /// By the number of inlier matches alone, as in the paper (IC).
    InlierCount(InlierCountConfig),
    /// By matches and surfaces, which give a calibrated probability.
    Surfaces(SurfaceVerification),
}

impl Default for VerificationConfig {
    fn default() -> Self {
        Self::Surfaces(SurfaceVerification::default())
    }
}

/// Settings of the verification by inlier matches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct InlierCountConfig {
    /// Inliers needed.
    pub min_inliers: usize,
}

impl InlierCountConfig {
    /// So many inliers needed.
    pub fn new(min_inliers: usize) -> Self {
        Self { min_inliers }
    }
}

impl Default for InlierCountConfig {
    fn default() -> Self {
        Self { min_inliers: 3 }
    }
}

/// Settings of the verification by matches and surfaces.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct SurfaceVerification {
    /// Inliers needed in any case.
    pub min_inliers: usize,
    /// Distinct hypotheses of a candidate that are checked.
    pub hypotheses: usize,
    /// Points of a scan's surface that are compared with others.
    pub points_per_scan: usize,
    /// Point-to-plane steps that a hypothesis is aligned by before its evidence is measured.
    pub align_rounds: usize,
    /// Probability below which a scan is not placed, in `[0, 1]`.
    pub accept: f64,
    /// Probability from which a scan is placed before less certain ones are considered, in
    /// `[accept, 1]`.
    pub confident: f64,
    /// Whether points in space that the other side saw to be empty count, in the probability and as
    /// a limit.
    pub free_space: bool,
    /// Whether they count as far as the surest pairs show that each viewpoint is reliable; otherwise
    /// all count in full. No effect without `free_space`.
    pub viewpoint_reliability: bool,
    /// Whether it counts how well the touching surface fixes the pose.
    pub localizability: bool,
    /// Whether plane residual and free-space violation count as far as they exceed what the collection's
    /// best-supported pairs show; otherwise as far as they exceed those of RGB-D scenes.
    pub noise_level: bool,
    /// Whether it counts how many inliers there would be if matches were paired at random.
    pub chance_inliers: bool,
    /// The model of the probability.
    pub weights: EvidenceWeights,
}

impl Default for SurfaceVerification {
    fn default() -> Self {
        Self {
            min_inliers: 6,
            hypotheses: 3,
            points_per_scan: 400,
            align_rounds: 6,
            accept: 0.6,
            confident: 0.95,
            free_space: true,
            viewpoint_reliability: true,
            localizability: true,
            noise_level: true,
            chance_inliers: true,
            weights: EvidenceWeights::default(),
        }
    }
}

impl VerificationConfig {
    /// Inliers needed in any case.
    pub fn min_inliers(&self) -> usize {
        match self {
            Self::InlierCount(c) => c.min_inliers,
            Self::Surfaces(c) => c.min_inliers,
        }
    }

    /// The settings of the verification by surfaces, where that is asked for.
    pub fn surfaces(&self) -> Option<&SurfaceVerification> {
        match self {
            Self::InlierCount(_) => None,
            Self::Surfaces(c) => Some(c),
        }
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        let Self::Surfaces(c) = self else { return Ok(()) };
        positive("verification.hypotheses", c.hypotheses)?;
        positive("verification.points_per_scan", c.points_per_scan)?;
        share("verification.accept", c.accept)?;
        share("verification.confident", c.confident)?;
        if c.accept > c.confident {
            return Err(Error::setting(
                "registration.verification.accept",
                c.accept.to_string(),
                format!("at most registration.verification.confident, {}", c.confident),
                "lower it or raise confident: what is certain is placed before what is acceptable",
            ));
        }
        Ok(())
    }
}

/// Weights of the logistic model that turns the evidence of a pose into a probability.
///
/// The defaults are those of `checkpoints/verifier.json`, which `scanweave train verifier` wrote.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EvidenceWeights {
    /// Constant term.
    pub constant: f64,
    /// Weight of the logarithm of the inlier count.
    pub ln_inliers: f64,
    /// Weight of the logarithm of inliers over those of the next distinct hypothesis.
    pub ln_second_best_ratio: f64,
    /// Weight of the logarithm of the share of agreeing normals.
    pub normal_agreement: f64,
    /// Weight of the distance to tangent planes, in units of τ.
    pub plane_residual: f64,
    /// Weight of the logarithm of the touching surface, in scans.
    pub overlap: f64,
    /// Weight of the logarithm of the share of points in space seen to be empty.
    pub free_space_violation: f64,
    /// Weight of the logarithm of the localizability.
    pub localizability: f64,
    /// Weight of free-space violations beyond a fifth, where viewpoints are reliable.
    pub free_space_excess: f64,
    /// Weight of the logarithm of the share of the inliers that chance explains.
    pub chance_inliers: f64,
}

impl EvidenceWeights {
    /// Names of the weights, in the order of [`Self::as_array`].
    pub const NAMES: [&str; 10] = [
        "constant",
        "ln_inliers",
        "ln_second_best_ratio",
        "normal_agreement",
        "plane_residual",
        "overlap",
        "free_space_violation",
        "localizability",
        "free_space_excess",
        "chance_inliers",
    ];

    /// The sign that the meaning of each weight demands, in the order of [`Self::as_array`]: more of every
    /// good thing is more probable. The constant is free: 0.
    pub const SIGNS: [f64; 10] = [0.0, 1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, -1.0];

    /// The weights in the order of [`crate::registration::predictors`].
    pub fn as_array(&self) -> [f64; 10] {
        [
            self.constant,
            self.ln_inliers,
            self.ln_second_best_ratio,
            self.normal_agreement,
            self.plane_residual,
            self.overlap,
            self.free_space_violation,
            self.localizability,
            self.free_space_excess,
            self.chance_inliers,
        ]
    }

    /// Weights in the order of [`Self::as_array`].
    pub fn from_array(w: [f64; 10]) -> Self {
        let [
            constant,
            ln_inliers,
            ln_second_best_ratio,
            normal_agreement,
            plane_residual,
            overlap,
            free_space_violation,
            localizability,
            free_space_excess,
            chance_inliers,
        ] = w;
        Self {
            constant,
            ln_inliers,
            ln_second_best_ratio,
            normal_agreement,
            plane_residual,
            overlap,
            free_space_violation,
            localizability,
            free_space_excess,
            chance_inliers,
        }
    }
}

impl Default for EvidenceWeights {
    fn default() -> Self {
        shipped::weights()
    }
}
