//! How certain refined poses are.

use super::PosedScan;
use super::system::normal_equations;
use super::terms::{PairTerm, Sample, Touching, for_each_touch, overlapping_pairs, pair_term};
use crate::geometry::RigidMotion;
use crate::geometry::sparse::BlockMatrix;
use crate::registration::config::MultiviewIcpConfig;
use nalgebra::{Matrix6, Point3, Vector3, Vector6};
use rayon::prelude::*;

/// Covariance of every pose relative to the first at refined poses, in the order of `scans`: of a
/// rotation vector (radians) and the displacement of the scan's centre (metres), in the frame of
/// the poses. Zero for the first; `None` where the system cannot be solved.
///
/// The cluster-robust covariance H⁻¹ M H⁻¹ (Liang & Zeger 1986): H are the normal equations, M sums
/// g gᵀ over the clusters of all pairs, g the gradient of a cluster: what touches in one of the eight
/// octants of a pair's touching surface. Residuals of points near each other are the errors of one
/// surface, one sensor, one bent scan; within a cluster they may depend on each other as they like.
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
    let (matrix, _) = normal_equations(&pairs, &terms, scans.len());
    let factor = matrix.cholesky();
    let scatter_of = |&pair: &(usize, usize)| {
        let mut touching = Vec::new();
        for_each_touch(pair, &samples, scans, &poses, &every, finest, |touch| touching.push(touch));
        scatter(&touching)
    };
    let scatters: Vec<Matrix6<f64>> = pairs.par_iter().map(scatter_of).collect();
    let mut middle = BlockMatrix::<6>::zeros(scans.len() - 1);
    for (&(i, j), scatter) in pairs.iter().zip(&scatters) {
        // The gradient of the second scan is minus that of the first; the first scan of all is held.
        for scan in [i, j].into_iter().filter(|&scan| scan > 0) {
            middle.add(scan - 1, scan - 1, scatter);
        }
        if i > 0 {
            middle.add(j - 1, i - 1, &-scatter);
        }
    }
    (0..scans.len())
        .into_par_iter()
        .map(|scan| {
            if scan == 0 {
                return Some(Matrix6::zeros());
            }
            let mut unit = vec![Matrix6::<f64>::zeros(); scans.len() - 1];
            unit[scan - 1] = Matrix6::identity();
            let solved = factor.as_ref()?.solve(&unit);
            let spread = middle.multiply(&solved);
            let about_origin: Matrix6<f64> =
                solved.iter().zip(&spread).map(|(x, mx)| x.transpose() * mx).sum();
            let centre = poses[scan] * scans[scan].model.centre.cast::<f64>();
            let mut at_centre = Matrix6::identity();
            at_centre.fixed_view_mut::<3, 3>(3, 0).copy_from(&-centre.coords.cross_matrix());
            Some(at_centre * about_origin * at_centre.transpose())
        })
        .collect()
}

/// Σ g gᵀ over the octants of what touches within a pair, g = Σ w r h the gradient of an octant.
fn scatter(touching: &[Touching]) -> Matrix6<f64> {
    let n = touching.len().max(1) as f64;
    let middle = Point3::from(touching.iter().map(|t| t.place.coords).sum::<Vector3<f64>>() / n);
    let mut gradients = [Vector6::<f64>::zeros(); 8];
    for Touching { place, h, r, w } in touching {
        let octant = (0..3).fold(0, |o, axis| 2 * o + usize::from(place[axis] > middle[axis]));
        gradients[octant] += h * (w * r);
    }
    gradients.iter().map(|g| g * g.transpose()).sum()
}
