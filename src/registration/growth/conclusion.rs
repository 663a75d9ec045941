//! From a finished growth to one outcome a scan.

use super::{Growth, MIN_KEYPOINTS, Member};
use crate::geometry::overlap::two_way_overlap;
use crate::scan::{DeclineReason, NeighbourEvidence, Outcome, Placement, Reconstruction};
use rayon::prelude::*;

impl Growth<'_> {
    /// One outcome a scan; components ordered by size, then by their first scan.
    pub fn conclude(mut self) -> Reconstruction {
        let lowest = |c: &[Member]| c.iter().map(|m| m.scan).min();
        self.components.sort_by_key(|c| (std::cmp::Reverse(c.len()), lowest(c)));
        let unexplained = DeclineReason::TooFewInliers { inliers: 0, needed: MIN_KEYPOINTS, matches: 0 };
        let mut outcomes: Vec<Outcome> = std::mem::take(&mut self.refusals)
            .into_iter()
            .map(|r| Outcome::Declined(r.unwrap_or_else(|| unexplained.clone())))
            .collect();
        for (component, members) in self.components.iter().enumerate() {
            let neighbours: Vec<Vec<NeighbourEvidence>> =
                (0..members.len()).into_par_iter().map(|m| self.neighbours(members, m)).collect();
            for (step, (member, neighbours)) in members.iter().zip(neighbours).enumerate() {
                let attempt = member.attempt.as_ref();
                outcomes[member.scan.0] = Outcome::Placed(Placement {
                    world_from_scan: member.world_from_scan,
                    component,
                    step,
                    parent: attempt.and_then(|a| a.parent),
                    matches: attempt.map_or(0, |a| a.support.matches),
                    inliers: attempt.map_or(0, |a| a.support.inliers),
                    residual_m: attempt.map_or(0.0, |a| a.residual_m),
                    support: attempt.map(|a| a.support),
                    neighbours,
                });
            }
        }
        Reconstruction { outcomes }
    }

    /// Agreement of one member with all others it touches, at the final poses.
    fn neighbours(&self, members: &[Member], of: usize) -> Vec<NeighbourEvidence> {
        const LEAST: f64 = 0.01;
        let here = &members[of];
        let mut found: Vec<NeighbourEvidence> = members
            .iter()
            .filter(|there| there.scan != here.scan)
            .filter_map(|there| {
                let here_from_there = here.world_from_scan.inverse() * there.world_from_scan;
                let o =
                    two_way_overlap(&self.grids[here.scan.0], &self.grids[there.scan.0], &here_from_there);
                (o.ratio >= LEAST).then_some(NeighbourEvidence {
                    scan: there.scan,
                    overlap: o.ratio,
                    residual_m: o.residual_m,
                })
            })
            .collect();
        found.sort_by_key(|n| n.scan);
        found
    }
}
