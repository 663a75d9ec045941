//! How certain refined poses are.

use super::PosedScan;
use super::terms::{Reach, Sample, Touching, for_each_touch, overlapping_pairs};
use crate::geometry::RigidMotion;
use crate::geometry::sparse::BlockMatrix;
use crate::registration::config::MultiviewIcpConfig;
use nalgebra::{Matrix6, Point3, Vector3};
use rayon::prelude::*;

/// By how much poses vary more than the errors of patches tell: what bends a scan as a whole, its
/// residuals do not show. Set so that the normalised error of three 3DMatch scenes is as expected
/// (redkitchen, hotel3, home_at; FPFH).
const UNSEEN: f64 = 8.0;
/// Cells of a pair's touching surface along every axis.
const CELLS: usize = 4;
/// Where they part, in units of the root mean square distance from their middle.
const PARTINGS: [f64; CELLS - 1] = [-0.6, 0.0, 0.6];

/// Covariance of every pose relative to the first at refined poses, in the order of `scans`: of a
/// rotation vector (radians) and the displacement of the scan's centre (metres), in the frame of
/// the poses. Zero for the first; `None` where the system cannot be solved.
///
/// The errors of points near each other are those of one surface, one sensor, one bent scan: more
/// points do not make a pose more certain. A scan therefore counts as one observation of its touching
/// surface, shared among the scans that it overlaps; its variance is that of the mean residuals of
/// patches (the variance between clusters), not of points. With H the normal equations of a pair and W
/// the sum of its weights, the covariance is the inverse of Σ H / (W·n·σ²) over all pairs, n the overlapping
/// scans of that one of the two which has more.
pub fn pose_covariances(
    scans: &[PosedScan<'_>],
    config: &MultiviewIcpConfig,
    radius_m: f64,
) -> Vec<Option<Matrix6<f64>>> {
    let poses: Vec<RigidMotion> = scans.iter().map(|s| s.world_from_scan).collect();
    let samples: Vec<Sample> =
        scans.iter().map(|s| Sample::new(s.model.surface, config.points_per_scan)).collect();
    let pairs = overlapping_pairs(&samples, scans, &poses, config.min_overlap, radius_m as f32);
    let finest = Reach::of_radius(config.radii.last().copied().unwrap_or(1.0) * radius_m);
    let every = vec![1; scans.len()];
    let observation_of = |&pair: &(usize, usize)| {
        let mut touching = Vec::new();
        for_each_touch(pair, &samples, scans, &poses, &every, finest, |touch| touching.push(touch));
        Observation::of(&touching)
    };
    let observations: Vec<Observation> = pairs.par_iter().map(observation_of).collect();
    let (between, weight) = observations.iter().fold((0.0, 0.0), |s, o| (s.0 + o.between, s.1 + o.weight));
    let variance = UNSEEN * between / f64::max(weight, f64::MIN_POSITIVE);
    let mut partners = vec![0usize; scans.len()];
    pairs.iter().for_each(|&(i, j)| [i, j].into_iter().for_each(|s| partners[s] += 1));
    let mut information = BlockMatrix::<6>::zeros(scans.len().saturating_sub(1));
    for (&(i, j), observation) in pairs.iter().zip(&observations).filter(|o| o.1.weight > 0.0) {
        let shared = partners[i].max(partners[j]) as f64;
        let of_pair = observation.information / (observation.weight * shared);
        // The first scan is held: its rows and columns are left out.
        for scan in [i, j].into_iter().filter(|&scan| scan > 0) {
            information.add(scan - 1, scan - 1, &of_pair);
        }
        if i > 0 {
            information.add(j - 1, i - 1, &-of_pair);
        }
    }
    // Directions that nothing holds are very uncertain, not singular.
    for row in 0..information.len() {
        let floor = information.diagonal(row).diagonal().map(|v| 1e-9 * v + 1e-12);
        information.add(row, row, &Matrix6::from_diagonal(&floor));
    }
    let factor = information.cholesky();
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

/// What a pair says of its relative pose, and how far its residuals hang together.
struct Observation {
    /// Σ w h hᵀ.
    information: Matrix6<f64>,
    /// Σ w.
    weight: f64,
    /// Σ (Σ w r)² / Σ w over the cells of the touching surface.
    between: f64,
}

impl Observation {
    fn of(touching: &[Touching]) -> Self {
        let n = touching.len().max(1) as f64;
        let middle = Point3::from(touching.iter().map(|t| t.place.coords).sum::<Vector3<f64>>() / n);
        let size = (touching.iter().map(|t| (t.place - middle).norm_squared()).sum::<f64>() / n).sqrt();
        let cell = |v: f64| PARTINGS.iter().filter(|&&parting| v > parting * size).count();
        let mut cells = [(0.0, 0.0); CELLS * CELLS * CELLS];
        let mut information = Matrix6::zeros();
        for Touching { place, h, r, w } in touching {
            information += h * h.transpose() * *w;
            let at = (place - middle).iter().fold(0, |at, v| CELLS * at + cell(*v));
            cells[at].0 += w * r;
            cells[at].1 += w;
        }
        let held = cells.iter().filter(|c| c.1 > 0.0);
        Self {
            information,
            weight: cells.iter().map(|c| c.1).sum(),
            between: held.map(|(residual, weight)| residual * residual / weight).sum(),
        }
    }
}
