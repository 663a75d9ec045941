//! The normal equations of all poses together, and one Gauss–Newton step.

use super::terms::PairTerm;
use crate::geometry::RigidMotion;
use crate::geometry::sparse::BlockMatrix;
use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};

/// The normal equations of all poses but the first, which is held.
pub(super) fn normal_equations(
    pairs: &[(usize, usize)],
    terms: &[PairTerm],
    poses: usize,
) -> (BlockMatrix<6>, Vec<Vector6<f64>>) {
    let mut matrix = BlockMatrix::<6>::zeros(poses - 1);
    let mut right = vec![Vector6::zeros(); poses - 1];
    for (&(i, j), term) in pairs.iter().zip(terms) {
        // Scan 0 is held: its rows and columns are left out.
        for (scan, sign) in [(i, 1.0), (j, -1.0)] {
            if scan > 0 {
                matrix.add(scan - 1, scan - 1, &term.information);
                right[scan - 1] -= term.gradient * sign;
            }
        }
        if i > 0 {
            matrix.add(j - 1, i - 1, &-term.information);
        }
    }
    // A floor on the diagonal keeps directions that nothing holds where they are.
    for row in 0..right.len() {
        let floor = matrix.diagonal(row).diagonal().map(|v| 1e-6 * v + 1e-3);
        matrix.add(row, row, &Matrix6::from_diagonal(&floor));
    }
    (matrix, right)
}

/// Solves for all poses but the first and applies the step; returns the longest
/// translation of a pose, or `None` when the system cannot be solved.
pub(super) fn gauss_newton_step(
    pairs: &[(usize, usize)],
    terms: &[PairTerm],
    poses: &mut [RigidMotion],
    radius_m: f64,
) -> Option<f64> {
    let (matrix, right) = normal_equations(pairs, terms, poses.len());
    let steps = matrix.solve(&right)?;
    let mut longest = 0.0f64;
    for (pose, delta) in poses.iter_mut().skip(1).zip(steps) {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(delta[0], delta[1], delta[2]));
        let shift = Translation3::new(delta[3], delta[4], delta[5]);
        let moved = Isometry3::from_parts(shift, turn) * *pose;
        let way = (moved.translation.vector - pose.translation.vector).norm();
        // A step beyond the radius of the correspondences is not supported by them.
        if way <= 3.0 * radius_m {
            *pose = moved;
        }
        longest = longest.max(way);
    }
    Some(longest)
}
