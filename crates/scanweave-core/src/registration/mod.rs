//! Pairwise and multiview registration.

pub(crate) mod agglomerative;
pub(crate) mod canonical_order;
pub(crate) mod config;
pub(crate) mod incremental;
pub(crate) mod input;
pub(crate) mod multiview_icp;
pub(crate) mod neighbours;
pub(crate) mod pairwise;
pub(crate) mod prior;
pub(super) mod prior_config;
pub(crate) mod scan_model;
pub(crate) mod usability;
pub(crate) mod verification;

pub use agglomerative::first_round::FirstRound;
pub use agglomerative::pairs::{PairScorer, ScanPair, ScoredPairs, most_similar_pairs, score_pairs};
pub use agglomerative::{Agglomeration, Component, Finished, Join, Proposal};
pub use input::{ContentDigest, MIN_KEYPOINTS};
pub use multiview_icp::{
    MatchedPair, PosedScan, close_loops, pose_covariances, refine_if_better, refine_poses,
};
pub use neighbours::neighbours;
pub use pairwise::correspondences::Correspondences;
pub use pairwise::edge::EdgeRegistrar;
pub use pairwise::estimate::{Hypothesis, estimate};
pub use pairwise::matching::{MatchTarget, Matches, NearestCache};
pub use pairwise::nearest::{Best, Columns, Nearest, nearest_both};
pub use pairwise::registrar::{PairHypotheses, PairRegistrar};
pub use prior::{PosePrior, RoughPose, Upright};
pub use scan_model::{FreeSpace, ScanModel};
pub use usability::unusable;
pub use verification::alignment::align;
pub use verification::noise_level::NoiseLevel;
pub use verification::probability::{
    MOST_VIOLATION_OF_CORRECT, SurePair, aliasing, predictors, probability, viewpoint_reliability,
    with_aliasing, with_scan_count_prior,
};
pub use verification::surface_fit::{Posed, SurfaceFit, surface_fit};
pub use verification::verifier::{ScoredHypothesis, Verifier};

pub use config::{
    AgglomerativeConfig, AveragingConfig, Axis, EstimatorConfig, EvidenceWeights, FineRefinementConfig,
    IncrementalConfig, InlierCountConfig, MergeRule, MultiviewIcpConfig, Ordering, PriorConfig, RansacConfig,
    RegistrationConfig, SpatialCompatibilityConfig, Strategy, SurfaceVerification, VerificationConfig,
};
pub use input::{Lengths, ScanInput};

use crate::error::Result;
use crate::monitor::Monitor;
use crate::scan::{Reconstruction, SimilarityMatrix};
use canonical_order::CanonicalOrder;

/// Registers all scans by the strategy of the settings. Scans that only fit each other form
/// components of their own; what fits nowhere is declined.
///
/// `similarity` is `[N,N]` for the N scans. The result depends on the content of the scans and `seed`
/// alone: not on their order, their names or the number of threads.
///
/// # Errors
/// When the settings or shapes are unusable, or the monitor is cancelled.
pub fn register(
    scans: &[ScanInput<'_>],
    similarity: &SimilarityMatrix,
    config: &RegistrationConfig,
    lengths: Lengths,
    seed: u64,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    register_from(scans, similarity, config, lengths, seed, None, monitor)
}

/// [`register`] with the pairs of the [`FirstRound`] of these very scans and settings, all of them, where they
/// were registered before: the result is the same.
///
/// # Errors
/// As [`register`].
pub fn register_from(
    scans: &[ScanInput<'_>],
    similarity: &SimilarityMatrix,
    config: &RegistrationConfig,
    lengths: Lengths,
    seed: u64,
    first_round: Option<Vec<ScanPair>>,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    config.validate()?;
    input::check_shapes(scans, similarity)?;
    let order = CanonicalOrder::new(scans);
    let (scans, similarity) = (&order.scans(scans), &order.similarity(similarity)?);
    let reconstruction = match (&config.strategy, config.verification.surfaces()) {
        (Strategy::Agglomerative(settings), Some(surfaces)) => {
            let settings = (config, settings, surfaces);
            agglomerative::register(scans, similarity, settings, lengths, seed, first_round, monitor)
        }
        (Strategy::Incremental(settings), _) => {
            incremental::register(scans, similarity, config, settings, lengths, seed, monitor)
        }
        (Strategy::Agglomerative(_), None) => {
            Err(config::needs_surfaces("registration.strategy.kind", "agglomerative"))
        }
    };
    Ok(order.restore(reconstruction?))
}
