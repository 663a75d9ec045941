//! Pairwise truth of posed scans, as `gt.log` and `gt.info` hold it.

use crate::error::Result;
use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::overlap::two_way_overlap;
use crate::geometry::rigid::PointMover;
use crate::geometry::{Point, RigidMotion};
use crate::monitor::Monitor;
use crate::scan::{PairTruth, ScanId};
use nalgebra::{Matrix3, Matrix3x6, Matrix6};
use rayon::prelude::*;

/// A pair of scans that overlap, with its truth.
#[derive(Debug, Clone)]
pub struct OverlappingPair {
    /// Relative pose and information matrix.
    pub truth: PairTruth,
    /// Two-way overlap, in `[0, 1]`.
    pub overlap: f64,
}

/// All pairs `i < j` whose `points` overlap by more than `min_overlap` at the true poses, points
/// within `radius_m` of each other counting, in ascending order of `(i, j)`.
///
/// # Errors
/// [`crate::Error::Interrupted`] once `monitor` says so.
pub fn overlapping_pairs(
    points: &[Vec<Point>],
    world_from_scan: &[RigidMotion],
    radius_m: f32,
    min_overlap: f64,
    monitor: &dyn Monitor,
) -> Result<Vec<OverlappingPair>> {
    const STAGE: &str = "true overlaps";
    let n = points.len().min(world_from_scan.len());
    monitor.begin(STAGE, n);
    let grids: Vec<RadiusGrid<'_>> = points.par_iter().map(|p| RadiusGrid::new(p, radius_m)).collect();
    let rows: Vec<Result<Vec<OverlappingPair>>> = (0..n)
        .into_par_iter()
        .map(|i| {
            monitor.check(STAGE)?;
            let pair = |j: usize| {
                let i_from_j = world_from_scan[i].inverse() * world_from_scan[j];
                let overlap = two_way_overlap(&grids[i], &grids[j], &i_from_j).ratio;
                (overlap > min_overlap).then(|| {
                    let information = Some(information_matrix(&grids[i], &points[j], &i_from_j));
                    let truth = PairTruth { i: ScanId(i), j: ScanId(j), i_from_j, information };
                    OverlappingPair { truth, overlap }
                })
            };
            let row = (i + 1..n).filter_map(pair).collect();
            monitor.advance(1);
            Ok(row)
        })
        .collect();
    monitor.end();
    Ok(rows.into_iter().collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
}

/// Λ = Σ GᵀG with G = (I | −[q]×) over the points q of the source, in its own frame, that have
/// a counterpart in the target (Choi, Zhou & Koltun 2015, with the scale of the published files).
fn information_matrix(
    target: &RadiusGrid<'_>,
    source: &[Point],
    target_from_source: &RigidMotion,
) -> Matrix6<f64> {
    let mover = PointMover::new(target_from_source);
    let met = source.iter().filter(|q| target.nearest(&mover.point(q)).is_some());
    met.fold(Matrix6::zeros(), |sum, q| {
        let mut g = Matrix3x6::zeros();
        g.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        g.fixed_view_mut::<3, 3>(0, 3).copy_from(&-q.coords.cast::<f64>().cross_matrix());
        sum + g.transpose() * g
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::monitor::Silent;
    use nalgebra::{Vector3, Vector6};

    #[test]
    fn information_predicts_the_squared_displacement_of_the_overlap() {
        // Scan 1 holds the points of scan 0 seen from elsewhere, scan 2 is far away.
        let first: Vec<Point> =
            (0..60).map(|i| Point::new((i % 4) as f32, (i / 4 % 5) as f32, (i / 20) as f32 + 2.0)).collect();
        let world_from_1 = RigidMotion::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.3, -0.2, 0.9));
        let mover = PointMover::new(&world_from_1.inverse());
        let second: Vec<Point> = first.iter().map(|p| mover.point(p)).collect();
        let poses = [RigidMotion::identity(), world_from_1, RigidMotion::translation(100.0, 0.0, 0.0)];
        let points = [first.clone(), second.clone(), first];
        let pairs = overlapping_pairs(&points, &poses, 0.1, 0.3, &Silent).unwrap();
        assert_eq!(pairs.len(), 1);
        let pair = &pairs[0];
        assert_eq!((pair.truth.i.0, pair.truth.j.0), (0, 1));
        assert_eq!(pair.overlap, 1.0);
        assert!((pair.truth.i_from_j.translation.vector - world_from_1.translation.vector).norm() < 1e-12);
        let information = pair.truth.information.unwrap();
        assert_eq!(information[(0, 0)], 60.0);
        // A small motion (t, ω) of the source moves its points by t + ω×q: ξᵀΛξ is the sum of
        // squares, here summed point by point.
        let (t, w) = (Vector3::new(0.01, -0.02, 0.005), Vector3::new(0.003, 0.001, -0.002));
        let direct: f64 = second.iter().map(|q| (t + w.cross(&q.coords.cast::<f64>())).norm_squared()).sum();
        let xi = Vector6::new(t.x, t.y, t.z, w.x, w.y, w.z);
        assert!(((xi.transpose() * information * xi)[0] - direct).abs() < 1e-9 * direct.max(1.0));
    }
}
