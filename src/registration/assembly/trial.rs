//! Joins that are judged after all poses were refined as if they had been made.
//!
//! Errors add up inside a component, so that even the right join of two large ones does not fit
//! well before its poses give way; and two places that look alike give more inliers than a narrow
//! overlap does, until a trial shows that nothing can make them fit.

use super::super::assessment::Assessment;
use super::super::config::JointConfig;
use super::super::estimate::same_motion;
use super::{Assembly, Component, ComponentId, Proposal};
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::monitor::Monitor;
use crate::scan::{ScanId, Support};
use nalgebra::Point3;
use std::collections::{BTreeMap, BTreeSet};

/// Proposals that are tried at a time.
const TRIALS: usize = 10;
/// Of them, proposals for the same two components.
const TRIALS_PER_LINK: usize = 4;
/// Probability, rivals apart, from which a proposal is tried.
const WORTH_TRYING: f64 = 0.01;
/// Probability, rivals apart, below which a trial has refuted a proposal.
const REFUTED: f64 = 0.5;

/// One in so many of the inliers of a refuted rival count: that many matches agree by chance or
/// likeness here, even if on something impossible.
pub(super) const REFUTED_RIVAL: usize = 4;

/// A join that was tried.
struct Trial {
    key: (ComponentId, ComponentId),
    proposal: Proposal,
    joined: Component,
    /// Pose of a scan of the second side relative to one of the first, and the second's centre.
    first_from_second: RigidMotion,
    centre: Point3<f64>,
    /// The evidence after the refinement, as if there were no rival.
    support: Support,
}

