//! Fast point feature histograms (Rusu, Blodow, Beetz, ICRA 2009).
//!
//! For every pair of a point and a neighbour within the radius, the Darboux frame at the
//! one whose normal is nearer to the line between them gives three angles; eleven bins
//! each over all neighbours make the *simplified* histogram (SPFH) of a point. Its FPFH
//! adds those of its neighbours, weighted by the inverse distance.
//!
//! The histogram follows Open3D's reading: group order θ, α, φ; every group of the
//! neighbours' part scaled to 100, the point's own SPFH added unweighted. It differs in
//! this: neighbours without a normal or at the very place of the point are left out, where
//! Open3D counts them as a pair of angles zero; nothing caps the number of neighbours; the
//! weight is the paper's, where Open3D takes the squared distance ([`Weighting`]); and the
//! support may be coarser than the points described.

use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::voxel::VoxelGroups;
use crate::geometry::{Direction, Point};
use crate::scan::Surface;
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Bins of one angle.
const BINS: usize = 11;
/// Dimension of the histogram: three angles.
pub const DIMENSION: usize = 3 * BINS;
/// What the bins of one angle add up to in a simplified histogram.
const GROUP_SUM: f32 = 100.0;

type Histogram = [f32; DIMENSION];

/// Support points along the radius of a descriptor. A finer support costs more (time grows
/// with the fourth power) and matches hardly better: on 3DMatch pairs 10 instead of 7 gave
/// an inlier ratio of 0.319 instead of 0.314.
const SUPPORT_CELLS_PER_RADIUS: f32 = 7.0;

/// How much the simplified histogram of a neighbour at distance d counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Weighting {
    /// 1/d: the paper's ω = d.
    InverseDistance,
    /// 1/d²: what Open3D and PCL do. A neighbour that happens to be close outvotes the rest.
    InverseSquare,
}

impl Weighting {
    fn of(self, square: f32) -> f32 {
        match self {
            Weighting::InverseDistance => 1.0 / square.sqrt(),
            Weighting::InverseSquare => 1.0 / square,
        }
    }
}

/// Histograms `[n · 33]`, not normalised, of `points` `[n]` with `normals` `[n]` on the
/// surface that `support` samples.
///
/// All points of the support within `radius_m` (positive) of a point take part. A point
/// without neighbours, or without a normal, gives a row of zeros.
pub fn histograms(
    points: &[Point],
    normals: &[Direction],
    support: &Surface,
    radius_m: f32,
    weighting: Weighting,
) -> Vec<f32> {
    let around = Neighbourhood { support, grid: RadiusGrid::new(&support.points, radius_m), weighting };
    let simplified: Vec<Histogram> = (support.points.par_iter().zip(&support.normals))
        .map(|(p, n)| around.simplified_histogram(p, n))
        .collect();
    (points.par_iter().zip(normals))
        .flat_map_iter(|(p, n)| around.weighted_histogram(&simplified, p, n))
        .collect()
}

/// Descriptors `[rows.len() · 33]` of the chosen surface points for Euclidean comparison:
/// square root of the histogram, so that the distance is Hellinger's, scaled to unit length.
///
/// The support is the surface thinned to a seventh of the radius, weighted by inverse
/// distance. Both were chosen on 3DMatch pairs, see `examples/matching_quality.rs`.
pub fn descriptors(surface: &Surface, rows: &[usize], radius_m: f32) -> Vec<f32> {
    let points: Vec<Point> = rows.iter().map(|&i| surface.points[i]).collect();
    let normals: Vec<Direction> = rows.iter().map(|&i| surface.normals[i]).collect();
    let support = thinned(surface, radius_m / SUPPORT_CELLS_PER_RADIUS);
    let mut values = histograms(&points, &normals, &support, radius_m, Weighting::InverseDistance);
    for row in values.chunks_exact_mut(DIMENSION) {
        // The squares of the roots are the bins themselves.
        let sum: f32 = row.iter().sum();
        if sum > 0.0 {
            row.iter_mut().for_each(|v| *v = (*v / sum).sqrt());
        }
    }
    values
}

/// Means of points and normals in voxels of `size_m`.
fn thinned(surface: &Surface, size_m: f32) -> Surface {
    let mut thin = Surface::default();
    for group in VoxelGroups::new(&surface.points, size_m).iter() {
        let (mut point, mut normal) = (Vector3::<f64>::zeros(), Direction::zeros());
        for &i in group {
            point += surface.points[i as usize].coords.cast::<f64>();
            normal += surface.normals[i as usize];
        }
        thin.points.push(Point::from((point / group.len() as f64).cast::<f32>()));
        // Opposite normals of a thin wall cancel: such a point has none.
        thin.normals.push(normal.try_normalize(0.1 * group.len() as f32).unwrap_or_default());
    }
    thin
}

