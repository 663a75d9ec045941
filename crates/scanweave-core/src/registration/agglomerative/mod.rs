//! Agglomerative registration, the default: components join, the most certain join first.
//!
//! The published method grows one meta-shape from one pivot and takes the best candidate that there
//! is at each step. Here every scan starts as a component of its own, any two components may join,
//! and the most certain join of all is made first. What is doubtful waits until both sides have
//! grown and more scans speak for it or against it.
//!
//! ```text
//! 1  register every scan with the scans most similar to it, and those that rough poses put beside it; score the hypotheses of every pair
//! 2  find out from the pairs with most matches how well surfaces fit, from the surest how far each viewpoint is
//!    reliable, and from what wrong hypotheses look like how much places resemble each other; score again
//! 3  every usable scan is a component
//! 4  repeat for every retrieval round:
//! 4a     make the certain joins, the most probable first
//! 4b     register more pairs for the scans that are left apart
//! 5  repeat: make the acceptable joins, the most probable first;
//! 5a     where none is left, try joins out with all poses refined, and make those that suffice
//! 6  refine all poses by multiview ICP; register the pairs that close loops at these poses, and refine again
//! 7  measure the final evidence and the uncertainty of every pose
//! ```
//!
//! This file says when each step happens; [`agglomeration`] and its siblings say how.

mod agglomeration;
mod conclusion;
pub(super) mod config;
mod cycles;
mod edge;
mod final_evidence;
pub(super) mod first_round;
mod loops;
pub(crate) mod pairs;
mod refinement;
mod rival_components;
mod trial;
mod uncertainty;

pub use agglomeration::{Agglomeration, Component, Join, Proposal};
pub use final_evidence::Finished;

use super::config::{AgglomerativeConfig, RegistrationConfig, SurfaceVerification};
use super::input::{Lengths, MIN_KEYPOINTS, ScanInput};
use super::scan_model::ScanModel;
use super::usability;
use super::verification::verifier::Verifier;
use crate::error::Result;
use crate::monitor::Monitor;
use crate::scan::{DeclineReason, Reconstruction, ScanId, SimilarityMatrix};
use first_round::planned_pairs;
use pairs::{PairScorer, ScanPair, ScoredPairs, score_registered};
use rayon::prelude::*;

/// Registers all scans; see [`super::register_from`], which checked the arguments.
///
/// # Errors
/// Only when the monitor is cancelled.
pub(super) fn register(
    scans: &[ScanInput<'_>],
    similarity: &SimilarityMatrix,
    (config, settings, verification): (&RegistrationConfig, &AgglomerativeConfig, &SurfaceVerification),
    lengths: Lengths,
    seed: u64,
    first_round: Option<Vec<ScanPair>>,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    let mut refusals: Vec<Option<DeclineReason>> =
        scans.iter().map(|s| usability::unusable(s, MIN_KEYPOINTS, lengths.voxel_m)).collect();
    let usable: Vec<ScanId> = (0..scans.len()).filter(|&i| refusals[i].is_none()).map(ScanId).collect();
    let radius_m = lengths.inlier_radius_m;
    let mut models: Vec<ScanModel<'_>> =
        scans.par_iter().map(|s| ScanModel::new(s.surface, radius_m as f32, config)).collect();
    models.iter_mut().zip(scans).for_each(|(model, scan)| model.prior = scan.prior);
    // 1, 2
    let scorer = PairScorer::new(scans, &config.estimator, seed);
    let registered = match first_round {
        Some(pairs) => pairs,
        None => {
            let planned = planned_pairs(scans, similarity, &usable, settings);
            scorer.register(&planned, &Verifier::new(&models, verification, radius_m), monitor)?
        }
    };
    let ScoredPairs { pairs, aliasing, noise } =
        score_registered(registered, &mut models, verification, radius_m);
    let verifier = Verifier { aliasing, noise, ..Verifier::new(&models, verification, radius_m) };
    // 3
    let keypoints = scans.iter().map(|s| s.features.keypoints.as_slice()).collect();
    let mut agglomeration = Agglomeration::new(&verifier, config, keypoints, &usable);
    agglomeration.add_pairs(pairs);
    // 4
    for _ in 0..settings.retrieval_rounds {
        join_at_least(verification.confident, &mut agglomeration, monitor)?;
        let unseen = agglomeration.unseen_pairs(similarity);
        if unseen.is_empty() {
            break;
        }
        agglomeration.add_pairs(scorer.register(&unseen, &verifier, monitor)?);
    }
    // 5, 6
    let trials = settings.trials && config.multiview_icp.enabled;
    join_all(verification.accept, trials, &mut agglomeration, monitor)?;
    agglomeration.refine_all(monitor)?;
    if settings.close_loops {
        let open = agglomeration.open_loops(similarity);
        tracing::debug!("{} pairs may close loops", open.len());
        if !open.is_empty() {
            let closing = scorer.register(&open, &verifier, monitor)?;
            let sure = |p: &&ScanPair| p.hypotheses.first().is_some_and(|h| h.probability() >= 0.5);
            let sure: Vec<_> = closing.iter().filter(sure).map(|p| (p.i, p.j)).collect();
            tracing::debug!("{} of them do", sure.len());
            agglomeration.unsettle(&sure);
            agglomeration.add_pairs(closing);
            agglomeration.refine_all(monitor)?;
        }
    }
    // 7
    let components = agglomeration.finish(monitor)?;
    Ok(conclusion::conclude(scans, components, &mut refusals, &verifier, config))
}

/// Makes joins that are at least so probable, the most certain first; whether one is left that is not.
fn join_at_least(
    probability: f64,
    agglomeration: &mut Agglomeration<'_>,
    monitor: &dyn Monitor,
) -> Result<bool> {
    while let Some(join) = agglomeration.best_join(monitor)? {
        let made = join.probability() >= probability;
        tracing::debug!(made, "{}", agglomeration.describe(&join));
        if !made {
            return Ok(true);
        }
        agglomeration.join(&join);
        agglomeration.refine_grown(monitor)?;
    }
    Ok(false)
}

/// Makes joins, the most certain first, until none is probable enough and no trial finds one.
fn join_all(
    accept: f64,
    trials: bool,
    agglomeration: &mut Agglomeration<'_>,
    monitor: &dyn Monitor,
) -> Result<()> {
    // 5, 5a
    while join_at_least(accept, agglomeration, monitor)? && trials && agglomeration.join_by_trial(monitor)? {
        agglomeration.refine_grown(monitor)?;
    }
    Ok(())
}
