//! Ground truth for posed scans: overlaps, benchmark pairs, information matrices.

use crate::geometry::PointMover;
use crate::geometry::RadiusGrid;
use crate::geometry::{Overlap, two_way_overlap};
use crate::geometry::{Point, RigidMotion};
use crate::scan::{PairTruth, ScanId, SimilarityMatrix};
use crate::{Error, Result};
use nalgebra::{Matrix3x6, Matrix6};
use rayon::prelude::*;
use std::ops::Range;

/// Overlaps of the 3DMatch benchmark's pairs: more than 0.3.
pub const MATCH_OVERLAP: Range<f64> = 0.3..f64::INFINITY;
/// Overlaps of the 3DLoMatch benchmark's pairs: more than 0.1, at most 0.3.
pub const LO_MATCH_OVERLAP: Range<f64> = 0.1..0.3;

/// Overlaps of every two posed point sets, `[N,N]` each.
#[derive(Debug, Clone, PartialEq)]
pub struct Overlaps {
    /// (points of i near j + points of j near i) / (|i| + |j|).
    pub two_way: SimilarityMatrix,
    /// Points of the first scan i < j near j / |i|: the overlap that the published
    /// `gt_overlap.log` files hold and by which 3DMatch and 3DLoMatch are told apart (checked
    /// against them; where scans differ in size it is far from the two-way one).
    pub of_first: SimilarityMatrix,
}

/// The two-way overlaps of [`overlaps`].
///
/// # Errors
/// When the numbers of clouds and poses differ.
pub fn overlap_matrix(
    clouds: &[&[Point]],
    world_from_scan: &[RigidMotion],
    radius_m: f32,
) -> Result<SimilarityMatrix> {
    Ok(overlaps(clouds, world_from_scan, radius_m)?.two_way)
}

/// Overlaps within `radius_m` of every two posed point sets. Parallel over pairs.
///
/// # Errors
/// When the numbers of clouds and poses differ.
pub fn overlaps(clouds: &[&[Point]], world_from_scan: &[RigidMotion], radius_m: f32) -> Result<Overlaps> {
    let n = clouds.len();
    if world_from_scan.len() != n {
        return Err(Error::input(
            "poses",
            format!("{} poses for {n} scans", world_from_scan.len()),
            "one pose for every scan",
            "check that scans and poses belong to the same set",
        ));
    }
    let grids: Vec<RadiusGrid<'_>> = clouds.par_iter().map(|c| RadiusGrid::new(c, radius_m)).collect();
    let values: Vec<Overlap> = (0..n * n)
        .into_par_iter()
        .map(|at| {
            let (i, j) = (at / n, at % n);
            if i >= j {
                return Overlap::default();
            }
            let i_from_j = world_from_scan[i].inverse() * world_from_scan[j];
            two_way_overlap(&grids[i], &grids[j], &i_from_j)
        })
        .collect();
    let matrix = |of: fn(&Overlap) -> f64| {
        // Only the upper half was computed.
        let mirrored = (0..n * n).map(|at| of(&values[at]).max(of(&values[at % n * n + at / n])) as f32);
        SimilarityMatrix::new(n, mirrored.collect())
    };
    Ok(Overlaps { two_way: matrix(|o| o.ratio)?, of_first: matrix(|o| o.of_a)? })
}

/// Pairs `i < j` whose overlap is above the start of `overlaps` and not above its end,
/// ordered by `i`, then `j`.
pub fn benchmark_pairs(overlap: &SimilarityMatrix, overlaps: &Range<f64>) -> Vec<(ScanId, ScanId)> {
    let n = overlap.len();
    let wanted = |i: usize, j: usize| {
        // Compared in single precision, which the matrix holds: 0.3 is then not above 0.3.
        let o = overlap.get(i, j);
        o > overlaps.start as f32 && o <= overlaps.end as f32
    };
    (0..n)
        .flat_map(|i| (i + 1..n).map(move |j| (i, j)))
        .filter(|&(i, j)| wanted(i, j))
        .map(|(i, j)| (ScanId(i), ScanId(j)))
        .collect()
}

