//! Incremental multiview registration: the algorithm, in the paper's own steps.
//!
//! Li, Zhu, Xie & Zhu, "Incremental Multiview Point Cloud Registration with Two-stage
//! Candidate Retrieval" (Pattern Recognition 2025).

use crate::registration::config::{Ordering, RegistrationConfig};
use crate::registration::input::{Lengths, ScanInput};
mod candidate;
mod conclusion;
mod growth;
pub mod meta_shape;
mod transformation_averaging;

use growth::{Attempt, Growth};
use crate::error::Result;
use crate::monitor::Monitor;
use crate::scan::{Reconstruction, SimilarityMatrix};

/// Registers all scans: grows a meta-shape from a pivot, scan by scan; scans that fit
/// nothing of it grow components of their own; what fits nowhere is declined.
///
/// `similarity` is `[N,N]` for the N scans. The result depends on the inputs and `seed`
/// alone, never on the number of threads.
///
/// # Errors
/// When the settings or shapes are unusable, or the monitor is cancelled.
pub(super) fn register(
    scans: &[ScanInput<'_>],
    similarity: &SimilarityMatrix,
    config: &RegistrationConfig,
    lengths: Lengths,
    seed: u64,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    monitor.begin("register", scans.len());
    let mut growth = Growth::new(scans, similarity, config, lengths, seed);
    while let Some(pivot) = growth.most_connected_scan() {
        growth.start_meta_shape(pivot);
        monitor.advance(1);
        while let Some(chosen) = retrieve_and_verify(&mut growth, config, monitor)? {
            let world_from_scan = growth.average_transformation(&chosen);
            growth.merge(&chosen, world_from_scan);
            growth.refine_if_due(monitor)?;
            monitor.advance(1);
        }
        growth.close_component(monitor)?;
    }
    monitor.end();
    Ok(growth.conclude())
}

/// Two-stage retrieval: the scans most similar to the meta-shape, then the one among
/// them that geometry supports best.
///
/// Goes down the similarity list until a candidate is certain enough; failing that, the
/// best of all sufficient ones; `None` when no scan left is sufficiently supported.
fn retrieve_and_verify(
    growth: &mut Growth<'_>,
    config: &RegistrationConfig,
    monitor: &dyn Monitor,
) -> Result<Option<Attempt>> {
    let remaining = growth.by_similarity_to_meta_shape();
    let size = match (config.ordering, config.semantic) {
        (Ordering::Similarity, _) => 1,
        (_, false) => remaining.len().max(1),
        (_, true) => config.shortlist,
    };
    let mut best: Option<Attempt> = None;
    for shortlist in remaining.chunks(size) {
        monitor.check("registration")?;
        for attempt in growth.register_pairwise(shortlist) {
            let sufficient = attempt.refusal.is_none();
            // The list is ordered by similarity, then index: a tie keeps the earlier one.
            let better = |b: &Attempt| support(&attempt, config.ordering) > support(b, config.ordering);
            if sufficient && best.as_ref().is_none_or(better) {
                best = Some(attempt);
            }
        }
        if best.as_ref().is_some_and(|b| b.support.probability.is_none_or(|p| p >= config.evidence.confident))
        {
            break;
        }
    }
    Ok(best)
}

/// What decides among candidates.
fn support(attempt: &Attempt, ordering: Ordering) -> f64 {
    let inliers = attempt.support.inliers as f64;
    match ordering {
        Ordering::Inliers | Ordering::Similarity => inliers,
        Ordering::Overlap => attempt.support.overlap,
        Ordering::Probability => attempt.support.probability.unwrap_or(inliers),
    }
}
