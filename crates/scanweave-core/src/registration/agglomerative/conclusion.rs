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
            let unjoined = Place { step: component.members.len(), edge: None, weakest: 1.0 };
            let place = order.get(&scan).copied().unwrap_or(unjoined);
            let evidence = place.evidence(&member_evidence[m]);
            outcomes[scan.0] = Outcome::Placed(Placement {
                world_from_scan,
                component: number,
                step: place.step,
                parent: place.edge.map(|l| l.0),
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

/// Where a scan stands in the tree of joins.
#[derive(Debug, Clone, Copy)]
struct Place {
    step: usize,
    /// Its parent and its pose relative to it when the two joined; none for the pivot.
    edge: Option<(ScanId, RigidMotion)>,
    /// Lowest probability of a join between it and the pivot; 1 for the pivot.
    weakest: f64,
}

impl Place {
    /// What is stated of a scan that stands here, by what was `measured` at its pose: no more than of the
    /// weakest join. Where that turned one side, its scans still stand right beside each other.
    fn evidence(&self, measured: &Evidence) -> Evidence {
        Evidence {
            parent_from_scan: self.edge.map(|edge| edge.1),
            probability: measured.probability.map(|p| p.min(self.weakest)),
            ..*measured
        }
    }
}

/// The place of every scan: breadth first over the joins, from the pivot, earlier joins first.
fn tree_order(component: &Component) -> BTreeMap<ScanId, Place> {
    let pivot = component.members[0].0;
    let mut order = BTreeMap::from([(pivot, Place { step: 0, edge: None, weakest: 1.0 })]);
    let mut queue = VecDeque::from([pivot]);
    while let Some(scan) = queue.pop_front() {
        let so_far = order.get(&scan).map_or(1.0, |place| place.weakest);
        for join in &component.joins {
            let (other, scan_from_other) = match join.scans {
                (a, b) if a == scan => (b, join.first_from_second),
                (a, b) if b == scan => (a, join.first_from_second.inverse()),
                _ => continue,
            };
            let step = order.len();
            let weakest = so_far.min(join.evidence.probability.unwrap_or(1.0));
            order.entry(other).or_insert_with(|| {
                queue.push_back(other);
                Place { step, edge: Some((scan, scan_from_other)), weakest }
            });
        }
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::agglomerative::Join;

    #[test]
    fn a_scan_is_as_probable_as_the_weakest_join_on_its_way_to_the_pivot() {
        let at = |k: usize| (ScanId(k), RigidMotion::identity());
        let join = |a: usize, b: usize, probability: f64| Join {
            scans: (ScanId(a), ScanId(b)),
            first_from_second: RigidMotion::identity(),
            evidence: Evidence { probability: Some(probability), ..Evidence::default() },
        };
        // 2–0 and 0–3 hang on the pivot 2; 1–4 was joined to 3 last.
        let component = Component {
            members: vec![at(2), at(0), at(3), at(1), at(4)],
            joins: vec![join(0, 2, 0.99), join(0, 3, 0.97), join(1, 4, 0.98), join(3, 1, 0.7)],
            refined_at: 5,
        };
        let order = tree_order(&component);
        let weakest: Vec<f64> = (0..5).map(|k| order[&ScanId(k)].weakest).collect();
        assert_eq!(weakest, [0.99, 0.7, 1.0, 0.97, 0.7]);
        assert_eq!(order[&ScanId(4)].step, 4);
        let stated = |scan: usize, measured: f64| {
            let measured = Evidence { probability: Some(measured), ..Evidence::default() };
            order[&ScanId(scan)].evidence(&measured).probability
        };
        assert_eq!([stated(1, 0.99), stated(1, 0.6), stated(2, 0.95)], [Some(0.7), Some(0.6), Some(0.95)]);
    }
}
