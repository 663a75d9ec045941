//! Joins that are judged after all poses were refined as if they had been made.
//!
//! Errors add up inside a component, so that even the right join of two large ones does not fit
//! well before its poses give way; and two places that look alike give more inliers than a narrow
//! overlap does, until a trial shows that nothing can make them fit.

use super::agglomeration::{Agglomeration, Component, ComponentId, Proposal};
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::geometry::rigid::same_motion;
use crate::monitor::Monitor;
use crate::registration::agglomerative::pairs::ScanPair;
use crate::registration::config::MultiviewIcpConfig;
use crate::registration::verification::probability;
use crate::registration::verification::verifier::{ScoredHypothesis, fit_stride};
use crate::scan::{Evidence, ScanId};
use nalgebra::Point3;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Proposals that are tried at a time.
const TRIALS: usize = 10;
/// Of them, proposals for the same two components.
const TRIALS_PER_EDGE: usize = 4;
/// Probability, rivals apart, from which a proposal is tried.
pub(super) const WORTH_TRYING: f64 = 0.01;
/// Free-space violation, with usual noise, that no trial makes good.
const HOPELESS: f64 = 0.3;
/// Probability, rivals apart, up to which a trial has refuted a proposal: what viewpoints contradict has
/// no more.
const REFUTED: f64 = 0.5;

/// One in so many of the inliers of a refuted rival count: that many matches agree by chance or
/// likeness here, even if on something impossible.
pub(super) const REFUTED_RIVAL: usize = 4;

/// Scans of either side that a trial moves, those nearest to the other side: what is far away decides
/// little, and trials must not cost more, the larger the whole is.
const VICINITY: usize = 40;

/// A join that was tried.
struct Trial {
    key: (ComponentId, ComponentId),
    proposal: Proposal,
    /// What the trial moved, with the refined poses.
    refined: Component,
    /// Whether that is all of both components.
    whole: bool,
    /// The scans of the pair that proposed the join, of the first component and of the second.
    junction: (ScanId, ScanId),
    /// The motion of the second component that the refined poses of these two give.
    a_from_b: RigidMotion,
    /// Centre of the second of them, in the frame of its component.
    centre: Point3<f64>,
    /// The evidence after the refinement, as if there were no rival.
    evidence: Evidence,
}

impl Trial {
    /// Refined pose of scan `j` relative to `i`, where the trial moved both.
    pub(super) fn relative(&self, (i, j): (ScanId, ScanId)) -> Option<RigidMotion> {
        let pose = |scan: ScanId| self.refined.members.iter().find(|m| m.0 == scan).map(|m| m.1);
        Some(pose(i)?.inverse() * pose(j)?)
    }
}

