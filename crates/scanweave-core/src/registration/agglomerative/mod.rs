//! Registration by joining components, strongest evidence first.
//!
//! The published method grows one meta-shape from one pivot and must take the best candidate
//! there is at each step. Here every scan starts as a meta-shape of its own, any two may join,
//! and the most certain join of all is made first: what is doubtful waits until both sides have
//! grown and more scans can speak for it or against it. So do the pairs: few are registered at
//! first, and more where the certain joins of these left scans apart.

mod agglomeration;
mod edge;
pub mod pairs;
mod reassignment;
mod refinement;
mod review;
mod trial;
mod uncertainty;

pub use agglomeration::{Assembly, Component, Join, Proposal};
pub use review::Finished;

use crate::registration::verification::verifier::Assessor;
use crate::registration::config::RegistrationConfig;
use crate::registration::verification::decline;
use crate::registration::verification::probability;
use crate::registration::input::{Lengths, MIN_KEYPOINTS, ScanInput};
use crate::registration::neighbours::neighbours;
use crate::registration::agglomerative::pairs::{PairRegistration, most_similar_pairs};
use crate::registration::scan_model::ScanModel;
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::geometry::neighbours::RadiusGrid;
use crate::monitor::Monitor;
use crate::scan::{DeclineReason, Outcome, Placement, Reconstruction, ScanId, SimilarityMatrix, Support};
use rayon::prelude::*;
use std::collections::{BTreeMap, VecDeque};

/// Looks back at placed scans at most this often.
const REVIEWS: usize = 3;

