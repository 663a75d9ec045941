//! Settings of the global paradigm.

use crate::error::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// How poses follow from a pose graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Method {
    /// Spectral synchronisation on SE(3) with Cauchy weights (Arrigoni, Rossi & Fusiello 2016).
    Eigse3,
    /// Rotation averaging with ℓ1 weights (Chatterjee & Govindu 2013).
    L1Irls,
    /// Rotation averaging with ℓ½ weights (Chatterjee & Govindu 2018).
    Rotavg,
    /// Hierarchical rotation averaging (Lee & Civera 2022).
    Hara,
    /// Spectral rotations with history reweighting (Wang et al. 2023).
    Sghr,
    /// The learned graph network of Yew & Lee (2021); needs its weights.
    Lits,
    /// Levenberg–Marquardt on SE(3), Geman–McClure with graduated non-convexity (Yang et al. 2020).
    PoseGraph,
}

impl Method {
    /// All methods, in the order of the tables.
    pub const ALL: [Method; 7] = [
        Method::Eigse3,
        Method::L1Irls,
        Method::Rotavg,
        Method::Lits,
        Method::Hara,
        Method::Sghr,
        Method::PoseGraph,
    ];
}

impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Method::Eigse3 => "eigse3",
            Method::L1Irls => "l1-irls",
            Method::Rotavg => "rotavg",
            Method::Hara => "hara",
            Method::Sghr => "sghr",
            Method::Lits => "lits",
            Method::PoseGraph => "pose-graph",
        })
    }
}

/// Which pairs become edges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GraphKind {
    /// Every pair that could be registered.
    Full,
    /// Of these, the ones whose scans lie close to each other where they overlap.
    Pruned,
    /// Every scan with those most similar to it; other pairs are not registered at all.
    Sparse,
}

impl std::fmt::Display for GraphKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            GraphKind::Full => "full",
            GraphKind::Pruned => "pruned",
            GraphKind::Sparse => "sparse",
        })
    }
}

/// Settings of the global paradigm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct SynchronizationConfig {
    /// Which pairs become edges.
    pub graph: GraphKind,
    /// Scans most similar to a scan that it is paired with in the sparse graph (k).
    pub neighbours: usize,
    /// Largest median distance over the overlap of a pair in the pruned graph, in units of τ
    /// (0.05 m at the 0.07 m of the published graphs).
    pub max_median_distance: f64,
    /// Weights of the LITS network, as `scanweave import-weights --from lits` writes them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lits_weights: Option<PathBuf>,
}

impl Default for SynchronizationConfig {
    fn default() -> Self {
        Self {
            graph: GraphKind::Sparse,
            neighbours: 10,
            max_median_distance: 0.05 / 0.07,
            lits_weights: None,
        }
    }
}

impl SynchronizationConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        if self.neighbours == 0 {
            let key = "synchronization.neighbours";
            return Err(Error::setting(key, "0", "a positive number", "raise it"));
        }
        if !(self.max_median_distance > 0.0 && self.max_median_distance.is_finite()) {
            return Err(Error::setting(
                "synchronization.max_median_distance",
                self.max_median_distance.to_string(),
                "a positive multiple of the inlier radius",
                "correct it",
            ));
        }
        Ok(())
    }
}
