//! Multiview point-to-plane ICP of all poses of a component.
//!
//! Minimises Σ ρ(n·(Tᵢp − Tⱼq)) over all pairs of overlapping scans at once
//! (multi-view point-to-plane ICP; Chen & Medioni 1991 for the metric), by Gauss–Newton
//! with new correspondences each round and radii from coarse to fine. Growth joins scans
//! one after another, so small errors add up along the way; this step spreads them.

pub(super) mod config;
mod fine;
mod intensity;
mod loop_closure;
mod system;
mod terms;
mod uncertainty;

pub use fine::refine_if_better;
pub use loop_closure::{MatchedPair, close_loops};
pub use uncertainty::pose_covariances;

use super::config::MultiviewIcpConfig;
use super::scan_model::ScanModel;
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::monitor::Monitor;
use rayon::prelude::*;
use system::gauss_newton_step;
use terms::{Kernel, PairTerm, Reach, Sample, overlapping_pairs, strides, term_of};

/// Steps shorter than this many radii are the last.
const SETTLED: f64 = 2e-3;

/// One scan of the component.
#[derive(Clone, Copy)]
pub struct PosedScan<'a> {
    /// Its thinned surface with normals.
    pub model: &'a ScanModel<'a>,
    /// Its pose.
    pub world_from_scan: RigidMotion,
}

/// Refined poses, in the order of `scans`; the first scan keeps its pose and so fixes the frame.
///
/// `radius_m` is τ. Scans without enough correspondences keep their relation to the rest
/// through a light damping.
///
/// # Errors
/// Only when the monitor is cancelled.
pub fn refine_poses(
    scans: &[PosedScan<'_>],
    config: &MultiviewIcpConfig,
    radius_m: f64,
    monitor: &dyn Monitor,
) -> Result<Vec<RigidMotion>> {
    refine_with(scans, config, radius_m, Kernel::Radius, monitor)
}

/// [`refine_poses`] with a kernel.
fn refine_with(
    scans: &[PosedScan<'_>],
    config: &MultiviewIcpConfig,
    radius_m: f64,
    kernel: Kernel,
    monitor: &dyn Monitor,
) -> Result<Vec<RigidMotion>> {
    let mut poses: Vec<RigidMotion> = scans.iter().map(|s| s.world_from_scan).collect();
    if scans.len() < 2 {
        return Ok(poses);
    }
    let samples: Vec<Sample> =
        scans.iter().map(|s| Sample::new(s.model.surface, config.points_per_scan)).collect();
    for (k, factor) in config.radii.iter().enumerate() {
        let radius = factor * radius_m;
        let colour_m = if k + 1 == config.radii.len() { config.colour * radius_m } else { 0.0 };
        let pairs = overlapping_pairs(&samples, scans, &poses, config.min_overlap, radius_m as f32);
        let strides = strides(&pairs, scans.len());
        for _ in 0..config.rounds {
            monitor.check("multiview_icp refinement")?;
            let cutoff_m = kernel.cutoff_m(&pairs, &samples, scans, &poses, &strides, radius);
            let reach = Reach { radius_m: radius, cutoff_m };
            let terms: Vec<PairTerm> = pairs
                .par_iter()
                .map(|&(i, j)| term_of((i, j), &samples, scans, &poses, &strides, reach, colour_m))
                .collect();
            let Some(largest_step) = gauss_newton_step(&pairs, &terms, &mut poses, radius_m) else { break };
            if largest_step < SETTLED * radius_m {
                break;
            }
        }
    }
    Ok(poses)
}

#[cfg(test)]
mod tests;