impl Assembly<'_> {
    /// Tries the most promising joins and makes the best one that suffices; `false` when none does.
    ///
    /// A rival that a trial refuted counts a quarter of its inliers, for a scan that joins alone from
    /// then on.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn join_by_trial(&mut self, monitor: &dyn Monitor) -> Result<bool> {
        let mut trials: Vec<Trial> = Vec::new();
        let coarse = self.coarse();
        let worth = self.worth_trying();
        for &(key, assessment, pair) in &worth {
            let proposal = Proposal { a: key.0, b: key.1, assessment, pair };
            if let Some(trial) = self.try_out(key, proposal, &coarse, monitor)? {
                tracing::debug!("trial {}: then {:?}", self.describe(&proposal), trial.support);
                trials.push(trial);
            }
        }
        let sufficient: Vec<(usize, Support)> = (0..trials.len())
            .map(|at| (at, self.judged(&trials, at)))
            .filter(|(_, support)| self.probability(support) >= self.config().evidence.accept)
            .collect();
        // One that suffices and is not made now has not failed: it is tried again.
        let failed = worth.iter().filter(|w| !sufficient.iter().any(|&(at, _)| trials[at].key == w.0));
        let failed: Vec<_> = failed.map(|w| self.state_of(w.0)).collect();
        self.tried.extend(failed);
        let best = sufficient
            .into_iter()
            .max_by(|x, y| self.probability(&x.1).total_cmp(&self.probability(&y.1)).then(y.0.cmp(&x.0)));
        let Some((at, support)) = best else { return Ok(false) };
        let Trial { proposal, mut joined, .. } = trials.swap_remove(at);
        if let Some(last) = joined.joins.last_mut() {
            last.support = Support { probability: Some(self.probability(&support)), ..support };
        }
        for component in [proposal.a, proposal.b].map(|id| &self.components[&id]) {
            if let [(alone, _)] = component.members[..] {
                self.tried_out.insert(alone);
            }
        }
        self.replace(&[proposal.a, proposal.b], joined);
        Ok(true)
    }

    fn probability(&self, support: &Support) -> f64 {
        self.assessor.probability(support)
    }

    /// Probability if there were no rival.
    fn unrivalled(&self, support: &Support) -> f64 {
        self.probability(&Support { runner_up: 0, ..*support })
    }

    /// What a link's trials depend on: while it stays, so does their outcome.
    fn state_of(&self, key: (ComponentId, ComponentId)) -> (ComponentId, ComponentId, usize, usize) {
        let scans = self.components[&key.0].members.len() + self.components[&key.1].members.len();
        (key.0, key.1, scans, self.links[&key].pairs.len())
    }

    /// Proposals in the order in which they deserve a trial; links that failed before do not.
    fn worth_trying(&self) -> Vec<((ComponentId, ComponentId), Assessment, usize)> {
        let mut worth = Vec::new();
        for (key, link) in &self.links {
            let alone = self.components[&key.0].members.len() + self.components[&key.1].members.len() <= 2;
            if alone || self.tried.contains(&self.state_of(*key)) {
                continue;
            }
            let mut of_link: Vec<(f64, Assessment, usize)> = link
                .assessed
                .iter()
                .flatten()
                .map(|&(found, pair)| (self.unrivalled(&found.support), found, pair))
                .filter(|found| found.0 >= WORTH_TRYING)
                .collect();
            of_link.sort_by(|x, y| y.0.total_cmp(&x.0));
            of_link.truncate(TRIALS_PER_LINK);
            worth.extend(of_link.into_iter().map(|(p, found, pair)| (p, *key, found, pair)));
        }
        worth.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        worth.truncate(TRIALS);
        worth.into_iter().map(|(_, key, found, pair)| (key, found, pair)).collect()
    }

    /// Makes a join on the side, refines all its poses, and measures how the two sides then sit.
    fn try_out(
        &self,
        key: (ComponentId, ComponentId),
        proposal: Proposal,
        coarse: &JointConfig,
        monitor: &dyn Monitor,
    ) -> Result<Option<Trial>> {
        let (ca, cb) = (&self.components[&key.0], &self.components[&key.1]);
        let Some(mut joined) = self.joined(ca, cb, &proposal) else { return Ok(None) };
        let newcomers: BTreeSet<ScanId> = cb.members.iter().map(|m| m.0).collect();
        self.refine_component(&mut joined, &newcomers, coarse, monitor)?;
        let side = |c: &Component| -> Vec<(ScanId, RigidMotion)> {
            let of: BTreeSet<ScanId> = c.members.iter().map(|m| m.0).collect();
            joined.members.iter().copied().filter(|m| of.contains(&m.0)).collect()
        };
        let (a, b) = (side(ca), side(cb));
        let ([first, ..], [second, ..]) = (a.as_slice(), b.as_slice()) else { return Ok(None) };
        let first_from_second = first.1.inverse() * second.1;
        let centre = self.assessor.models[second.0.0].centre.cast();
        let poses = |m: &[(ScanId, RigidMotion)]| m.iter().copied().collect::<BTreeMap<_, _>>();
        let matches = self.matches_between(&self.links[&key].pairs, &poses(&a), &poses(&b));
        let stay = RigidMotion::identity();
        let inliers = matches.count(&stay, self.assessor.radius_m);
        let (a, b) = (self.posed(&a), self.posed(&b));
        let support = self.assessor.measure(&a, &b, &stay, &matches, (inliers, 0)).support;
        Ok(Some(Trial { key, proposal, joined, first_from_second, centre, support }))
    }

    /// The support of a trial in the light of the others for the same two components.
    fn judged(&self, trials: &[Trial], at: usize) -> Support {
        let trial = &trials[at];
        // Two proposals may lead to one place.
        let radius_m = self.assessor.radius_m;
        let elsewhere = |t: &&Trial| {
            !same_motion(&t.first_from_second, &trial.first_from_second, &trial.centre, radius_m)
        };
        let rivals = trials.iter().filter(|t| t.key == trial.key).filter(elsewhere);
        let standing =
            rivals.filter(|t| self.unrivalled(&t.support) >= REFUTED).map(|t| t.support.inliers).max();
        let refuted = trial.proposal.assessment.support.runner_up.div_ceil(REFUTED_RIVAL);
        Support { runner_up: standing.unwrap_or(0).max(refuted), ..trial.support }
    }
}
