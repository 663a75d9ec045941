//! From finished components to one outcome a scan.

use super::{Component, Finished};
use crate::geometry::RigidMotion;
use crate::geometry::neighbours::RadiusGrid;
use crate::registration::config::RegistrationConfig;
use crate::registration::input::{MIN_KEYPOINTS, ScanInput};
use crate::registration::neighbours::neighbours;
use crate::registration::verification::decline;
use crate::registration::verification::verifier::Verifier;
use crate::scan::{DeclineReason, Evidence, Outcome, Placement, Reconstruction, ScanId};
use rayon::prelude::*;
use std::collections::{BTreeMap, VecDeque};

/// One outcome a scan; components ordered by size, then by their first scan.
pub(super) fn conclude(
    scans: &[ScanInput<'_>],
    mut components: Vec<Finished>,
    refusals: &mut [Option<DeclineReason>],
    verifier: &Verifier<'_>,
    config: &RegistrationConfig,
) -> Reconstruction {
    let Verifier { models, radius_m, .. } = *verifier;
    let lowest = |c: &Component| c.members.iter().map(|m| m.0).min();
    components.sort_by_key(|f| (std::cmp::Reverse(f.component.members.len()), lowest(&f.component)));
    let grids: Vec<RadiusGrid<'_>> =
        scans.par_iter().map(|s| RadiusGrid::new(&s.features.keypoints, radius_m as f32)).collect();
    for Finished { component, member_evidence, .. } in
        components.iter().filter(|f| f.component.members.len() == 1)
    {
        let (alone, evidence) = (component.members[0].0, member_evidence[0]);
        refusals[alone.0] = decline::refusal(&evidence, &config.verification);
    }
    let unexplained = DeclineReason::TooFewInliers {
        inliers: 0,
        needed: config.verification.min_inliers().max(MIN_KEYPOINTS),
        matches: 0,
    };
    let mut outcomes: Vec<Outcome> = refusals
        .iter_mut()
        .map(|r| Outcome::Declined(r.take().unwrap_or_else(|| unexplained.clone())))
        .collect();
    let joined = components.iter().filter(|f| f.component.members.len() > 1);
    for (number, Finished { component, member_evidence, uncertainties }) in joined.enumerate() {
        let order = tree_order(component);
        let neighbours = neighbours(&component.members, &grids, models);
        for (m, neighbours) in neighbours.into_iter().enumerate() {
            let (scan, world_from_scan) = component.members[m];
            let (step, edge) = order.get(&scan).copied().unwrap_or((component.members.len(), None));
            let evidence = Evidence { parent_from_scan: edge.map(|l| l.1), ..member_evidence[m] };
            let parent = edge.map(|l| l.0);
            outcomes[scan.0] = Outcome::Placed(Placement {
                world_from_scan,
                component: number,
                step,
                parent,
                matches: evidence.matches,
                inliers: evidence.inliers,
                residual_m: evidence.plane_residual * radius_m,
                evidence: Some(evidence),
                neighbours,
                pose_uncertainty: Some(Box::new(uncertainties[m])),
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
