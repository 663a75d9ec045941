//! How certain refined poses are.

use super::PosedScan;
use super::system::normal_equations;
use super::terms::{PairTerm, Sample, overlapping_pairs, pair_term};
use crate::geometry::RigidMotion;
use crate::registration::config::MultiviewIcpConfig;
use nalgebra::Matrix6;
use rayon::prelude::*;

/// Covariance of every pose relative to the first at refined poses, in the order of `scans`: of a
/// rotation vector (radians) and the displacement of the scan's centre (metres), in the frame of
/// the poses. Zero for the first; `None` where the system cannot be solved.
///
/// The inverse of the normal equations times the weighted mean square residual, twice: each pair is
/// looked at from both sides. Residuals are taken for independent, which those of points closer
/// than τ are not: scans denser than that, and sensors whose errors are systematic, are less certain.
pub fn pose_covariances(
    scans: &[PosedScan<'_>],
    config: &MultiviewIcpConfig,
    radius_m: f64,
) -> Vec<Option<Matrix6<f64>>> {
    let poses: Vec<RigidMotion> = scans.iter().map(|s| s.world_from_scan).collect();
    let samples: Vec<Sample> =
        scans.iter().map(|s| Sample::new(s.model.surface, config.points_per_scan)).collect();
    let pairs = overlapping_pairs(&samples, scans, &poses, config.min_overlap, radius_m as f32);
    let finest = config.radii.last().copied().unwrap_or(1.0) * radius_m;
    let every = vec![1; scans.len()];
    let terms: Vec<PairTerm> =
        pairs.par_iter().map(|&pair| pair_term(pair, &samples, scans, &poses, &every, finest)).collect();
    let (squared, weight) = terms.iter().fold((0.0, 0.0), |s, t| (s.0 + t.squared, s.1 + t.weight));
    let (matrix, _) = normal_equations(&pairs, &terms, scans.len());
    let factor = matrix.cholesky();
    let variance = 2.0 * squared / f64::max(weight, 1.0);
    (0..scans.len())
        .into_par_iter()
        .map(|scan| {
            if scan == 0 {
                return Some(Matrix6::zeros());
            }
            let mut unit = vec![Matrix6::<f64>::zeros(); scans.len() - 1];
            unit[scan - 1] = Matrix6::identity();
            let about_origin = factor.as_ref()?.solve(&unit)[scan - 1] * variance;
            let centre = poses[scan] * scans[scan].model.centre.cast::<f64>();
            let mut at_centre = Matrix6::identity();
            at_centre.fixed_view_mut::<3, 3>(3, 0).copy_from(&-centre.coords.cross_matrix());
            Some(at_centre * about_origin * at_centre.transpose())
        })
        .collect()
}
