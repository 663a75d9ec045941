//! Agreement of placed scans with those they touch, at their final poses.

use crate::geometry::RigidMotion;
use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::overlap::two_way_overlap;
use crate::registration::scan_model::ScanModel;
use crate::scan::{NeighbourEvidence, ScanId};
use rayon::prelude::*;

/// Overlap below which two scans do not count as neighbours.
const LEAST: f64 = 0.01;

/// Agreement of every member of a component with all others it touches, in the order of the members and
/// ordered by scan. Every pair is compared once: overlap is the same from both sides.
///
/// `keypoints` holds those of every scan, indexed with radius τ; `models` their surfaces, or nothing.
pub fn neighbours(
    members: &[(ScanId, RigidMotion)],
    keypoints: &[RadiusGrid<'_>],
    models: &[ScanModel<'_>],
) -> Vec<Vec<NeighbourEvidence>> {
    let pairs: Vec<(usize, usize)> =
        (0..members.len()).flat_map(|m| (m + 1..members.len()).map(move |o| (m, o))).collect();
    let overlap = |&(m, o): &(usize, usize)| {
        let ((a, world_from_a), (b, world_from_b)) = (members[m], members[o]);
        let a_from_b = world_from_a.inverse() * world_from_b;
        if !models.is_empty() && !models[a.0].meets(&models[b.0], &a_from_b) {
            return None;
        }
        let found = two_way_overlap(&keypoints[a.0], &keypoints[b.0], &a_from_b);
        (found.ratio >= LEAST).then_some((m, o, found.ratio, found.residual_m))
    };
    let touching: Vec<_> = pairs.par_iter().filter_map(overlap).collect();
    let mut all = vec![Vec::new(); members.len()];
    for (m, o, overlap, residual_m) in touching {
        all[m].push(NeighbourEvidence { scan: members[o].0, overlap, residual_m, plane_distance_m: None });
        all[o].push(NeighbourEvidence { scan: members[m].0, overlap, residual_m, plane_distance_m: None });
    }
    all.iter_mut().for_each(|found| found.sort_by_key(|n| n.scan));
    all
}
