//! The last refinement, on surfaces thinned more finely than those that scans were joined by.

use super::terms::{Kernel, Reach, Sample, for_each_touch, overlapping_pairs, strides};
use super::{PosedScan, refine_with};
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::monitor::Monitor;
use crate::registration::config::MultiviewIcpConfig;
use rayon::prelude::*;

/// Residuals of so many times the root mean square one count no more.
const SHARPNESS: f64 = 3.0;

/// Poses refined on the surfaces of `scans`, in their order, or `None` where these do not sit better on
/// each other then: the sum of Tukey's weights of all distances must grow, at three times the root mean
/// square distance that there was before. Weights of distances reach as far as their spread tells. The first scan keeps its pose.
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
    let after = refine_with(scans, config, radius_m, Kernel::Residuals, monitor)?;
    let samples: Vec<Sample> =
        scans.iter().map(|s| Sample::new(s.model.surface, config.points_per_scan)).collect();
    let pairs = overlapping_pairs(&samples, scans, &before, config.min_overlap, radius_m as f32);
    let strides = strides(&pairs, scans.len());
    let finest = Reach::of_radius(config.radii.last().copied().unwrap_or(1.0) * radius_m);
    // Of every touching point its distance and the weight that it had in the refinement, by pairs.
    let distances = |poses: &[RigidMotion]| -> Vec<(f64, f64)> {
        let of_pair = |&pair: &(usize, usize)| {
            let mut found = Vec::new();
            for_each_touch(pair, &samples, scans, poses, &strides, finest, |t| found.push((t.r, t.w)));
            found
        };
        let by_pairs: Vec<Vec<(f64, f64)>> = pairs.par_iter().map(of_pair).collect();
        by_pairs.into_iter().flatten().collect()
    };
    let (before, moved) = (distances(&before), distances(&after));
    let (squared, weight) = before.iter().fold((0.0, 0.0), |s, (r, w)| (s.0 + w * r * r, s.1 + w));
    let scale_m = SHARPNESS * (squared / f64::max(weight, f64::MIN_POSITIVE)).sqrt();
    let agreement = |distances: &[(f64, f64)]| -> f64 {
        distances.iter().map(|(r, _)| (1.0 - (r / scale_m).powi(2)).max(0.0).powi(2)).sum()
    };
    Ok((agreement(&moved) > agreement(&before)).then_some(after))
}