/// Registers all scans; see [`crate::registration::input::register`], which checked the arguments.
///
/// # Errors
/// Only when the monitor is cancelled.
pub(super) fn register(
    scans: &[ScanInput<'_>],
    similarity: &SimilarityMatrix,
    config: &RegistrationConfig,
    lengths: Lengths,
    seed: u64,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    let mut refusals: Vec<Option<DeclineReason>> =
        scans.iter().map(|s| decline::unusable(s, MIN_KEYPOINTS, lengths.voxel_m)).collect();
    let usable: Vec<ScanId> = (0..scans.len()).filter(|&i| refusals[i].is_none()).map(ScanId).collect();
    let radius_m = lengths.inlier_radius_m;
    let models: Vec<ScanModel<'_>> =
        scans.par_iter().map(|s| ScanModel::new(s.surface, radius_m as f32, config)).collect();
    let mut assessor = Assessor { models: &models, config, radius_m, sight_trusted: false };
    let retrieved = most_similar_pairs(similarity, &usable, config.assembly.neighbours);
    let pairwise = PairRegistration::new(scans, seed);
    let mut pairs = pairwise.register(&retrieved, &assessor, monitor)?;
    let surest = pairs.iter().filter_map(|p| Some(&p.hypotheses.first()?.support));
    assessor.sight_trusted = probability::sight_is_trustworthy(surest, &config.evidence.weights);
    tracing::debug!("viewpoints are believed: {}", assessor.sight_trusted);
    pairs.iter_mut().for_each(|pair| pair.reassess(&assessor));

    let keypoints = scans.iter().map(|s| s.features.keypoints.as_slice()).collect();
    let mut assembly = Assembly::new(&assessor, keypoints, &usable);
    assembly.add_pairs(pairs);
    for _ in 0..config.assembly.further_looks {
        join_at_least(config.evidence.confident, &mut assembly, monitor)?;
        let unseen = assembly.unseen_pairs(similarity);
        if unseen.is_empty() {
            break;
        }
        assembly.add_pairs(pairwise.register(&unseen, &assessor, monitor)?);
    }
    join_all(&mut assembly, config, monitor)?;
    assembly.refine_all(monitor)?;
    tracing::debug!("all poses refined");
    for _ in 0..if config.assembly.review { REVIEWS } else { 0 } {
        if assembly.review(monitor)? == 0 {
            break;
        }
        join_all(&mut assembly, config, monitor)?;
        assembly.refine_all(monitor)?;
    }
    tracing::debug!("review ends");
    let components = assembly.finish();
    tracing::debug!("supports measured");
    Ok(conclude(scans, components, &mut refusals, &assessor))
}

/// Makes joins that are at least so probable, the most certain first; whether one is left that is not.
fn join_at_least(probability: f64, assembly: &mut Assembly<'_>, monitor: &dyn Monitor) -> Result<bool> {
    while let Some(join) = assembly.best_join(monitor)? {
        let made = join.probability() >= probability;
        tracing::debug!(made, "{}", assembly.describe(&join));
        if !made {
            return Ok(true);
        }
        assembly.join(&join);
        assembly.refine_grown(monitor)?;
    }
    Ok(false)
}

/// Makes joins, the most certain first, until none is certain enough and no trial finds one.
fn join_all(assembly: &mut Assembly<'_>, config: &RegistrationConfig, monitor: &dyn Monitor) -> Result<()> {
    let trials = config.assembly.trials && config.joint.enabled;
    while join_at_least(config.evidence.accept, assembly, monitor)?
        && trials
        && assembly.join_by_trial(monitor)?
    {
        assembly.refine_grown(monitor)?;
    }
    Ok(())
}

/// One outcome a scan; components ordered by size, then by their first scan.
fn conclude(
    scans: &[ScanInput<'_>],
    mut components: Vec<Finished>,
    refusals: &mut [Option<DeclineReason>],
    assessor: &Assessor<'_>,
) -> Reconstruction {
    let Assessor { models, config, radius_m, .. } = *assessor;
    let lowest = |c: &Component| c.members.iter().map(|m| m.0).min();
    components.sort_by_key(|f| (std::cmp::Reverse(f.component.members.len()), lowest(&f.component)));
    let grids: Vec<RadiusGrid<'_>> =
        scans.par_iter().map(|s| RadiusGrid::new(&s.features.keypoints, radius_m as f32)).collect();
    for Finished { component, supports, .. } in components.iter().filter(|f| f.component.members.len() == 1) {
        let (alone, support) = (component.members[0].0, supports[0]);
        refusals[alone.0] = decline::refusal(&support, &config.evidence);
    }
    let unexplained = DeclineReason::TooFewInliers {
        inliers: 0,
        needed: config.evidence.min_inliers.max(MIN_KEYPOINTS),
        matches: 0,
    };
    let mut outcomes: Vec<Outcome> = refusals
        .iter_mut()
        .map(|r| Outcome::Declined(r.take().unwrap_or_else(|| unexplained.clone())))
        .collect();
    let joined = components.iter().filter(|f| f.component.members.len() > 1);
    for (number, Finished { component, supports, holds }) in joined.enumerate() {
        let order = tree_order(component);
        let neighbours = neighbours(&component.members, &grids, models);
        for (m, neighbours) in neighbours.into_iter().enumerate() {
            let (scan, world_from_scan) = component.members[m];
            let (step, link) = order.get(&scan).copied().unwrap_or((component.members.len(), None));
            let support = Support { parent_from_scan: link.map(|l| l.1), ..supports[m] };
            let parent = link.map(|l| l.0);
            outcomes[scan.0] = Outcome::Placed(Placement {
                world_from_scan,
                component: number,
                step,
                parent,
                matches: support.matches,
                inliers: support.inliers,
                residual_m: support.plane_residual * radius_m,
                support: Some(support),
                neighbours,
                hold: Some(Box::new(holds[m])),
            });
        }
    }
    Reconstruction { outcomes }
}

/// Step of every scan, its parent and its pose relative to the parent when the two joined:
/// breadth first over the joins, from the pivot, earlier joins first.
fn tree_order(component: &Component) -> BTreeMap<ScanId, (usize, Option<(ScanId, RigidMotion)>)> {
    let pivot = component.members[0].0;
    let mut order = BTreeMap::from([(pivot, (0, None))]);
    let mut queue = VecDeque::from([pivot]);
    while let Some(scan) = queue.pop_front() {
        for join in &component.joins {
            let (other, scan_from_other) = match join.scans {
                (a, b) if a == scan => (b, join.first_from_second),
                (a, b) if b == scan => (a, join.first_from_second.inverse()),
                _ => continue,
            };
            let step = order.len();
            order.entry(other).or_insert_with(|| {
                queue.push_back(other);
                (step, Some((scan, scan_from_other)))
            });
        }
    }
    order
}
