//! Agreement of placed scans with those they touch, at their final poses.

use super::scan_model::ScanModel;
use crate::geometry::RigidMotion;
use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::overlap::two_way_overlap;
use crate::scan::{NeighbourEvidence, ScanId};

/// Overlap below which two scans do not count as neighbours.
const LEAST: f64 = 0.01;

/// Agreement of one member of a component with all others it touches, ordered by scan.
///
/// `keypoints` holds those of every scan, indexed with radius τ; `models` their surfaces, or nothing.
pub(super) fn neighbours_of(
    members: &[(ScanId, RigidMotion)],
    of: usize,
    keypoints: &[RadiusGrid<'_>],
    models: &[ScanModel<'_>],
) -> Vec<NeighbourEvidence> {
    let (here, world_from_here) = members[of];
    let here_from_world = world_from_here.inverse();
    let mut found: Vec<NeighbourEvidence> = members
        .iter()
        .filter(|there| there.0 != here)
        .filter_map(|&(there, world_from_there)| {
            let here_from_there = here_from_world * world_from_there;
            if !models.is_empty() && !models[here.0].meets(&models[there.0], &here_from_there) {
                return None;
            }
            let o = two_way_overlap(&keypoints[here.0], &keypoints[there.0], &here_from_there);
            (o.ratio >= LEAST).then_some(NeighbourEvidence {
                scan: there,
                overlap: o.ratio,
                residual_m: o.residual_m,
            })
        })
        .collect();
    found.sort_by_key(|n| n.scan);
    found
}
