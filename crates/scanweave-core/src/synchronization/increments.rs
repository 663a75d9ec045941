//! Weighted least squares on differences along the links of a network.

use super::network::Network;
use crate::geometry::RigidMotion;
use crate::geometry::rigid::motion;
use crate::geometry::sparse::BlockMatrix;
use nalgebra::{Matrix1, SMatrix, UnitQuaternion, Vector3};

/// Weights below this share of the largest count as this share, so that parts joined by
/// nearly worthless links keep a place relative to each other.
const LEAST_SHARE: f64 = 1e-9;

/// The values x, one a node, that minimise Σ w‖x_j − x_i − d‖² over the links `(i, j)`, with
/// zero at the pivot. `None` when a number is not finite.
pub(super) fn from_differences(
    network: &Network,
    weights: &[f64],
    differences: &[Vector3<f64>],
) -> Option<Vec<Vector3<f64>>> {
    let least = LEAST_SHARE * weights.iter().copied().fold(0.0, f64::max);
    let mut laplacian = BlockMatrix::<1>::zeros(network.n);
    let mut rhs = vec![SMatrix::<f64, 1, 3>::zeros(); network.n];
    for ((link, &w), d) in network.links.iter().zip(weights).zip(differences) {
        let w = w.max(least);
        laplacian.add(link.i, link.i, &Matrix1::new(w));
        laplacian.add(link.j, link.j, &Matrix1::new(w));
        laplacian.add(link.j, link.i, &Matrix1::new(-w));
        rhs[link.j] += d.transpose() * w;
        rhs[link.i] -= d.transpose() * w;
    }
    // The right-hand sides sum to zero: holding the pivot at zero costs nothing.
    let hold = laplacian.diagonal(network.pivot);
    laplacian.add(network.pivot, network.pivot, &hold);
    let solution = laplacian.solve(&rhs)?;
    let values: Vec<Vector3<f64>> = solution.iter().map(|row| row.transpose()).collect();
    values.iter().all(|v| v.iter().all(|x| x.is_finite())).then_some(values)
}

/// Poses with the given rotations and the translations that fit best: weighted least squares
/// on R_i t_ij = t_j − t_i and R_j t_ji = t_i − t_j. Where the
/// rotations do not fit the link exactly the two differ, and only both together do not depend
/// on which way it points.
pub(super) fn with_translations(
    network: &Network,
    rotations: &[UnitQuaternion<f64>],
    weights: &[f64],
) -> Option<Vec<RigidMotion>> {
    let differences: Vec<Vector3<f64>> = network
        .links
        .iter()
        .map(|l| {
            let forward = rotations[l.i] * l.i_from_j.translation.vector;
            let backward = rotations[l.j] * l.i_from_j.inverse().translation.vector;
            (forward - backward) * 0.5
        })
        .collect();
    let translations = from_differences(network, weights, &differences)?;
    let poses = rotations.iter().zip(translations).map(|(r, t)| motion(r.to_rotation_matrix(), t));
    Some(poses.collect())
}
