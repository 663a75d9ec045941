//! Fast point feature histograms (Rusu, Blodow, Beetz, ICRA 2009).
//!
//! For every pair of a point and a neighbour within the radius, the Darboux frame at the
//! one whose normal is nearer to the line between them gives three angles; eleven bins
//! each over all neighbours make the *simplified* histogram (SPFH) of a point. Its FPFH
//! adds those of its neighbours, weighted by the inverse squared distance.
//!
//! The histogram follows Open3D's reading (group order θ, α, φ; every group of the
//! neighbours' part scaled to 100, the point's own SPFH added unweighted), from which this
//! differs in two points: neighbours without a normal or at the very place of the point
//! are left out, where Open3D counts them as a pair of angles zero; and nothing caps the
//! number of neighbours.

use crate::geometry::Direction;
use crate::geometry::neighbours::RadiusGrid;
use crate::scan::Surface;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Bins of one angle.
const BINS: usize = 11;
/// Dimension of the histogram: three angles.
pub const DIMENSION: usize = 3 * BINS;
/// What the bins of one angle add up to in a simplified histogram.
const GROUP_SUM: f32 = 100.0;

type Histogram = [f32; DIMENSION];

/// Histograms of the chosen surface points, `[rows.len() · 33]`, not normalised.
///
/// All points of the surface within `radius_m` (positive) of a chosen one take part as its
/// support. A point without neighbours, or without a normal, gives a row of zeros.
pub fn histograms(surface: &Surface, rows: &[usize], radius_m: f32) -> Vec<f32> {
    let grid = RadiusGrid::new(&surface.points, radius_m);
    let simplified: Vec<Histogram> =
        (0..surface.len()).into_par_iter().map(|i| simplified_histogram(surface, &grid, i)).collect();
    rows.par_iter().flat_map_iter(|&i| weighted_histogram(surface, &grid, &simplified, i)).collect()
}

/// Descriptors `[rows.len() · 33]` for Euclidean comparison: square root of the histogram,
/// so that the distance is Hellinger's, scaled to unit length.
pub fn descriptors(surface: &Surface, rows: &[usize], radius_m: f32) -> Vec<f32> {
    let mut values = histograms(surface, rows, radius_m);
    for row in values.chunks_exact_mut(DIMENSION) {
        // The squares of the roots are the bins themselves.
        let sum: f32 = row.iter().sum();
        if sum > 0.0 {
            row.iter_mut().for_each(|v| *v = (*v / sum).sqrt());
        }
    }
    values
}

/// SPFH of point `i`: each group adds up to 100, or to nothing without a neighbour.
fn simplified_histogram(surface: &Surface, grid: &RadiusGrid<'_>, i: usize) -> Histogram {
    let (point, normal) = (&surface.points[i], &surface.normals[i]);
    let mut counts = [0u32; DIMENSION];
    if *normal == Direction::zeros() {
        return [0.0; DIMENSION];
    }
    grid.for_each_within(point, |k, square| {
        let other = &surface.normals[k];
        if square > 0.0 && *other != Direction::zeros() {
            for bin in pair_bins(surface.points[k] - point, square.sqrt(), normal, other) {
                counts[bin] += 1;
            }
        }
    });
    // One count a group and neighbour.
    let neighbours: u32 = counts[..BINS].iter().sum();
    let share = GROUP_SUM / neighbours.max(1) as f32;
    counts.map(|c| c as f32 * share)
}

/// FPFH of point `i` from the simplified histograms of its neighbourhood.
fn weighted_histogram(
    surface: &Surface,
    grid: &RadiusGrid<'_>,
    simplified: &[Histogram],
    i: usize,
) -> Histogram {
    let mut sum = [0.0f32; DIMENSION];
    if surface.normals[i] == Direction::zeros() {
        return sum;
    }
    grid.for_each_within(&surface.points[i], |k, square| {
        if square > 0.0 {
            let weight = 1.0 / square;
            sum.iter_mut().zip(&simplified[k]).for_each(|(s, v)| *s += weight * v);
        }
    });
    for (group, own) in sum.chunks_exact_mut(BINS).zip(simplified[i].chunks_exact(BINS)) {
        let total: f32 = group.iter().sum();
        let scale = if total > 0.0 { GROUP_SUM / total } else { 0.0 };
        group.iter_mut().zip(own).for_each(|(g, o)| *g = *g * scale + o);
    }
    sum
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
    use crate::geometry::Point;
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
        let text = include_str!("../../tests/fixtures/fpfh_open3d.json");
        let r: Reference = serde_json::from_str(text).unwrap();
        let points = r.points.into_iter().map(Point::from).collect();
        let normals = r.normals.into_iter().map(Direction::from).collect();
        (Surface { points, normals }, r.radius, r.fpfh)
    }

    #[test]
    fn histograms_agree_with_open3d() {
        let (surface, radius, expected) = reference();
        let rows: Vec<usize> = (0..surface.len()).collect();
        let values = histograms(&surface, &rows, radius);
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
        let surface = Surface { normals: vec![Direction::z(); 25], points };
        let values = histograms(&surface, &[12], 2.1);
        for (bin, v) in values.iter().enumerate() {
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
        };
        let rows: Vec<usize> = (0..surface.len()).collect();
        let (a, b) = (descriptors(&surface, &rows, radius), descriptors(&moved, &rows, radius));
        let rows = a.chunks_exact(DIMENSION).zip(b.chunks_exact(DIMENSION));
        let far = rows.filter(|(x, y)| x.iter().zip(*y).any(|(p, q)| (p - q).abs() > 0.03)).count();
        // A pair on the very edge of a bin may change sides by rounding.
        assert!(far <= 2, "{far} of 60 descriptors changed");
        for row in a.chunks_exact(DIMENSION) {
            assert!((row.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn points_without_normal_or_neighbour_take_no_part() {
        let (mut surface, radius, _) = reference();
        let before = histograms(&surface, &[0, 1, 2], radius);
        surface.points.extend([surface.points[1] + Vector3::new(0.01, 0.0, 0.0), Point::new(9.0, 9.0, 9.0)]);
        surface.normals.extend([Direction::zeros(), Direction::z()]);
        assert_eq!(histograms(&surface, &[0, 1, 2], radius), before);
        assert_eq!(histograms(&surface, &[60, 61], radius), vec![0.0; 2 * DIMENSION]);
    }
}
