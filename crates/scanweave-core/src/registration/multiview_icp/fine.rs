//! The last refinement, on surfaces thinned more finely than those that scans were joined by.

use super::terms::{PairTerm, Sample, overlapping_pairs, strides, term_of};
use super::{PosedScan, refine_poses};
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::monitor::Monitor;
use crate::registration::config::MultiviewIcpConfig;
use rayon::prelude::*;

/// Poses refined on the surfaces of `scans`, in their order, or `None` where these do not sit better on
/// each other then: the sum of Tukey's weights of all distances at the last radius must grow. The first
/// scan keeps its pose.
///
/// `radius_m` is what the radii of the settings are multiples of.
///
/// # Errors
/// Only when the monitor is cancelled.
pub fn refine_if_better(
    scans: &[PosedScan<'_>],
    config: &MultiviewIcpConfig,
    radius_m: f64,
    monitor: &dyn Monitor,
) -> Result<Option<Vec<RigidMotion>>> {
    let before: Vec<RigidMotion> = scans.iter().map(|s| s.world_from_scan).collect();
    let after = refine_poses(scans, config, radius_m, monitor)?;
    let samples: Vec<Sample> =
        scans.iter().map(|s| Sample::new(s.model.surface, config.points_per_scan)).collect();
    let pairs = overlapping_pairs(&samples, scans, &before, config.min_overlap, radius_m as f32);
    let strides = strides(&pairs, scans.len());
    let finest = config.radii.last().copied().unwrap_or(1.0) * radius_m;
    let agreement = |poses: &[RigidMotion]| -> f64 {
        let term = |pair: &(usize, usize)| term_of(*pair, &samples, scans, poses, &strides, finest, 0.0);
        let terms: Vec<PairTerm> = pairs.par_iter().map(term).collect();
        terms.iter().map(|term| term.weight).sum()
    };
    Ok((agreement(&after) > agreement(&before)).then_some(after))
}
