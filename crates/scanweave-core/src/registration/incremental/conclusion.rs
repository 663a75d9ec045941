//! From a finished growth to one outcome a scan.

use super::growth::{Growth, Member};
use crate::registration::input::MIN_KEYPOINTS;
use crate::registration::neighbours::neighbours;
use crate::scan::{DeclineReason, Outcome, Placement, Reconstruction};

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
            let poses: Vec<_> = members.iter().map(|m| (m.scan, m.world_from_scan)).collect();
            let neighbours = neighbours(&poses, &self.grids, &self.models);
            for (step, (member, neighbours)) in members.iter().zip(neighbours).enumerate() {
                let attempt = member.attempt.as_ref();
                outcomes[member.scan.0] = Outcome::Placed(Placement {
                    world_from_scan: member.world_from_scan,
                    component,
                    step,
                    parent: attempt.and_then(|a| a.parent),
                    matches: attempt.map_or(0, |a| a.evidence.matches),
                    inliers: attempt.map_or(0, |a| a.evidence.inliers),
                    residual_m: attempt.map_or(0.0, |a| a.residual_m),
                    evidence: attempt.map(|a| a.evidence),
                    neighbours,
                    pose_uncertainty: None,
                });
            }
        }
        Reconstruction { outcomes }
    }
}
