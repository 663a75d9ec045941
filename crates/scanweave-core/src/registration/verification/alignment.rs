//! The small motion that makes the surfaces of two groups of scans sit better.

use super::surface_fit::{Posed, pass};
use crate::geometry::RigidMotion;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// A step that moves nothing by more than this many radii is the last.
const SETTLED: f64 = 0.02;

/// The motion near `a_from_b` at which the tangent planes of the two groups meet best: at most
/// `rounds` Gauss–Newton steps with new counterparts each, on every `stride`-th sampled point.
pub fn align(
    a: &[Posed<'_>],
    b: &[Posed<'_>],
    a_from_b: &RigidMotion,
    rounds: usize,
    stride: usize,
) -> RigidMotion {
    let mut current = *a_from_b;
    // Small steps do not bring scans together that were apart: who touches is found once.
    let mut touching = Vec::new();
    if b.is_empty() {
        return current;
    }
    for _ in 0..rounds {
        let sums = pass(a, b, &current, stride, Some(&mut touching));
        if sums.agreeing < 20 {
            break;
        }
        let mut damped = sums.information();
        // Directions that nothing holds stay: light damping relative to the strongest one.
        let floor = 1e-4 * damped.diagonal().max();
        for d in 0..6 {
            damped[(d, d)] += floor;
        }
        let Some(step) = damped.cholesky().map(|c| c.solve(&-sums.gradient)) else { break };
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
        let shift = Translation3::new(step[3], step[4], step[5]);
        let step = Isometry3::from_parts(shift, turn);
        let moved = farthest_move(b, &current, &step);
        current = step * current;
        if moved < SETTLED * f64::from(b[0].model.radius_m) {
            break;
        }
    }
    current
}

/// How far a step takes the spheres around the scans of a group at most, metres.
fn farthest_move(b: &[Posed<'_>], a_from_b: &RigidMotion, step: &RigidMotion) -> f64 {
    let turn = step.rotation.angle();
    let of = |scan: &Posed<'_>| {
        let centre = a_from_b * (scan.group_from_scan * scan.model.centre.cast::<f64>());
        (step * centre - centre).norm() + turn * f64::from(scan.model.reach_m)
    };
    b.iter().map(of).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rigid::{PointMover, rotation_error_rad, translation_error_m};
    use crate::geometry::{Direction, Point};
    use crate::registration::scan_model::ScanModel;
    use crate::scan::Surface;

    /// Three mutually perpendicular walls, 2 m wide, every 2.5 cm, seen from inside.
    fn corner() -> Surface {
        let mut surface =
            Surface { viewpoint: Point::new(1.5, 1.5, 1.5), viewpoint_confidence: 1.0, ..Surface::default() };
        for i in 0..6400 {
            let (u, v) = ((i % 80) as f32 * 0.025, (i / 80) as f32 * 0.025);
            surface.points.extend([[u, v, 0.0], [u, 0.0, v], [0.0, u, v]].map(Point::from));
            surface.normals.extend([Direction::z(), Direction::y(), Direction::x()]);
        }
        surface
    }

    #[test]
    fn alignment_returns_to_the_exact_motion_from_either_side() {
        // Two copies of a corner, one of them in another frame: the exact motion has no residual.
        let truth = RigidMotion::new(Vector3::new(0.4, -0.2, 0.1), Vector3::new(0.2, 0.5, -0.3));
        let (one, mut other) = (corner(), corner());
        let mover = PointMover::new(&truth.inverse());
        other.points = mover.points(&other.points);
        other.normals = other.normals.iter().map(|n| mover.direction(n)).collect();
        let (a, b) =
            (ScanModel::with_sizes(&one, 0.07, 500, 0.14), ScanModel::with_sizes(&other, 0.07, 500, 0.14));
        let posed = |model| Posed { model, group_from_scan: RigidMotion::identity() };
        let off = RigidMotion::new(Vector3::new(0.03, -0.02, 0.025), Vector3::new(0.01, -0.015, 0.01));
        for (from, to, exact) in [(&a, &b, truth), (&b, &a, truth.inverse())] {
            let found = align(&[posed(from)], &[posed(to)], &(off * exact), 10, 1);
            assert!(translation_error_m(&found, &exact) < 1e-3, "{}", translation_error_m(&found, &exact));
            assert!(rotation_error_rad(&found, &exact) < 1e-3);
        }
    }
}
