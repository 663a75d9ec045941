//! The last stage: poses refined on surfaces thinned more finely than those that scans were joined by.

use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::monitor::Monitor;
use crate::preprocessing::local_frame::local_points;
use crate::preprocessing::surface::thin_again;
use crate::registration::config::{FineRefinementConfig, RegistrationConfig};
use crate::registration::{PosedScan, ScanModel, refine_if_better};
use crate::scan::{Outcome, Reconstruction, Scan, Surface, WorkingScale};
use rayon::prelude::*;

/// Finer surfaces must have so many times the points of the coarse ones where scans hang together in chains:
/// otherwise they hold little that registration has not seen, and what bends each of them adds up along the
/// chain as narrower weights follow it. With 1.2 fragments that were thinned before and sparse lidar scans
/// lose; with 2 an object of 40 000 points a scan is left out.
const WORTHWHILE: f64 = 1.6;

/// A scan of a component: where it stands in the list of scans, its step, its pose.
struct Member {
    scan: usize,
    step: usize,
    /// Scans of the component that it overlaps.
    overlapped: usize,
    /// Of the scan's own frame, in that of the pivot.
    pivot_from_local: RigidMotion,
}

/// Refines the poses of `local`, a reconstruction of scans in their own frames, component by component. Their
/// uncertainty stays as registration stated it: what bends a scan shows less on finer surfaces, and is there all
/// the same. `frames` are `scan_from_local`, `surfaces` what registration worked with.
///
/// # Errors
/// Only when the monitor is cancelled.
pub(super) fn refine(
    local: &mut Reconstruction,
    scans: &[Scan],
    frames: &[RigidMotion],
    surfaces: &[Surface],
    scale: &WorkingScale,
    config: &RegistrationConfig,
    monitor: &dyn Monitor,
) -> Result<()> {
    const STAGE: &str = "fine refinement";
    if !(config.fine_refinement.enabled && config.multiview_icp.enabled) {
        return Ok(());
    }
    monitor.begin(STAGE, local.components());
    for component in 0..local.components() {
        monitor.check(STAGE)?;
        let members = members_of(local, component, config.multiview_icp.min_overlap);
        if let Some(fine) = finer(&members, scans, frames, surfaces, scale, &config.fine_refinement) {
            refine_component(local, &members, &fine, scale, config, monitor)?;
        }
        monitor.advance(1);
    }
    monitor.end();
    Ok(())
}

/// Scans of a component, the pivot first; those that overlap by at least `min_overlap` count as overlapped.
fn members_of(local: &Reconstruction, component: usize, min_overlap: f64) -> Vec<Member> {
    let mut members: Vec<Member> = local
        .outcomes
        .iter()
        .enumerate()
        .filter_map(|(scan, outcome)| {
            let placement = outcome.placement().filter(|p| p.component == component)?;
            let overlapped = placement.neighbours.iter().filter(|n| n.overlap >= min_overlap).count();
            Some(Member {
                scan,
                step: placement.step,
                overlapped,
                pivot_from_local: placement.world_from_scan,
            })
        })
        .collect();
    members.sort_by_key(|m| (m.step, m.scan));
    members
}

/// The members' surfaces thinned to smaller voxels; `None` where that tells nothing new.
fn finer(
    members: &[Member],
    scans: &[Scan],
    frames: &[RigidMotion],
    surfaces: &[Surface],
    scale: &WorkingScale,
    config: &FineRefinementConfig,
) -> Option<Vec<Surface>> {
    // Where every two scans overlap, nothing adds up, and normals of smaller neighbourhoods bend less.
    let all_overlap = members.iter().all(|m| m.overlapped + 1 >= members.len());
    let worthwhile = if all_overlap { 0.0 } else { WORTHWHILE };
    let coarse: usize = members.iter().map(|m| surfaces[m.scan].len()).sum();
    let all: usize = members.iter().map(|m| scans[m.scan].cloud.len()).sum();
    if (all as f64) < worthwhile * coarse as f64 {
        return None;
    }
    // Points of a surface grow with the square of the fineness.
    let affordable = (config.most_points as f64 / coarse.max(1) as f64).sqrt();
    let fineness = config.fineness.min(affordable);
    if fineness * fineness < WORTHWHILE {
        return None;
    }
    // Half, and not a third: sparse scans have few points to fix a normal by.
    let normal_radius_m = 0.5 * scale.normal_radius_m;
    let scale = WorkingScale { normal_radius_m, ..WorkingScale::from_voxel(scale.voxel_m / fineness) };
    let thinned = |m: &Member| {
        let scan = &scans[m.scan];
        let points = local_points(scan, &frames[m.scan]);
        thin_again(&points, scan.cloud.colors.as_deref(), &surfaces[m.scan], &scale)
    };
    let fine: Vec<Surface> = members.par_iter().map(thinned).collect();
    let points: usize = fine.iter().map(Surface::len).sum();
    (points as f64 >= worthwhile * coarse as f64).then_some(fine)
}

fn refine_component(
    local: &mut Reconstruction,
    members: &[Member],
    fine: &[Surface],
    scale: &WorkingScale,
    config: &RegistrationConfig,
    monitor: &dyn Monitor,
) -> Result<()> {
    let icp = config.fine_refinement.multiview_icp(&config.multiview_icp);
    let radius_m = FineRefinementConfig::FIRST_RADIUS * scale.inlier_radius_m;
    let compared = RegistrationConfig { multiview_icp: icp.clone(), ..config.clone() };
    let models: Vec<ScanModel<'_>> =
        fine.par_iter().map(|s| ScanModel::new(s, radius_m as f32, &compared)).collect();
    let posed = members.iter().zip(&models);
    let posed: Vec<PosedScan<'_>> =
        posed.map(|(m, model)| PosedScan { model, world_from_scan: m.pivot_from_local }).collect();
    let refined = refine_if_better(&posed, &icp, radius_m, monitor)?;
    tracing::debug!(refined = refined.is_some(), "fine refinement of {} scans", members.len());
    let Some(poses) = refined else { return Ok(()) };
    for (member, pose) in members.iter().zip(poses) {
        let Outcome::Placed(placement) = &mut local.outcomes[member.scan] else { continue };
        placement.world_from_scan = pose;
    }
    Ok(())
}
