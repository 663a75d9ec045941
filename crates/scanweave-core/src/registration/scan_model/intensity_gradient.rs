//! How the intensity of a surface changes along it.

use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::{Direction, MIN_NORMAL_COSINE};
use crate::scan::Surface;
use nalgebra::{Matrix2, Vector2};

/// Slope of the intensity along the tangent plane of every point, per metre: least squares over neighbours
/// within `radius_m` that face the same way. Zero where a point has no normal or too few neighbours.
///
/// The surface must know its intensities.
///
/// On the calling thread alone: [`ScanModel::gradients`] lets other threads wait for the result. Were the
/// work shared with them, one of them could take up, before it is done, a task that waits for it.
pub(super) fn gradients(surface: &Surface, radius_m: f32) -> Vec<Direction> {
    let grid = RadiusGrid::new(&surface.points, radius_m);
    (0..surface.len()).map(|at| gradient(surface, &grid, at).unwrap_or_default()).collect()
}

fn gradient(surface: &Surface, grid: &RadiusGrid<'_>, at: usize) -> Option<Direction> {
    /// Neighbours that fix a slope.
    const FEWEST: usize = 5;
    let (p, n) = (surface.points[at], surface.normals[at]);
    if n == Direction::zeros() {
        return None;
    }
    let u = n.cross(&Direction::ith(n.iamin(), 1.0)).normalize();
    let v = n.cross(&u);
    let (mut square, mut right, mut count) = (Matrix2::<f64>::zeros(), Vector2::<f64>::zeros(), 0);
    grid.for_each_within(&p, |k, _| {
        if k != at && surface.normals[k].dot(&n) >= MIN_NORMAL_COSINE {
            let d = surface.points[k] - p;
            let on_plane = Vector2::new(f64::from(u.dot(&d)), f64::from(v.dot(&d)));
            square += on_plane * on_plane.transpose();
            right += on_plane * f64::from(surface.intensities[k] - surface.intensities[at]);
            count += 1;
        }
    });
    if count < FEWEST {
        return None;
    }
    // Neighbours on a line fix the slope along it only.
    let ridge = 1e-3 * square.trace();
    let fitted = (square + Matrix2::identity() * ridge).cholesky()?.solve(&right).cast::<f32>();
    Some(u * fitted.x + v * fitted.y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;

    /// A tilted plane whose intensity rises by `rise` a metre.
    fn ramp(rise: Direction) -> (Surface, Direction) {
        let (u, v) = (Direction::new(2.0, 1.0, -2.0) / 3.0, Direction::new(2.0, -2.0, 1.0) / 3.0);
        let normal = u.cross(&v);
        let points: Vec<Point> =
            (0..1600).map(|i| Point::from(u * (i % 40) as f32 * 0.02 + v * (i / 40) as f32 * 0.02)).collect();
        let intensities = points.iter().map(|p| 0.5 + rise.dot(&p.coords)).collect();
        let surface =
            Surface { normals: vec![normal; points.len()], points, intensities, ..Surface::default() };
        (surface, normal)
    }

    #[test]
    fn the_slope_of_a_ramp_is_its_rise_along_the_plane() {
        let rise = Direction::new(0.3, -0.2, 0.4);
        let (surface, normal) = ramp(rise);
        let expected = rise - normal * rise.dot(&normal);
        for gradient in gradients(&surface, 0.07) {
            assert!((gradient - expected).norm() < 5e-3 * expected.norm(), "{gradient} {expected}");
        }
    }
}
