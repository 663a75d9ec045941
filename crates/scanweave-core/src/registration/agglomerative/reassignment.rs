//! Places that other components have for scans which are placed already.

use crate::registration::verification::verifier::Assessment;
use crate::registration::verification::probability;
use super::agglomeration::{Assembly, Component, ComponentId, Proposal};
use crate::geometry::RigidMotion;
use crate::scan::{ScanId, Support};
use std::collections::{BTreeMap, BTreeSet};

/// Another component has a better place when it has so many times the inliers of the present one, and so
/// many times the share of inliers among matches.
const OUTWEIGHS: usize = 2;

/// A place that another component has for a placed scan.
#[derive(Debug, Clone, Copy)]
pub(super) struct Claim {
    /// The scan of that component, and its pair with the claimed one, that speak for it most.
    by: ScanId,
    pair: usize,
    /// The place there.
    pub assessment: Assessment,
}

/// Whether far more matches agree at one place than at another, in number and in share.
fn outweighs(there: &Support, here: &Support) -> bool {
    let cross = |a: &Support, b: &Support| a.inliers * b.matches;
    there.inliers > OUTWEIGHS * here.inliers && cross(there, here) > OUTWEIGHS * cross(here, there)
}

/// A support that counts another component's place as a rival.
fn rivalled(here: &Support, there: &Support) -> Support {
    Support { runner_up: here.runner_up.max(there.inliers), ..*here }
}

impl Assembly<'_> {
    /// The place with most inliers that another component has for a member of this one, of those that it
    /// is sure enough of. Components with no place that is `worth_it`, by what is known of its support at a
    /// glance (matches, and how many of them a pair of scans brings within 2τ), are not looked at.
    pub(super) fn claim(&self, home: ComponentId, scan: ScanId, worth_it: impl Fn(&Support) -> bool) -> Option<Claim> {
        let accept = self.config().evidence.accept;
        let alone = [(scan, RigidMotion::identity())];
        let surest = |p: usize| self.pairs[p].hypotheses.first().map_or(0.0, Assessment::probability);
        let pairs = self.pairs_of(scan);
        let sure: BTreeSet<ScanId> = pairs.iter().filter(|p| surest(p.0) >= accept).map(|p| p.1).collect();
        let of_component = |other: &Component| {
            if !other.members.iter().any(|m| sure.contains(&m.0)) {
                return None;
            }
            let poses: BTreeMap<ScanId, RigidMotion> = other.members.iter().copied().collect();
            let (pairs, proposals) = self.proposals_for(scan, &pairs, &poses);
            let motions: Vec<RigidMotion> =
                proposals.iter().take_while(|p| p.1 >= accept).map(|p| p.0).collect();
            let matches = self.matches_between(&pairs, &poses, &alone.into_iter().collect());
            let glance = |motion: &RigidMotion| {
                let inliers = matches.count(motion, 2.0 * self.assessor.radius_m);
                worth_it(&Support { matches: matches.len(), inliers, ..Support::default() })
            };
            if !motions.iter().any(glance) {
                return None;
            }
            let (group, single) = (self.posed(&other.members), self.posed(&alone));
            let found = self.assessor.assess(&group, &single, &motions, &matches);
            let sure = found.into_iter().filter(|f| f.probability() >= accept);
            let assessment = sure.max_by_key(|f| f.support.inliers)?;
            let pair = pairs.into_iter().max_by(|x, y| surest(*x).total_cmp(&surest(*y)))?;
            let by = if self.pairs[pair].i == scan { self.pairs[pair].j } else { self.pairs[pair].i };
            Some(Claim { by, pair, assessment })
        };
        let others = self.components.iter().filter(|(id, c)| **id != home && c.members.len() > 1);
        others.filter_map(|(_, other)| of_component(other)).max_by_key(|c| c.assessment.support.inliers)
    }

    /// The support of a member of a component in the light of the places that other components have for
    /// it: one with matches enough to leave the present place undecided is its rival, whatever it is that
    /// keeps the two apart.
    pub(super) fn against_others(&self, home: ComponentId, scan: ScanId, support: Support) -> Support {
        let undecided = |there: &Support| probability::is_undecided(&rivalled(&support, there));
        let Some(claim) = self.claim(home, scan, undecided) else { return support };
        let there = claim.assessment.support;
        if !undecided(&there) {
            return support;
        }
        tracing::debug!("scan {scan} has another component's place as well, {support:?} and {there:?}");
        let support = rivalled(&support, &there);
        Support { probability: Some(self.assessor.probability(&support)), ..support }
    }

    /// The claim that another component has to a member which sits well enough here, but which far more
    /// matches place there; none to one that a review took out before.
    pub(super) fn better_claim(&self, home: ComponentId, scan: ScanId, here: &Assessment) -> Option<Claim> {
        if here.probability() < 0.5 || self.taken_out.contains(&scan) {
            return None;
        }
        let better = |there: &Support| outweighs(there, &here.support);
        self.claim(home, scan, better).filter(|claim| better(&claim.assessment.support))
    }

    /// Joins scans that were taken out to the components that claim them, unless what speaks for that was
    /// taken out as well.
    pub(super) fn join_claimed(&mut self, claimed: &[(ScanId, Claim)]) {
        let gone: BTreeSet<ScanId> = claimed.iter().map(|c| c.0).collect();
        for &(scan, Claim { by, pair, assessment }) in claimed.iter().filter(|c| !gone.contains(&c.1.by)) {
            let home = |of: ScanId| {
                let mut components = self.components.iter();
                components.find(|(_, c)| c.members.iter().any(|m| m.0 == of)).map(|(id, _)| *id)
            };
            let (Some(a), Some(b)) = (home(by), home(scan)) else { continue };
            // A scan that was taken out for another reason is alone, in a frame of its own.
            if self.components[&a].members.len() > 1 {
                self.join(&Proposal { a, b, assessment, pair });
            }
        }
    }
}