/// Λ = Σ GᵀG with G = `[I | −[p]×]` over points `p` in the frame of scan `i` that have a
/// counterpart in scan `j` (Choi, Zhou, Koltun 2015).
///
/// This is the convention of the published `gt.info` files: no factor 2 for the half angles of
/// a quaternion, points in the target's frame. Those files hold sums over 5000 sampled
/// correspondences; the recall divides by Λ₀₀, so that the number does not matter.
pub fn information_matrix(points: &[Point]) -> Matrix6<f64> {
    points.iter().fold(Matrix6::zeros(), |sum, p| {
        let mut g = Matrix3x6::identity();
        g.fixed_view_mut::<3, 3>(0, 3).copy_from(&-p.coords.cast::<f64>().cross_matrix());
        sum + g.transpose() * g
    })
}

/// Truth of one pair of posed scans: the relative pose, and the information matrix over the
/// points of `i` with a point of `j` within `radius_m`.
pub fn pair_truth(
    (i, j): (ScanId, ScanId),
    points_i: &[Point],
    points_j: &[Point],
    i_from_j: RigidMotion,
    radius_m: f32,
) -> PairTruth {
    let moved = PointMover::new(&i_from_j).points(points_j);
    let grid = RadiusGrid::new(&moved, radius_m);
    let common: Vec<Point> = points_i.iter().filter(|p| grid.any(p)).copied().collect();
    PairTruth { i, j, i_from_j, information: Some(information_matrix(&common)) }
}

