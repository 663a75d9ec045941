//! The evidence of every placement with all that is known in the end.

use super::agglomeration::{Agglomeration, Component, ComponentId};
use super::trial::REFUTED_RIVAL;
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::geometry::rigid::same_motion;
use crate::monitor::Monitor;
use crate::registration::verification::probability;
use crate::registration::verification::verifier::{RIVAL, ScoredHypothesis, fit_stride};
use crate::scan::{Evidence, PoseUncertainty, ScanId};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A component as it came out.
#[derive(Debug, Clone)]
pub struct Finished {
    /// Scans with their poses.
    pub component: Component,
    /// The evidence for each, in the order of the members.
    pub member_evidence: Vec<Evidence>,
    /// How firmly each is held.
    pub uncertainties: Vec<PoseUncertainty>,
}

/// Other places for a scan that are looked at.
const PLACES: usize = 4;
/// Another place may be better when it has one in so many of the inliers of the present one.
const CONTENDER: usize = 2;

impl Agglomeration<'_> {
    /// Of the pairs that a scan is in, those with scans of a group, and the poses in the group that their
    /// hypotheses give it, each with its probability; most probable first.
    pub(super) fn proposals_for(
        &self,
        scan: ScanId,
        pairs: &[(usize, ScanId)],
        group: &BTreeMap<ScanId, RigidMotion>,
    ) -> (Vec<usize>, Vec<(RigidMotion, f64)>) {
        let (mut linking, mut proposals) = (Vec::new(), Vec::new());
        for (p, other) in pairs {
            let Some(world_from_other) = group.get(other) else { continue };
            let pair = &self.pairs[*p];
            linking.push(*p);
            proposals.extend(pair.hypotheses.iter().map(|h| {
                let other_from_scan = if scan == pair.j { h.a_from_b } else { h.a_from_b.inverse() };
                (world_from_other * other_from_scan, h.probability())
            }));
        }
        proposals.sort_by(|x, y| y.1.total_cmp(&x.1));
        (linking, proposals)
    }

    /// How a member sits among the others of its component as it is, other places for it among them as
    /// rivals.
    fn final_score(&self, component: &Component, at: usize) -> ScoredHypothesis {
        let (scan, pose) = component.members[at];
        let rest: Vec<(ScanId, RigidMotion)> =
            component.members.iter().enumerate().filter(|m| m.0 != at).map(|m| *m.1).collect();
        let rest_poses: BTreeMap<ScanId, RigidMotion> = rest.iter().copied().collect();
        let alone = [(scan, RigidMotion::identity())];
        let own: BTreeMap<ScanId, RigidMotion> = alone.into_iter().collect();
        let (pairs, proposals) = self.proposals_for(scan, &self.pairs_of(scan), &rest_poses);
        let matches = self.matches_between(&pairs, &rest_poses, &own);
        let (group, single) = (self.posed(&rest), self.posed(&alone));
        let centre = self.verifier.models[scan.0].centre.cast::<f64>();
        let radius_m = self.verifier.radius_m;
        let same = |x: &RigidMotion, y: &RigidMotion| same_motion(x, y, &centre, radius_m);
        let here = matches.inliers(&pose, radius_m);
        let mut elsewhere: Vec<RigidMotion> = Vec::new();
        for (motion, _) in &proposals {
            if elsewhere.len() < PLACES
                && !same(motion, &pose)
                && !elsewhere.iter().any(|m| same(m, motion))
                && matches.count(motion, radius_m) * RIVAL >= here.len()
            {
                elsewhere.push(*motion);
            }
        }
        // What has far fewer inliers speaks against the present place as it is, and cannot win.
        let (contenders, rivals): (Vec<RigidMotion>, Vec<RigidMotion>) =
            elsewhere.into_iter().partition(|m| CONTENDER * matches.count(m, radius_m) >= here.len());
        let others: Vec<ScoredHypothesis> = self
            .verifier
            .score_each(&group, &single, &contenders, &matches)
            .into_iter()
            .filter(|o| !same(&o.a_from_b, &pose))
            .collect();
        let there: Vec<Vec<usize>> = others
            .iter()
            .map(|o| &o.a_from_b)
            .chain(&rivals)
            .map(|motion| matches.inliers(motion, radius_m))
            .collect();
        let second_best_inliers =
            self.verifier.second_best_inliers(&matches, &pose, there.iter().map(Vec::as_slice));
        let tried_out = self.tried_out.contains(&scan);
        let second_best_inliers = second_best_inliers.div_ceil(if tried_out { REFUTED_RIVAL } else { 1 });
        let mut scored = self.verifier.measure(
            &group,
            &single,
            &pose,
            &matches,
            (here.len(), second_best_inliers),
            fit_stride(&group, &single),
        );
        if !tried_out {
            let rivals = others.iter().map(ScoredHypothesis::probability);
            let among = probability::among_rivals(scored.probability(), rivals);
            scored.evidence.probability = Some(among);
        }
        scored
    }

    /// The finished components, each with the final evidence of every member and how firmly it is held;
    /// of a scan alone the evidence of the best join that it was offered.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn finish(self, monitor: &dyn Monitor) -> Result<Vec<Finished>> {
        let mut edges_of: BTreeMap<ComponentId, Vec<(ComponentId, ComponentId)>> = BTreeMap::new();
        for &key in self.edges.keys() {
            [key.0, key.1].iter().for_each(|id| edges_of.entry(*id).or_default().push(key));
        }
        let offered = |id: ComponentId| {
            let edges = edges_of.get(&id).into_iter().flatten().map(|key| (key, &self.edges[key]));
            // The last refinement may have made edges anew: then they are looked at once more.
            let best = edges
                .filter_map(|(key, edge)| edge.best().or_else(|| self.score(*key, edge).first().copied()));
            best.max_by(|x, y| x.0.probability().total_cmp(&y.0.probability()))
                .map_or_else(Evidence::default, |a| a.0.evidence)
        };
        let evidence_of_members = |(&id, c): (&ComponentId, &Component)| {
            let of_member = |m: usize| {
                monitor.check("registration")?;
                Ok(match c.members.len() {
                    1 => offered(id),
                    _ => self.against_others(id, c.members[m].0, self.final_score(c, m).evidence),
                })
            };
            (0..c.members.len()).into_par_iter().map(of_member).collect::<Result<Vec<Evidence>>>()
        };
        let member_evidence: Vec<Vec<Evidence>> =
            self.components.iter().map(evidence_of_members).collect::<Result<_>>()?;
        let uncertainties_of = |c: &Component| {
            monitor.check("registration")?;
            Ok(self.uncertainties(c))
        };
        let uncertainties: Vec<Vec<PoseUncertainty>> =
            self.components.values().map(uncertainties_of).collect::<Result<_>>()?;
        let finished = self.components.into_values().zip(member_evidence).zip(uncertainties);
        let finished = finished.map(|((component, member_evidence), uncertainties)| Finished {
            component,
            member_evidence,
            uncertainties,
        });
        Ok(finished.collect())
    }
}
