//! How much two posed point sets cover each other.

use super::Point;
use super::neighbours::RadiusGrid;
use super::rigid::{PointMover, RigidMotion};

/// Two-way overlap of two point sets.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Overlap {
    /// (points of `a` near `b` + points of `b` near `a`) / (|a| + |b|), in `[0, 1]`.
    pub ratio: f64,
    /// Root mean square distance of the counted points to their counterpart, metres.
    pub residual_m: f64,
}

/// Two-way overlap within `radius_m` of `a` and of `b` moved by `a_from_b`
/// (Li et al. 2025, transformation refinement: o_ij). Empty sets overlap nothing.
pub fn two_way_overlap(a: &[Point], b: &[Point], a_from_b: &RigidMotion, radius_m: f32) -> Overlap {
    if a.is_empty() || b.is_empty() {
        return Overlap::default();
    }
    let moved = PointMover::new(a_from_b).points(b);
    let (grid_a, grid_b) = (RadiusGrid::new(a, radius_m), RadiusGrid::new(&moved, radius_m));
    let near = |points: &[Point], grid: &RadiusGrid<'_>| {
        points
            .iter()
            .filter_map(|p| grid.nearest(p))
            .fold((0usize, 0.0f64), |(n, sum), (_, d)| (n + 1, sum + f64::from(d)))
    };
    let (na, sa) = near(a, &grid_b);
    let (nb, sb) = near(&moved, &grid_a);
    let count = na + nb;
    Overlap {
        ratio: count as f64 / (a.len() + b.len()) as f64,
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
        let o = two_way_overlap(&row, &row, &shift, 0.2);
        assert!((o.ratio - 0.6).abs() < 1e-12);
        assert!((o.residual_m - 0.1).abs() < 1e-6);
        let back = two_way_overlap(&row, &row, &shift.inverse(), 0.2);
        assert_eq!(o.ratio, back.ratio);
        let far = RigidMotion::new(Vector3::new(0.0, 50.0, 0.0), Vector3::zeros());
        assert_eq!(two_way_overlap(&row, &row, &far, 0.2), Overlap::default());
        assert_eq!(two_way_overlap(&row, &[], &shift, 0.2), Overlap::default());
    }
}
