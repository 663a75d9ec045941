//! A second look at placed scans with all that is known in the end.

use crate::registration::verification::verifier::{Assessment, RIVAL, fit_stride};
use crate::geometry::rigid::same_motion;
use crate::registration::agglomerative::pairs::ScanPair;
use super::reassignment::Claim;
use super::trial::REFUTED_RIVAL;
use super::agglomeration::{Assembly, Component, ComponentId};
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::monitor::Monitor;
use crate::scan::{Hold, ScanId, Support};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A component as it came out.
#[derive(Debug, Clone)]
pub struct Finished {
    /// Scans with their poses.
    pub component: Component,
    /// The evidence for each, in the order of the members.
    pub supports: Vec<Support>,
    /// How firmly each is held.
    pub holds: Vec<Hold>,
}

/// Other places for a scan that are looked at.
const PLACES: usize = 4;
/// Another place may be better when it has one in so many of the inliers of the present one.
const CONTENDER: usize = 2;
impl Assembly<'_> {
    /// The pairs that a scan is in, each with its other scan.
    pub(super) fn pairs_of(&self, scan: ScanId) -> Vec<(usize, ScanId)> {
        let other = |(p, pair): (usize, &ScanPair)| match scan {
            _ if scan == pair.j => Some((p, pair.i)),
            _ if scan == pair.i => Some((p, pair.j)),
            _ => None,
        };
        self.pairs.iter().enumerate().filter_map(other).collect()
    }

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

    /// How a member sits among the others of its component as it is, and the best place there is
    /// for it elsewhere among them.
    pub(super) fn place_of(&self, component: &Component, at: usize) -> (Assessment, Option<Assessment>) {
        let (scan, pose) = component.members[at];
        let rest: Vec<(ScanId, RigidMotion)> =
            component.members.iter().enumerate().filter(|m| m.0 != at).map(|m| *m.1).collect();
        let rest_poses: BTreeMap<ScanId, RigidMotion> = rest.iter().copied().collect();
        let alone = [(scan, RigidMotion::identity())];
        let own: BTreeMap<ScanId, RigidMotion> = alone.into_iter().collect();
        let (pairs, proposals) = self.proposals_for(scan, &self.pairs_of(scan), &rest_poses);
        let matches = self.matches_between(&pairs, &rest_poses, &own);
        let (group, single) = (self.posed(&rest), self.posed(&alone));
        let centre = self.assessor.models[scan.0].centre.cast::<f64>();
        let radius_m = self.assessor.radius_m;
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
        let others: Vec<Assessment> = self
            .assessor
            .assess(&group, &single, &contenders, &matches)
            .into_iter()
            .filter(|o| !same(&o.a_from_b, &pose))
            .collect();
        let there: Vec<Vec<usize>> = others
            .iter()
            .map(|o| &o.a_from_b)
            .chain(&rivals)
            .map(|motion| matches.inliers(motion, radius_m))
            .collect();
        let runner_up = self.assessor.runner_up(&matches, &pose, there.iter().map(Vec::as_slice));
        let refuted = if self.tried_out.contains(&scan) { REFUTED_RIVAL } else { 1 };
        let runner_up = runner_up.div_ceil(refuted);
        let current = self.assessor.measure(
            &group,
            &single,
            &pose,
            &matches,
            (here.len(), runner_up),
            fit_stride(&group, &single),
        );
        // Against the present place an alternative has that as one more rival.
        let best = others
            .into_iter()
            .map(|o| {
                let rival = self.assessor.runner_up(&matches, &o.a_from_b, [here.as_slice()].into_iter());
                let runner_up = o.support.runner_up.max(rival);
                let support = Support { runner_up, ..o.support };
                let probability = Some(self.assessor.probability(&support));
                Assessment { support: Support { probability, ..support }, ..o }
            })
            .max_by(|x, y| x.probability().total_cmp(&y.probability()));
        (current, best)
    }

    /// Looks at every placed scan again with all that is known now: one that fits better
    /// elsewhere moves there, one that is not supported any more is taken out, once. Returns how
    /// many changed.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn review(&mut self, monitor: &dyn Monitor) -> Result<usize> {
        let mut changed = 0;
        let mut claimed: Vec<(ScanId, Claim)> = Vec::new();
        for id in self.components.keys().copied().collect::<Vec<_>>() {
            monitor.check("registration")?;
            let component = &self.components[&id];
            if component.members.len() < 3 || self.reviewed.contains_key(&id) {
                continue;
            }
            let places: Vec<(Assessment, Option<Assessment>)> =
                (0..component.members.len()).into_par_iter().map(|m| self.place_of(component, m)).collect();
            let claims: Vec<Option<Claim>> = (&component.members, &places)
                .into_par_iter()
                .map(|(member, (current, _))| self.better_claim(id, member.0, current))
                .collect();
            let (mut out, before) = (Vec::new(), changed);
            let former = component.members.clone();
            let mut component = component.clone();
            for ((member, (current, elsewhere)), claim) in
                component.members.iter_mut().zip(&places).zip(claims)
            {
                if let Some(claim) = claim {
                    let there = &claim.assessment.support;
                    tracing::debug!(
                        "review: scan {} is claimed, {:?} by {there:?}",
                        member.0,
                        current.support
                    );
                    out.push(member.0);
                    claimed.push((member.0, claim));
                    changed += 1;
                    continue;
                }
                let better = elsewhere.filter(|e| {
                    e.probability() >= self.config().evidence.accept
                        && e.probability() > current.probability()
                });
                if let Some(better) = better {
                    tracing::debug!(
                        "review: scan {} moves, {:?} to {:?}",
                        member.0,
                        current.support,
                        better.support
                    );
                    member.1 = better.a_from_b;
                    changed += 1;
                } else if current.probability() < 0.5 && !self.taken_out.contains(&member.0) {
                    tracing::debug!("review: scan {} is taken out, {:?}", member.0, current.support);
                    out.push(member.0);
                    changed += 1;
                }
            }
            if changed == before {
                self.reviewed.insert(id, places.into_iter().map(|p| p.0.support).collect());
                continue;
            }
            let taken_out = former.iter().filter(|m| out.contains(&m.0)).copied();
            let changes: Vec<(ScanId, RigidMotion)> =
                self.moved(&former, &component.members).into_iter().chain(taken_out).collect();
            for key in self.touched_links(id, &changes) {
                self.links.remove(&key);
            }
            component.members.retain(|m| !out.contains(&m.0));
            self.components.insert(id, component);
            self.settled.remove(&id);
            self.taken_out.extend(&out);
            for scan in out {
                let alone = Component {
                    members: vec![(scan, RigidMotion::identity())],
                    joins: Vec::new(),
                    refined_at: 1,
                };
                self.components.insert(self.next, alone);
                self.next += 1;
            }
        }
        self.components.retain(|_, c| !c.members.is_empty());
        if changed > 0 {
            self.relink();
        }
        self.join_claimed(&claimed);
        Ok(changed)
    }

    /// The finished components, each with the final support of every member and how firmly it is held;
    /// of a scan alone the support of the best join that it was offered.
    pub fn finish(self) -> Vec<Finished> {
        let offered = |id: ComponentId| {
            let links = self.links.iter().filter(|(key, _)| key.0 == id || key.1 == id);
            // The last refinement may have made links anew: then they are looked at once more.
            let best = links
                .filter_map(|(key, link)| link.best().or_else(|| self.assess(*key, link).first().copied()));
            best.max_by(|x, y| x.0.probability().total_cmp(&y.0.probability()))
                .map_or_else(Support::default, |a| a.0.support)
        };
        let supports: Vec<Vec<Support>> = self
            .components
            .iter()
            .map(|(&id, c)| match (c.members.len(), self.reviewed.get(&id)) {
                (1, _) => vec![offered(id)],
                (n, known) => (0..n)
                    .into_par_iter()
                    .map(|m| known.map_or_else(|| self.place_of(c, m).0.support, |supports| supports[m]))
                    .zip(&c.members)
                    .map(|(support, member)| self.against_others(id, member.0, support))
                    .collect(),
            })
            .collect();
        let holds: Vec<Vec<Hold>> = self.components.values().map(|c| self.holds(c)).collect();
        let finished = self.components.into_values().zip(supports).zip(holds);
        finished.map(|((component, supports), holds)| Finished { component, supports, holds }).collect()
    }
}
