//! Which scans look alike: global features, their fusion, and the similarity matrix.
//!
//! Local descriptors `[n,D]` of a scan → global feature (NetVLAD, GeM or mean) → fusion with the
//! nearest other features → [`SimilarityMatrix`], the prediction of overlap that orders the growth
//! of the model. [`similarity_of`] is the one entry to all of it.

pub(crate) mod checkpoint;
pub(crate) mod fusion;
pub(crate) mod gem;
pub(crate) mod head;
pub(crate) mod kmeans;
pub(crate) mod netvlad;
mod pooling;
pub(crate) mod shipped;
pub(crate) mod similarity;

pub use checkpoint::{
    Architecture, Checkpoint, CheckpointMeta, DataSummary, DescriptorTag, FORMAT_VERSION, OptimizerState,
};
pub use fusion::fuse;
pub use gem::{Gem, mean_pooling};
pub use head::{Head, HeadWeights, global_features};
pub use kmeans::{KmeansConfig, kmeans};
pub use netvlad::{BiasRule, NetVlad, NetVladConfig};
pub use shipped::head_for;
pub use similarity::{similarity, similarity_matrix};

use crate::error::{Error, Result};
use crate::monitor::Monitor;
use crate::scan::{Descriptors, Features, SimilarityMatrix};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// How the global feature of a scan is pooled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SimilaritySource {
    /// NetVLAD, with centroids by k-means where no trained head fits, or none is wanted.
    #[default]
    Netvlad,
    /// Generalised mean.
    Gem,
    /// Mean of the descriptors.
    Mean,
}

/// Whether a trained head predicts the overlap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum HeadChoice {
    /// The checkpoint that is named; where none is, the one that comes with the program if it fits
    /// the pooling and the descriptors, and otherwise as `untrained`.
    #[default]
    Trained,
    /// Set up from the scans at hand: NetVLAD by k-means of their descriptors.
    Untrained,
}

/// Settings of the retrieval stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct RetrievalConfig {
    /// Pooling of the global feature. A checkpoint must hold the same kind.
    pub source: SimilaritySource,
    /// Whether a trained head is used.
    pub head: HeadChoice,
    /// File of a trained head, in place of the one that comes with the program.
    pub checkpoint: Option<PathBuf>,
    /// NetVLAD clusters K, of an untrained head.
    pub clusters: usize,
    /// NetVLAD sharpness α of the assignment, of an untrained head.
    pub alpha: f32,
    /// NetVLAD rule for the assignment's bias, of an untrained head.
    pub bias: BiasRule,
    /// GeM exponent p, of an untrained head.
    pub gem_power: f32,
    /// Most descriptors that k-means looks at.
    pub kmeans_sample: usize,
    /// Most rounds of k-means.
    pub kmeans_rounds: usize,
    /// Nearest global features that are fused into each; 0 turns the fusion off.
    pub fusion_neighbours: usize,
    /// Weight β of a fused neighbour.
    pub fusion_beta: f64,
}

impl Default for RetrievalConfig {
    fn default() -> Self {
        Self {
            source: SimilaritySource::Netvlad,
            head: HeadChoice::Trained,
            checkpoint: None,
            clusters: 256,
            alpha: 100.0,
            bias: BiasRule::Norm,
            gem_power: 3.0,
            kmeans_sample: 20_000,
            kmeans_rounds: 20,
            fusion_neighbours: 3,
            fusion_beta: 0.5,
        }
    }
}

impl RetrievalConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first setting that cannot be used.
    pub fn validate(&self) -> Result<()> {
        let check = |ok: bool, key: &str, found: String, expected: &str| {
            let key = format!("retrieval.{key}");
            if ok { Ok(()) } else { Err(Error::setting(key, found, expected, "correct the config")) }
        };
        if let Some(path) = self.checkpoint.as_ref().filter(|_| self.head == HeadChoice::Untrained) {
            return Err(Error::setting(
                "retrieval.head",
                format!("untrained, with the checkpoint {}", path.display()),
                "one of the two",
                "leave out retrieval.checkpoint, or set retrieval.head to \"trained\"",
            ));
        }
        let positive = "a finite number above 0";
        let above = |v: f32| v.is_finite() && v > 0.0;
        check((1..=4096).contains(&self.clusters), "clusters", self.clusters.to_string(), "1 to 4096")?;
        check(above(self.alpha), "alpha", self.alpha.to_string(), positive)?;
        check(above(self.gem_power), "gem_power", self.gem_power.to_string(), positive)?;
        check(self.kmeans_sample > 0, "kmeans_sample", "0".into(), "at least 1")?;
        let beta = self.fusion_beta;
        check(beta.is_finite() && beta >= 0.0, "fusion_beta", beta.to_string(), "a finite number, 0 or more")
    }
}

/// Where the head of a run came from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum HeadOrigin {
    /// A checkpoint file.
    Trained {
        /// Its name.
        name: String,
    },
    /// NetVLAD around k-means centroids of the descriptors at hand.
    Kmeans {
        /// Scans that had descriptors.
        scans: usize,
    },
    /// A pooling with nothing to learn or with its starting values.
    Untrained {
        /// What it is, in words.
        pooling: &'static str,
    },
}

impl std::fmt::Display for HeadOrigin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            HeadOrigin::Trained { name } => write!(f, "trained checkpoint {name}"),
            HeadOrigin::Kmeans { scans } => write!(f, "k-means centroids from these {scans} scans"),
            HeadOrigin::Untrained { pooling } => write!(f, "{pooling} (nothing trained)"),
        }
    }
}