/// A support and what finds the neighbours in it.
struct Neighbourhood<'a> {
    support: &'a Surface,
    grid: RadiusGrid<'a>,
    weighting: Weighting,
}

impl Neighbourhood<'_> {
    /// SPFH of a point: each group adds up to 100, or to nothing without a neighbour.
    fn simplified_histogram(&self, point: &Point, normal: &Direction) -> Histogram {
        let mut counts = [0u32; DIMENSION];
        if *normal == Direction::zeros() {
            return [0.0; DIMENSION];
        }
        self.grid.for_each_within(point, |k, square| {
            let other = &self.support.normals[k];
            if square > 0.0 && *other != Direction::zeros() {
                for bin in pair_bins(self.support.points[k] - point, square.sqrt(), normal, other) {
                    counts[bin] += 1;
                }
            }
        });
        // One count a group and neighbour.
        let neighbours: u32 = counts[..BINS].iter().sum();
        let share = GROUP_SUM / neighbours.max(1) as f32;
        counts.map(|c| c as f32 * share)
    }

    /// FPFH of a point from its own SPFH and those of its neighbours.
    fn weighted_histogram(&self, simplified: &[Histogram], point: &Point, normal: &Direction) -> Histogram {
        let mut sum = [0.0f32; DIMENSION];
        if *normal == Direction::zeros() {
            return sum;
        }
        self.grid.for_each_within(point, |k, square| {
            if square > 0.0 {
                let weight = self.weighting.of(square);
                sum.iter_mut().zip(&simplified[k]).for_each(|(s, v)| *s += weight * v);
            }
        });
        let own = self.simplified_histogram(point, normal);
        for (group, own) in sum.chunks_exact_mut(BINS).zip(own.chunks_exact(BINS)) {
            let total: f32 = group.iter().sum();
            let scale = if total > 0.0 { GROUP_SUM / total } else { 0.0 };
            group.iter_mut().zip(own).for_each(|(g, o)| *g = *g * scale + o);
        }
        sum
    }
}

