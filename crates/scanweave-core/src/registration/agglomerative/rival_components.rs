//! Places that other components have for scans which are placed already.

use super::agglomeration::{Agglomeration, Component, ComponentId};
use crate::geometry::RigidMotion;
use crate::registration::verification::probability::{self, UNDECIDED};
use crate::registration::verification::verifier::ScoredHypothesis;
use crate::scan::{Evidence, ScanId};
use std::collections::{BTreeMap, BTreeSet};

/// Evidence that counts another component's place as a rival.
fn with_rival(here: &Evidence, there: &Evidence) -> Evidence {
    Evidence { second_best_inliers: here.second_best_inliers.max(there.inliers), ..*here }
}

impl Agglomeration<'_> {
    /// The place with most inliers that another component has for a member of this one, of those that it
    /// is sure enough of. Components with no place that is `worth_it`, by a coarse check
    /// (matches, and how many of them a pair of scans brings within 2τ), are not scored.
    fn rival(
        &self,
        home: ComponentId,
        scan: ScanId,
        worth_it: impl Fn(&Evidence) -> bool,
    ) -> Option<ScoredHypothesis> {
        let accept = self.verifier.settings.accept;
        let alone = [(scan, RigidMotion::identity())];
        let surest = |p: usize| self.pairs[p].hypotheses.first().map_or(0.0, ScoredHypothesis::probability);
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
            let coarse_check = |motion: &RigidMotion| {
                let inliers = matches.count(motion, 2.0 * self.verifier.radius_m);
                worth_it(&Evidence { matches: matches.len(), inliers, ..Evidence::default() })
            };
            if !motions.iter().any(coarse_check) {
                return None;
            }
            let (group, single) = (self.posed(&other.members), self.posed(&alone));
            let found = self.verifier.score(&group, &single, &motions, &matches);
            let sure = found.into_iter().filter(|f| f.probability() >= accept);
            sure.max_by_key(|f| f.evidence.inliers)
        };
        let others = self.components.iter().filter(|(id, c)| **id != home && c.members.len() > 1);
        others.filter_map(|(_, other)| of_component(other)).max_by_key(|c| c.evidence.inliers)
    }

    /// The evidence of a member of a component in the light of the places that other components have for
    /// it: one with at least as many matches is its rival, whatever it is that keeps the two apart.
    pub(super) fn against_others(&self, home: ComponentId, scan: ScanId, evidence: Evidence) -> Evidence {
        let undecided = |there: &Evidence| there.inliers >= evidence.inliers;
        let Some(rival) = self.rival(home, scan, undecided) else { return evidence };
        let there = rival.evidence;
        if !undecided(&there) {
            return evidence;
        }
        tracing::debug!("scan {scan} has another component's place as well, {evidence:?} and {there:?}");
        let evidence = with_rival(&evidence, &there);
        let alone = self.verifier.probability(&evidence);
        let among = probability::among_rivals(alone, [rival.probability()].into_iter());
        Evidence { probability: Some(among.min(UNDECIDED)), ..evidence }
    }
}