/// Predicted overlap of all pairs of scans, and where the head that predicts it came from.
///
/// `head` takes the place of `config.checkpoint`; the caller loads it, because only the caller
/// knows which descriptor the features are. A scan without keypoints has similarity 0 to all.
///
/// # Errors
/// When descriptors disagree in dimension with each other or with the head, a setting cannot be
/// used, or the user asked to stop.
pub fn similarity_of(
    features: &[Features],
    config: &RetrievalConfig,
    head: Option<&Checkpoint>,
    seed: u64,
    monitor: &dyn Monitor,
) -> Result<(SimilarityMatrix, HeadOrigin)> {
    config.validate()?;
    let scans: Vec<&Descriptors> = features.iter().map(|f| &f.descriptors).collect();
    let (head, origin) = choose_head(&scans, config, head, seed)?;
    let global = head::global_features(&head, &scans, monitor)?;
    let present: Vec<Vec<f32>> = global.iter().flatten().cloned().collect();
    let fused = fusion::fuse(&present, config.fusion_neighbours, config.fusion_beta, monitor)?;
    let mut fused = fused.iter();
    let placed: Vec<Option<&Vec<f32>>> =
        global.iter().map(|g| g.as_ref().and_then(|_| fused.next())).collect();
    Ok((similarity::similarity_matrix(&placed, monitor)?, origin))
}

/// The head of a run: the checkpoint's, or one set up from the descriptors.
///
/// # Errors
/// When dimensions or kinds disagree.
pub fn choose_head(
    scans: &[&Descriptors],
    config: &RetrievalConfig,
    checkpoint: Option<&Checkpoint>,
    seed: u64,
) -> Result<(Head, HeadOrigin)> {
    let dim = common_dim(scans)?;
    if let Some(checkpoint) = checkpoint {
        check_fit(checkpoint, config, dim)?;
        let origin = HeadOrigin::Trained { name: checkpoint.meta.name.clone() };
        return Ok((checkpoint.weights.head(), origin));
    }
    let mut filled: Vec<&[f32]> = scans.iter().filter(|s| !s.is_empty()).map(|s| s.values()).collect();
    // Random numbers go by content, whatever the order of the scans.
    filled.sort_by_cached_key(|values| {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        *blake3::hash(&bytes).as_bytes()
    });
    Ok(match config.source {
        SimilaritySource::Netvlad => {
            let settings = KmeansConfig {
                clusters: config.clusters,
                sample: config.kmeans_sample,
                rounds: config.kmeans_rounds,
                seed,
            };
            // Without any descriptor there is no dimension either; one keeps the layer well-formed.
            let dim = dim.unwrap_or(1);
            // Descriptors of unit length, as the layer sees them.
            let mut rows = kmeans::subsample(&filled, dim, &settings);
            rows.chunks_exact_mut(dim).for_each(pooling::unit_row);
            let centroids = kmeans::kmeans(&[&rows], dim, &settings);
            let layer = NetVladConfig {
                clusters: config.clusters,
                dim,
                alpha: config.alpha,
                bias: config.bias,
                seed,
            };
            let origin = HeadOrigin::Kmeans { scans: filled.len() };
            (Head::NetVlad(layer.init_from(&centroids)), origin)
        }
        SimilaritySource::Gem => {
            let layer = Gem { power: config.gem_power, shift: gem_shift(&filled), ..Gem::default() };
            (Head::Gem(layer), HeadOrigin::Untrained { pooling: "generalised mean" })
        }
        SimilaritySource::Mean => (Head::Mean, HeadOrigin::Untrained { pooling: "mean pooling" }),
    })
}

/// Shift that keeps negative descriptor values apart under GeM: 1 covers every unit-length
/// descriptor, 0 leaves histograms as they are.
pub fn gem_shift(sets: &[&[f32]]) -> f32 {
    if sets.iter().any(|s| s.iter().any(|&v| v < 0.0)) { 1.0 } else { 0.0 }
}

/// Dimension shared by all scans that have descriptors.
fn common_dim(scans: &[&Descriptors]) -> Result<Option<usize>> {
    let mut dims = scans.iter().enumerate().filter(|(_, s)| !s.is_empty()).map(|(i, s)| (i, s.dim()));
    let Some((first, dim)) = dims.next() else { return Ok(None) };
    match dims.find(|&(_, d)| d != dim) {
        None => Ok(Some(dim)),
        Some((i, d)) => Err(Error::input(
            "descriptors",
            format!("{d} dimensions in scan {i}"),
            format!("{dim} as in scan {first}"),
            "compute the features of all scans with one descriptor",
        )),
    }
}

fn check_fit(checkpoint: &Checkpoint, config: &RetrievalConfig, dim: Option<usize>) -> Result<()> {
    let meta = &checkpoint.meta;
    if let Some(dim) = dim.filter(|&d| d != checkpoint.weights.dim()) {
        return Err(Error::input(
            format!("checkpoint {}", meta.name),
            format!(
                "a head for the descriptor `{}` with {} dimensions",
                meta.descriptor.name,
                checkpoint.weights.dim()
            ),
            format!("{dim} dimensions as in the features"),
            "use a head trained on this descriptor, train one, or leave the checkpoint out",
        ));
    }
    let (kind, name) = match &checkpoint.weights {
        HeadWeights::NetVlad(_) => (SimilaritySource::Netvlad, "netvlad"),
        HeadWeights::Gem { .. } => (SimilaritySource::Gem, "gem"),
    };
    if kind != config.source {
        return Err(Error::setting(
            "retrieval.source",
            format!("{:?}", config.source).to_lowercase(),
            format!("{name}, the kind of head in checkpoint {}", meta.name),
            "change the source or leave the checkpoint out",
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
