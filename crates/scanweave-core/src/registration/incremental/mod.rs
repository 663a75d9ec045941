//! Incremental multiview registration: the paper's algorithm, in its own steps.
//!
//! Li, Zhu, Xie & Zhu, "Incremental Multiview Point Cloud Registration with Two-stage
//! Candidate Retrieval" (Pattern Recognition 2025).
//!
//! ```text
//! 1  pivot: argmax_i Σ_j S_ij over the scans left; its features are the meta-shape
//! 2  repeat:
//! 2a     first stage: the k scans most similar to the meta-shape
//! 2b     second stage: register each with the meta-shape, verify it, keep the best
//! 2c     average the transformation over the registered scans that it overlaps
//! 2d     merge it into the meta-shape by reservoir sampling; S_meta = max(S_meta, S_j)
//! 3  where no scan left suffices: refine the component by multiview ICP, go on with 1
//! 4  one outcome a scan
//! ```
//!
//! This file says when each step happens; `growth.rs` says how.

mod candidate;
mod conclusion;
pub(super) mod config;
mod growth;
mod meta_shape;
mod transformation_averaging;

use super::config::{IncrementalConfig, Ordering, RegistrationConfig};
use super::input::{Lengths, ScanInput};
use crate::error::Result;
use crate::monitor::Monitor;
use crate::scan::{Reconstruction, SimilarityMatrix};
use growth::{Attempt, Growth};

/// Registers all scans; see [`super::register`], which checked the arguments.
///
/// # Errors
/// Only when the monitor is cancelled.
pub(super) fn register(
    scans: &[ScanInput<'_>],
    similarity: &SimilarityMatrix,
    config: &RegistrationConfig,
    settings: &IncrementalConfig,
    lengths: Lengths,
    seed: u64,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    monitor.begin("register", scans.len());
    let mut growth = Growth::new(scans, similarity, config, settings, lengths, seed);
    // 1
    while let Some(pivot) = growth.most_connected_scan() {
        growth.start_meta_shape(pivot);
        monitor.advance(1);
        // 2, 2a, 2b
        while let Some(chosen) = retrieve_and_verify(&mut growth, config, settings, monitor)? {
            // 2c
            let world_from_scan = growth.average_transformation(&chosen);
            // 2d
            growth.merge(&chosen, world_from_scan);
            growth.refine_if_due(monitor)?;
            monitor.advance(1);
        }
        // 3
        growth.close_component(monitor)?;
    }
    monitor.end();
    // 4
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
    settings: &IncrementalConfig,
    monitor: &dyn Monitor,
) -> Result<Option<Attempt>> {
    let remaining = growth.by_similarity_to_meta_shape();
    let size = match (settings.ordering, settings.semantic) {
        (Ordering::Similarity, _) => 1,
        (_, false) => remaining.len().max(1),
        (_, true) => settings.shortlist,
    };
    let confident = config.verification.surfaces().map_or(0.0, |c| c.confident);
    let mut best: Option<Attempt> = None;
    for shortlist in remaining.chunks(size) {
        monitor.check("registration")?;
        for attempt in growth.register_pairwise(shortlist) {
            let sufficient = attempt.refusal.is_none();
            // The list is ordered by similarity, then index: a tie keeps the earlier one.
            let better = |b: &Attempt| merit(&attempt, settings.ordering) > merit(b, settings.ordering);
            if sufficient && best.as_ref().is_none_or(better) {
                best = Some(attempt);
            }
        }
        if best.as_ref().is_some_and(|b| b.evidence.probability.is_none_or(|p| p >= confident)) {
            break;
        }
    }
    Ok(best)
}

/// What decides among candidates.
fn merit(attempt: &Attempt, ordering: Ordering) -> f64 {
    let inliers = attempt.evidence.inliers as f64;
    match ordering {
        Ordering::Inliers | Ordering::Similarity => inliers,
        Ordering::Overlap => attempt.evidence.overlap,
        Ordering::Probability => attempt.evidence.probability.unwrap_or(inliers),
    }
}
