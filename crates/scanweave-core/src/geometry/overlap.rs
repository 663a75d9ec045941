//! How much two posed point sets cover each other.

use super::Point;
use super::neighbours::RadiusGrid;
use super::rigid::{PointMover, RigidMotion};

/// Two-way overlap of two point sets.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Overlap {
    /// (points of `a` near `b` + points of `b` near `a`) / (|a| + |b|), in `[0, 1]`.
    pub ratio: f64,
    /// Points of `a` near `b` / |a|.
    pub of_a: f64,
    /// Root mean square distance of the counted points to their counterpart, metres.
    pub residual_m: f64,
}

/// Two-way overlap of the points of `a` and of `b` moved by `a_from_b`, within the
/// radius of the grids (Li et al. 2025, transformation refinement: o_ij).
///
/// Each grid indexes points in their own frame, so it is built once for any number of
/// poses. Empty sets overlap nothing.
pub fn two_way_overlap(a: &RadiusGrid<'_>, b: &RadiusGrid<'_>, a_from_b: &RigidMotion) -> Overlap {
    if a.points().is_empty() || b.points().is_empty() {
        return Overlap::default();
    }
    if a.apart_from(b, a_from_b) {
        return Overlap::default();
    }
    let near = |points: &[Point], grid: &RadiusGrid<'_>, motion: &RigidMotion| {
        let mover = PointMover::new(motion);
        points
            .iter()
            .filter_map(|p| grid.nearest(&mover.point(p)))
            .fold((0usize, 0.0f64), |(n, sum), (_, d)| (n + 1, sum + f64::from(d)))
    };
    let (nb, sb) = near(b.points(), a, a_from_b);
    // Nothing of b near a means nothing of a near b.
    let (na, sa) = if nb == 0 { (0, 0.0) } else { near(a.points(), b, &a_from_b.inverse()) };
    let count = na + nb;
    Overlap {
        ratio: count as f64 / (a.points().len() + b.points().len()) as f64,
        of_a: na as f64 / a.points().len() as f64,
        residual_m: if count == 0 { 0.0 } else { ((sa + sb) / count as f64).sqrt() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn shifted_rows_overlap_by_the_shared_share() {
        let row: Vec<Point> = (0..10).map(|i| Point::new(i as f32, 0.0, 0.0)).collect();
        // b's point 0 lands on a's point 4: six shared positions of ten on either side.
        let shift = RigidMotion::translation(4.0, 0.1, 0.0);
        let grid = RadiusGrid::new(&row, 0.2);
        let o = two_way_overlap(&grid, &grid, &shift);
        assert!((o.ratio - 0.6).abs() < 1e-12);
        assert!((o.residual_m - 0.1).abs() < 1e-6);
        assert!((o.of_a - 0.6).abs() < 1e-12);
        // All of a shorter row lies on the longer one, and half of the longer on the shorter.
        let (short, still) = (RadiusGrid::new(&row[..5], 0.2), RigidMotion::identity());
        assert_eq!(two_way_overlap(&short, &grid, &still).of_a, 1.0);
        assert_eq!(two_way_overlap(&grid, &short, &still).of_a, 0.5);
        let back = two_way_overlap(&grid, &grid, &shift.inverse());
        assert_eq!(o.ratio, back.ratio);
        let far = RigidMotion::new(Vector3::new(0.0, 50.0, 0.0), Vector3::zeros());
        assert_eq!(two_way_overlap(&grid, &grid, &far), Overlap::default());
        assert_eq!(two_way_overlap(&grid, &RadiusGrid::new(&[], 0.2), &shift), Overlap::default());
    }
}