/// Truth of every pair whose overlap lies in `overlaps`. Parallel over pairs.
///
/// # Errors
/// When clouds, poses and overlaps are of different numbers.
pub fn truth_of_pairs(
    clouds: &[&[Point]],
    world_from_scan: &[RigidMotion],
    overlap: &SimilarityMatrix,
    overlaps: &Range<f64>,
    radius_m: f32,
) -> Result<Vec<PairTruth>> {
    if clouds.len() != world_from_scan.len() || clouds.len() != overlap.len() {
        return Err(Error::input(
            "ground truth",
            format!("{} scans, {} poses, {} overlaps", clouds.len(), world_from_scan.len(), overlap.len()),
            "as many of each",
            "check that scans, poses and overlaps belong to the same set",
        ));
    }
    let truth = |&(i, j): &(ScanId, ScanId)| {
        let i_from_j = world_from_scan[i.0].inverse() * world_from_scan[j.0];
        pair_truth((i, j), clouds[i.0], clouds[j.0], i_from_j, radius_m)
    };
    Ok(benchmark_pairs(overlap, overlaps).par_iter().map(truth).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_matrix_holds_the_two_way_overlap_of_every_pair() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut number = |s: f32| rng.random_range(-s..s);
        let clouds: Vec<Vec<Point>> = (0..5)
            .map(|k| (0..300 + 50 * k).map(|_| Point::new(number(1.0), number(1.0), number(0.2))).collect())
            .collect();
        let poses: Vec<RigidMotion> = (0..5)
            .map(|k| {
                RigidMotion::new(
                    Vector3::new(0.6 * f64::from(k), 0.1, if k == 4 { 40.0 } else { 0.0 }),
                    Vector3::z() * f64::from(k),
                )
            })
            .collect();
        let views: Vec<&[Point]> = clouds.iter().map(Vec::as_slice).collect();
        let m = overlap_matrix(&views, &poses, 0.1).unwrap();
        let mut positive = 0;
        for i in 0..5 {
            assert_eq!(m.get(i, i), 0.0);
            assert_eq!(m.get(i, 4), 0.0);
            for j in i + 1..5 {
                let (a, b) = (RadiusGrid::new(&clouds[i], 0.1), RadiusGrid::new(&clouds[j], 0.1));
                let o = two_way_overlap(&a, &b, &(poses[i].inverse() * poses[j]));
                // A point on the rim of the radius may round either way: one in 600.
                assert!((f64::from(m.get(i, j)) - o.ratio).abs() < 2e-3, "{i} {j}");
                assert_eq!(m.get(i, j), m.get(j, i));
                positive += usize::from(o.ratio > 0.05);
            }
        }
        assert!(positive >= 3);
        assert!(overlap_matrix(&views, &poses[..2], 0.1).is_err());
        let (first, second) = (&clouds[0], &clouds[1][..100]);
        let o = overlaps(&[first, second], &poses[..2], 0.1).unwrap().of_first.get(0, 1);
        let grid = RadiusGrid::new(second, 0.1);
        let near =
            first.iter().filter(|p| grid.any(&(poses[1].inverse() * poses[0] * p.cast()).cast())).count();
        assert!((f64::from(o) - near as f64 / first.len() as f64).abs() < 5e-3, "{o} {near}");
        assert_eq!(overlap_matrix(&[&[], &clouds[0]], &poses[..2], 0.1).unwrap().get(0, 1), 0.0);
    }

    #[test]
    fn benchmarks_split_at_their_limits() {
        let mut values = vec![0.0; 16];
        for (i, j, o) in [(0, 1, 0.3), (0, 2, 0.31), (0, 3, 0.1), (1, 2, 0.11), (1, 3, 0.9)] {
            values[i * 4 + j] = o;
            values[j * 4 + i] = o;
        }
        let m = SimilarityMatrix::new(4, values).unwrap();
        let ids = |v: &[(usize, usize)]| v.iter().map(|p| (ScanId(p.0), ScanId(p.1))).collect::<Vec<_>>();
        assert_eq!(benchmark_pairs(&m, &MATCH_OVERLAP), ids(&[(0, 2), (1, 3)]));
        assert_eq!(benchmark_pairs(&m, &LO_MATCH_OVERLAP), ids(&[(0, 1), (1, 2)]));
    }

    #[test]
    fn information_is_the_quadratic_form_of_moved_points() {
        // ξᵀΛξ = Σ‖t − p×ω‖² = Σ‖t + ω×p‖², the first-order motion of the points.
        let points = [[1.0, 2.0, 3.0], [-1.0, 0.5, 2.0]].map(Point::from);
        let information = information_matrix(&points);
        let (t, w) = (Vector3::new(0.1, 0.2, -0.3), Vector3::new(0.01, -0.02, 0.05));
        let xi = nalgebra::Vector6::new(t.x, t.y, t.z, w.x, w.y, w.z);
        let expected: f64 = points.iter().map(|p| (t + w.cross(&p.coords.cast())).norm_squared()).sum();
        assert!((xi.dot(&(information * xi)) - expected).abs() < 1e-12);
        // Entries of one point as they stand in the files: Λ₀₄ = z, Λ₀₅ = −y, Λ₁₅ = x, Λ₃₃ = y² + z².
        let one = information_matrix(&points[..1]);
        assert_eq!((one[(0, 0)], one[(0, 4)], one[(0, 5)], one[(1, 5)]), (1.0, 3.0, -2.0, 1.0));
        assert_eq!((one[(3, 3)], one[(3, 4)]), (13.0, -2.0));
    }

    #[test]
    fn truth_of_a_pair_uses_the_common_points_in_the_target_frame() {
        let a = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]].map(Point::from);
        let b = [[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [9.0, 9.0, 9.0]].map(Point::from);
        let poses = [RigidMotion::translation(2.0, 0.0, 0.0), RigidMotion::translation(3.0, 0.0, 0.0)];
        let views = [&a[..], &b[..]];
        let m = overlap_matrix(&views, &poses, 0.1).unwrap();
        assert!((m.get(0, 1) - 4.0 / 6.0).abs() < 1e-6);
        let truth = truth_of_pairs(&views, &poses, &m, &MATCH_OVERLAP, 0.1).unwrap();
        assert_eq!(truth.len(), 1);
        assert_eq!(truth[0].i_from_j, RigidMotion::translation(1.0, 0.0, 0.0));
        assert_eq!(truth[0].information, Some(information_matrix(&a[..2])));
    }
}