impl Agglomeration<'_> {
    /// Tries the most promising joins and makes those that suffice, the most probable first, and of
    /// those that have a component in common one; `false` when none does.
    ///
    /// A rival that a trial refuted counts a quarter of its inliers, for a scan that joins alone from
    /// then on.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn join_by_trial(&mut self, monitor: &dyn Monitor) -> Result<bool> {
        let coarse = self.coarse();
        let worth = self.worth_trying();
        let trials: Result<Vec<Option<Trial>>> =
            worth.par_iter().map(|proposal| self.try_out(*proposal, &coarse, monitor)).collect();
        let trials: Vec<Trial> = trials?.into_iter().flatten().collect();
        let stated = |evidence: &Evidence| evidence.probability.unwrap_or(0.0);
        for trial in &trials {
            tracing::debug!("trial {}: then {:?}", self.describe(&trial.proposal), trial.evidence);
        }
        let mut sufficient: Vec<(usize, Evidence)> = (0..trials.len())
            .map(|at| (at, self.judged(&trials, at)))
            .filter(|(_, evidence)| stated(evidence) >= self.verifier.settings.accept)
            .collect();
        // One that suffices and cannot be made now has not failed: it is tried again.
        for key in worth.iter().map(|p| (p.a, p.b)) {
            if !sufficient.iter().any(|&(at, _)| trials[at].key == key) {
                self.edges.entry(key).and_modify(|edge| edge.tried = true);
            }
        }
        sufficient.sort_by(|x, y| stated(&y.1).total_cmp(&stated(&x.1)).then(x.0.cmp(&y.0)));
        let mut trials: Vec<Option<Trial>> = trials.into_iter().map(Some).collect();
        let mut any = false;
        for (at, evidence) in sufficient {
            let Some(trial) = trials[at].take() else { continue };
            if [trial.key.0, trial.key.1].iter().all(|id| self.components.contains_key(id)) {
                self.make(trial, evidence);
                any = true;
            }
        }
        Ok(any)
    }

    /// Makes a join that was tried.
    fn make(&mut self, trial: Trial, evidence: Evidence) {
        let Proposal { a, b, .. } = trial.proposal;
        for component in [a, b].map(|id| &self.components[&id]) {
            if let [(alone, _)] = component.members[..] {
                self.tried_out.insert(alone);
            }
        }
        if trial.whole {
            let mut joined = trial.refined;
            joined.joins.last_mut().into_iter().for_each(|join| join.evidence = evidence);
            self.replace(&[a, b], joined, None);
        } else {
            let scored = ScoredHypothesis { a_from_b: trial.a_from_b, evidence, ..trial.proposal.scored };
            self.join(&Proposal { scored, ..trial.proposal });
        }
    }

    fn probability(&self, evidence: &Evidence) -> f64 {
        self.verifier.probability(evidence)
    }

    /// Probability if there were no rival.
    pub(super) fn unrivalled(&self, evidence: &Evidence) -> f64 {
        self.probability(&Evidence { second_best_inliers: 0, ..*evidence })
    }

    /// Whether so much lies in space seen to be empty that no trial makes it good.
    fn is_seen_through(&self, evidence: &Evidence) -> bool {
        let violation = self.verifier.noise.scaled_violation(evidence.free_space_violation);
        self.verifier.settings.free_space && violation > HOPELESS
    }

    /// Proposals in the order in which they deserve a trial; edges that failed before do not.
    fn worth_trying(&self) -> Vec<Proposal> {
        let mut worth = Vec::new();
        for (key, edge) in &self.edges {
            let alone = self.components[&key.0].members.len() + self.components[&key.1].members.len() <= 2;
            if alone || edge.tried {
                continue;
            }
            let mut of_edge: Vec<(f64, ScoredHypothesis, usize)> = edge
                .scored
                .iter()
                .flatten()
                .map(|&(found, pair)| (self.unrivalled(&found.evidence), found, pair))
                .filter(|found| found.0 >= WORTH_TRYING)
                .filter(|found| !self.is_seen_through(&found.1.evidence))
                .collect();
            of_edge.sort_by(|x, y| y.0.total_cmp(&x.0));
            of_edge.truncate(TRIALS_PER_EDGE);
            worth.extend(of_edge.into_iter().map(|(p, found, pair)| (p, *key, found, pair)));
        }
        worth.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        worth.truncate(TRIALS);
        let proposal = |(_, (a, b), scored, pair)| Proposal { a, b, scored, pair };
        worth.into_iter().map(proposal).collect()
    }

    /// Makes a join on the side, refines the poses around it, and measures how the two sides then sit.
    fn try_out(
        &self,
        proposal: Proposal,
        coarse: &MultiviewIcpConfig,
        monitor: &dyn Monitor,
    ) -> Result<Option<Trial>> {
        let key = (proposal.a, proposal.b);
        let (ca, cb) = (&self.components[&key.0], &self.components[&key.1]);
        let pair = &self.pairs[proposal.pair];
        let a_from_b = proposal.scored.a_from_b;
        let near_a = self.vicinity(ca, cb, &a_from_b, pair);
        let near_b = self.vicinity(cb, ca, &a_from_b.inverse(), pair);
        let Some(mut joined) = self.joined(&near_a, &near_b, &proposal) else { return Ok(None) };
        let newcomers: BTreeSet<ScanId> = near_b.members.iter().map(|m| m.0).collect();
        self.refine_component(&mut joined, &newcomers, coarse, monitor)?;
        let (b, a): (Vec<_>, Vec<_>) = joined.members.iter().partition(|m| newcomers.contains(&m.0));
        // The pair's scan of a component: its pose there and in the refined whole.
        let junction = |component: &Component| {
            let (scan, there) = component.members.iter().find(|m| [pair.i, pair.j].contains(&m.0))?;
            let here = joined.members.iter().find(|m| m.0 == *scan)?.1;
            Some((*scan, *there, here))
        };
        let (Some((i, in_a, first)), Some((j, in_b, second))) = (junction(ca), junction(cb)) else {
            return Ok(None);
        };
        let a_from_b = in_a * first.inverse() * second * in_b.inverse();
        let centre = in_b * self.verifier.models[j.0].centre.cast::<f64>();
        let poses = |m: &[(ScanId, RigidMotion)]| m.iter().copied().collect::<BTreeMap<_, _>>();
        let matches = self.matches_between(&self.edges[&key].pairs, &poses(&a), &poses(&b));
        let stay = RigidMotion::identity();
        let inliers = matches.count(&stay, self.verifier.radius_m);
        let (a, b) = (self.posed(&a), self.posed(&b));
        let evidence =
            self.verifier.measure(&a, &b, &stay, &matches, (inliers, 0), fit_stride(&a, &b)).evidence;
        let whole = near_a.members.len() == ca.members.len() && near_b.members.len() == cb.members.len();
        Ok(Some(Trial {
            key,
            proposal,
            refined: joined,
            whole,
            junction: (i, j),
            a_from_b,
            centre,
            evidence,
        }))
    }

    /// The part of a component that is nearest to another one, in the order of its members; the scan of
    /// the pair that links the two is always in it.
    fn vicinity(
        &self,
        component: &Component,
        other: &Component,
        component_from_other: &RigidMotion,
        pair: &ScanPair,
    ) -> Component {
        if component.members.len() <= VICINITY {
            return component.clone();
        }
        let centre =
            |&(scan, pose): &(ScanId, RigidMotion)| pose * self.verifier.models[scan.0].centre.cast();
        let others: Vec<Point3<f64>> =
            other.members.iter().map(|m| component_from_other * centre(m)).collect();
        let away = |m: &(ScanId, RigidMotion)| {
            if [pair.i, pair.j].contains(&m.0) {
                return 0.0;
            }
            others.iter().map(|o| (o - centre(m)).norm()).fold(f64::INFINITY, f64::min)
        };
        let away: Vec<f64> = component.members.iter().map(away).collect();
        let mut nearest: Vec<usize> = (0..away.len()).collect();
        nearest.sort_by(|&x, &y| away[x].total_cmp(&away[y]).then(x.cmp(&y)));
        nearest.truncate(VICINITY);
        nearest.sort_unstable();
        let members = nearest.into_iter().map(|m| component.members[m]).collect();
        Component { members, joins: Vec::new(), refined_at: component.refined_at }
    }

    /// The evidence of a trial in the light of the others for the same two components.
    fn judged(&self, trials: &[Trial], at: usize) -> Evidence {
        let trial = &trials[at];
        // Two proposals may lead to one place.
        let radius_m = self.verifier.radius_m;
        let elsewhere = |t: &&Trial| match (t.relative(trial.junction), trial.relative(trial.junction)) {
            (Some(one), Some(other)) => {
                let centre = self.verifier.models[trial.junction.1.0].centre.cast();
                !same_motion(&one, &other, &centre, radius_m)
            }
            _ => !same_motion(&t.a_from_b, &trial.a_from_b, &trial.centre, radius_m),
        };
        let rivals: Vec<(f64, usize)> = trials
            .iter()
            .filter(|t| t.key == trial.key)
            .filter(elsewhere)
            .map(|t| (self.unrivalled(&t.evidence), t.evidence.inliers))
            .collect();
        let standing = rivals.iter().filter(|r| r.0 > REFUTED).map(|r| r.1).max();
        let refuted = trial.proposal.scored.evidence.second_best_inliers.div_ceil(REFUTED_RIVAL);
        let second_best_inliers = standing.unwrap_or(0).max(refuted);
        let evidence = Evidence { second_best_inliers, ..trial.evidence };
        let alone = self.unrivalled(&evidence);
        let among = probability::among_rivals(alone, rivals.iter().map(|r| r.0));
        let probability = Some(self.probability(&evidence).min(among));
        let evidence = Evidence { probability, ..evidence };
        let scored = ScoredHypothesis { a_from_b: trial.a_from_b, evidence, ..trial.proposal.scored };
        self.among_cycles(Proposal { scored, ..trial.proposal }).scored.evidence
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Direction, Point};
    use crate::registration::config::{RegistrationConfig, SurfaceVerification};
    use crate::registration::scan_model::ScanModel;
    use crate::registration::verification::verifier::Verifier;
    use crate::scan::Surface;

    #[test]
    pub(super) fn a_trial_moves_the_scans_nearest_to_the_other_side_and_the_two_that_link_them() {
        let points = vec![Point::new(-0.1, 0.0, 0.0), Point::new(0.1, 0.0, 0.0)];
        let surface = Surface { normals: vec![Direction::z(); 2], points, ..Surface::default() };
        let config = RegistrationConfig::default();
        let settings = SurfaceVerification::default();
        let models: Vec<ScanModel<'_>> =
            (0..101).map(|_| ScanModel::with_sizes(&surface, 0.07, 2, 0.14)).collect();
        let verifier = Verifier::new(&models, &settings, 0.07);
        let agglomeration = Agglomeration::new(&verifier, &config, vec![&[]; 101], &[]);
        let component = |members: Vec<(ScanId, RigidMotion)>| Component {
            refined_at: members.len(),
            members,
            joins: Vec::new(),
        };
        // A hundred scans in a row, a metre apart, in an order of their own; the other side stands at
        // its far end.
        let at = |k: usize| (ScanId(k), RigidMotion::translation(k as f64, 0.0, 0.0));
        let row: Vec<(ScanId, RigidMotion)> = (0..100).map(|k| at((k * 37) % 100)).collect();
        let other = component(vec![(ScanId(100), RigidMotion::identity())]);
        let row_from_other = RigidMotion::translation(100.0, 0.0, 0.0);
        let pair = |i: usize| ScanPair {
            i: ScanId(i),
            j: ScanId(100),
            matches: Box::default(),
            hypotheses: Vec::new(),
        };
        let near = |i: usize| -> Vec<usize> {
            let near = agglomeration.vicinity(&component(row.clone()), &other, &row_from_other, &pair(i));
            near.members.iter().map(|m| m.0.0).collect()
        };
        let of_row = |chosen: &dyn Fn(usize) -> bool| -> Vec<usize> {
            row.iter().map(|m| m.0.0).filter(|&k| chosen(k)).collect()
        };
        assert_eq!(near(99), of_row(&|k| k >= 60));
        // A linking scan at the other end takes the place of the furthest.
        assert_eq!(near(3), of_row(&|k| k >= 61 || k == 3));
        let few = component(row[..VICINITY].to_vec());
        let all = agglomeration.vicinity(&few, &other, &row_from_other, &pair(99));
        assert_eq!(all.members.len(), VICINITY);
    }
}