/// Bins, in the whole histogram, of the three angles of a pair `offset` (length
/// `distance` > 0) apart, from the point with normal `n1` to the one with `n2`.
#[inline]
fn pair_bins(offset: Vector3<f32>, distance: f32, n1: &Direction, n2: &Direction) -> [usize; 3] {
    let (a1, a2) = (n1.dot(&offset) / distance, n2.dot(&offset) / distance);
    // The source is the point whose normal is nearer to the line; makes the angles
    // independent of the direction in which the pair is read.
    let (source, target, offset, phi) =
        if a1.abs() < a2.abs() { (n2, n1, -offset, -a2) } else { (n1, n2, offset, a1) };
    let v = offset.cross(source);
    let length = v.norm();
    if length == 0.0 {
        return [BINS / 2, BINS + BINS / 2, 2 * BINS + BINS / 2];
    }
    let v = v / length;
    let w = source.cross(&v);
    let theta = w.dot(target).atan2(source.dot(target));
    let bin = |share: f32| ((BINS as f32 * share) as usize).min(BINS - 1);
    [
        bin((theta + std::f32::consts::PI) / std::f32::consts::TAU),
        BINS + bin(0.5 * (v.dot(target) + 1.0)),
        2 * BINS + bin(0.5 * (phi + 1.0)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::RigidMotion;
    use crate::geometry::rigid::PointMover;
    use serde::Deserialize;

    #[derive(Deserialize)]
    struct Reference {
        radius: f32,
        points: Vec<[f32; 3]>,
        normals: Vec<[f32; 3]>,
        fpfh: Vec<Vec<f32>>,
    }

    /// Written by `scripts/fpfh_reference.py` with Open3D 0.20.
    fn reference() -> (Surface, f32, Vec<Vec<f32>>) {
        let text = include_str!("../../../../tests/fixtures/fpfh_open3d.json");
        let r: Reference = serde_json::from_str(text).unwrap();
        let points = r.points.into_iter().map(Point::from).collect();
        let normals = r.normals.into_iter().map(Direction::from).collect();
        (Surface { points, normals, ..Surface::default() }, r.radius, r.fpfh)
    }

    /// Histograms of the surface's own points, as Open3D has it.
    fn own_histograms(surface: &Surface, radius: f32, weighting: Weighting) -> Vec<f32> {
        histograms(&surface.points, &surface.normals, surface, radius, weighting)
    }

    #[test]
    fn histograms_agree_with_open3d() {
        let (surface, radius, expected) = reference();
        let values = own_histograms(&surface, radius, Weighting::InverseSquare);
        for (i, (ours, theirs)) in values.chunks_exact(DIMENSION).zip(&expected).enumerate() {
            for (bin, (a, b)) in ours.iter().zip(theirs).enumerate() {
                // Sums of some twenty terms up to 100 in single precision.
                assert!((a - b).abs() < 2e-3, "point {i} bin {bin}: {a} here, {b} there");
            }
        }
    }

    #[test]
    fn a_plane_fills_the_middle_bins_only() {
        // All normals e_z, all offsets in the plane: θ = α = φ = 0, the middle of eleven bins.
        let points: Vec<Point> = (0..25).map(|i| Point::new((i % 5) as f32, (i / 5) as f32, 0.0)).collect();
        let surface = Surface { normals: vec![Direction::z(); 25], points, ..Surface::default() };
        let values = own_histograms(&surface, 2.1, Weighting::InverseDistance);
        for (bin, v) in values[12 * DIMENSION..13 * DIMENSION].iter().enumerate() {
            let expected = if bin % BINS == 5 { 200.0 } else { 0.0 };
            assert!((v - expected).abs() < 1e-3, "bin {bin}: {v}");
        }
        let unit = descriptors(&surface, &[12], 2.1);
        assert!((unit[5] - (1.0f32 / 3.0).sqrt()).abs() < 1e-6);
    }

    #[test]
    fn a_rigid_motion_leaves_the_descriptors() {
        let (surface, radius, _) = reference();
        let mover =
            PointMover::new(&RigidMotion::new(Vector3::new(0.3, -0.2, 0.4), Vector3::new(0.7, -1.2, 0.4)));
        let moved = Surface {
            points: mover.points(&surface.points),
            normals: surface.normals.iter().map(|n| mover.direction(n)).collect(),
            ..Surface::default()
        };
        let of = |surface| own_histograms(surface, radius, Weighting::InverseDistance);
        let (a, b) = (of(&surface), of(&moved));
        let rows = a.chunks_exact(DIMENSION).zip(b.chunks_exact(DIMENSION));
        let far = rows.filter(|(x, y)| x.iter().zip(*y).any(|(p, q)| (p - q).abs() > 2.0)).count();
        // A pair on the very edge of a bin may change sides by rounding.
        assert!(far <= 2, "{far} of 60 descriptors changed");
    }

    #[test]
    fn points_without_normal_or_neighbour_take_no_part() {
        let (mut surface, radius, _) = reference();
        let before = own_histograms(&surface, radius, Weighting::InverseDistance);
        surface.points.extend([surface.points[1] + Vector3::new(0.01, 0.0, 0.0), Point::new(9.0, 9.0, 9.0)]);
        surface.normals.extend([Direction::zeros(), Direction::z()]);
        let after = own_histograms(&surface, radius, Weighting::InverseDistance);
        assert_eq!(after[..before.len()], before);
        assert_eq!(after[before.len()..], [0.0; 2 * DIMENSION]);
    }

    #[test]
    fn two_neighbours_are_weighted_by_distance() {
        // A flat point with a flat neighbour at d = 1 and, at d = 2, one whose normal leans
        // 90° about the line between them. By hand: the flat pair has α = 0, the middle bin;
        // the leaning one v = x̂ × ẑ up to sign = ŷ, so α = v·ŷ = 1, the last bin.
        let points = [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [-2.0, 0.0, 0.0]].map(Point::from).to_vec();
        let normals = vec![Direction::z(), Direction::z(), Direction::y()];
        let surface = Surface { points, normals, ..Surface::default() };
        for (weighting, share) in [(Weighting::InverseDistance, 0.5), (Weighting::InverseSquare, 0.25)] {
            let row = &own_histograms(&surface, 2.5, weighting)[..DIMENSION];
            // Own SPFH: half in either bin. The two neighbours do not see each other (d = 3):
            // the near one has 100 in the middle bin, the far one 100 in the last.
            let alpha = &row[BINS..2 * BINS];
            assert!((alpha[5] - (50.0 + 100.0 / (1.0 + share))).abs() < 1e-3, "{weighting:?} {alpha:?}");
            assert!((alpha[10] - (50.0 + 100.0 * share / (1.0 + share))).abs() < 1e-3);
        }
    }

    #[test]
    fn a_thinned_support_has_mean_points_and_normals() {
        let points = [[0.1f32, 0.1, 0.1], [0.3, 0.1, 0.1], [1.5, 0.5, 0.5], [1.5, 0.5, 0.6]].map(Point::from);
        let normals = vec![Direction::z(), Direction::x(), Direction::y(), -Direction::y()];
        let thin = thinned(&Surface { points: points.to_vec(), normals, ..Surface::default() }, 1.0);
        assert!((thin.points[0] - Point::new(0.2, 0.1, 0.1)).norm() < 1e-6);
        assert!((thin.normals[0] - Direction::new(0.5f32.sqrt(), 0.0, 0.5f32.sqrt())).norm() < 1e-6);
        assert_eq!(thin.normals[1], Direction::zeros());
    }
}
