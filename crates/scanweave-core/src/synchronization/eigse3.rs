//! Spectral synchronisation of rigid motions.
//!
//! Arrigoni, Rossi & Fusiello, "Spectral Synchronization of Multiple Views in SE(3)" (SIAM
//! J. Imaging Sciences 2016). With X_i = scan_from_world and T_ij taking j to i, exact motions
//! satisfy Σ_j w_ij T_ij X_j = (Σ_j w_ij) X_i: the stacked X span the leading 4-dimensional
//! eigenspace of D⁻¹Z. A change of basis makes every fourth row (0,0,0,1), then every block is
//! projected to SE(3). Cauchy weights with a scale from the median absolute deviation, iterated.

use super::network::Network;
use super::spectral::{distance, orthonormal, rotations_of};
use crate::geometry::RigidMotion;
use crate::geometry::rigid::motion;
use crate::geometry::sparse::BlockMatrix;
use nalgebra::{DMatrix, Matrix3, Matrix4, Vector3, Vector4};

/// Rounds of reweighting at most.
const ROUNDS: usize = 50;
/// Largest change of a weight at which the reweighting is done.
const STOP: f64 = 1e-4;
/// The Cauchy constant that keeps 95 % efficiency on Gaussian errors.
const CAUCHY: f64 = 2.385;
/// Standard deviation of a Gaussian over its median absolute deviation.
const MAD: f64 = 1.4826;
/// Distance of the sought eigenvalues from the point the inverse iteration looks at.
const SHIFT: f64 = 1e-4;
/// Rounds of inverse iteration at most, and the movement of the subspace that ends them.
const INVERSE_ROUNDS: usize = 100;
const INVERSE_STOP: f64 = 1e-10;

/// Poses from reweighted eigenspaces.
pub(super) fn solve(network: &Network) -> Option<Vec<RigidMotion>> {
    let scale_m = typical_length_m(network);
    let motions: Vec<Matrix4<f64>> =
        network.links.iter().map(|l| scaled(&l.i_from_j, 1.0 / scale_m)).collect();
    let mut weights = vec![1.0; motions.len()];
    let mut space: Vec<Matrix4<f64>> =
        network.tree_poses().iter().map(|pose| scaled(&pose.inverse(), 1.0 / scale_m)).collect();
    let mut scan_from_world = Vec::new();
    for _ in 0..ROUNDS {
        space = leading_four(network, &motions, &weights, space)?;
        scan_from_world = poses_of(&space)?;
        let next = cauchy_weights(network, &motions, &scan_from_world);
        let change = weights.iter().zip(&next).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        weights = next;
        if change < STOP {
            break;
        }
    }
    Some(
        scan_from_world
            .iter()
            .map(|pose: &RigidMotion| {
                let mut pose = *pose;
                pose.translation.vector *= scale_m;
                pose.inverse()
            })
            .collect(),
    )
}

/// The median length of the translations, so that metres and radians weigh alike.
fn typical_length_m(network: &Network) -> f64 {
    let mut lengths: Vec<f64> = network.links.iter().map(|l| l.i_from_j.translation.vector.norm()).collect();
    lengths.sort_by(f64::total_cmp);
    match lengths[lengths.len() / 2] {
        length if length > 1e-9 => length,
        _ => 1.0,
    }
}

fn scaled(pose: &RigidMotion, factor: f64) -> Matrix4<f64> {
    let mut m = pose.to_homogeneous();
    m.fixed_view_mut::<3, 1>(0, 3).scale_mut(factor);
    m
}

/// The eigenspace of D⁻¹Z for the eigenvalues nearest to one, by inverse iteration on
/// A = (1 + shift) − D⁻¹Z through its normal equations.
fn leading_four(
    network: &Network,
    motions: &[Matrix4<f64>],
    weights: &[f64],
    start: Vec<Matrix4<f64>>,
) -> Option<Vec<Matrix4<f64>>> {
    let mut degree = vec![0.0; network.n];
    for (link, w) in network.links.iter().zip(weights) {
        degree[link.i] += w;
        degree[link.j] += w;
    }
    // Rows of A: the blocks that are not zero, the diagonal first.
    let diagonal = Matrix4::identity() * (1.0 + SHIFT);
    let mut rows: Vec<Vec<(usize, Matrix4<f64>)>> = (0..network.n).map(|i| vec![(i, diagonal)]).collect();
    for ((link, w), t) in network.links.iter().zip(weights).zip(motions) {
        rows[link.i].push((link.j, t * (-w / degree[link.i])));
        rows[link.j].push((link.i, inverse(t) * (-w / degree[link.j])));
    }
    let mut normal = BlockMatrix::<4>::zeros(network.n);
    for row in &rows {
        for (at, (i, a)) in row.iter().enumerate() {
            for (j, b) in &row[..=at] {
                normal.add(*i, *j, &(a.transpose() * b));
            }
        }
    }
    let factor = normal.cholesky()?;
    let ones = vec![1.0; network.n];
    let mut space = orthonormal(start, &ones)?;
    for _ in 0..INVERSE_ROUNDS {
        let mut projected = vec![Matrix4::zeros(); network.n];
        for (row, x) in rows.iter().zip(&space) {
            for (j, block) in row {
                projected[*j] += block.transpose() * x;
            }
        }
        let next = orthonormal(factor.solve(&projected), &ones)?;
        let moved = distance(&space, &next, &ones);
        space = next;
        if moved < INVERSE_STOP {
            break;
        }
    }
    Some(space)
}

fn inverse(t: &Matrix4<f64>) -> Matrix4<f64> {
    let r = t.fixed_view::<3, 3>(0, 0).transpose();
    let mut m = Matrix4::identity();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(&r);
    m.fixed_view_mut::<3, 1>(0, 3).copy_from(&(-r * t.fixed_view::<3, 1>(0, 3)));
    m
}

/// Rigid motions from a basis of the eigenspace.
fn poses_of(space: &[Matrix4<f64>]) -> Option<Vec<RigidMotion>> {
    let basis = affine_basis(space)?;
    let blocks: Vec<Matrix4<f64>> = space.iter().map(|x| x * basis).collect();
    let linear: Vec<Matrix3<f64>> = blocks.iter().map(|b| b.fixed_view::<3, 3>(0, 0).into_owned()).collect();
    // Every linear part is R_i K with one K for all: the nearest rotation to it is R_i times the
    // nearest one to K, which is only another frame.
    let rotations = rotations_of(&linear)?;
    let translations = blocks.iter().map(|b| -> Vector3<f64> { b.fixed_view::<3, 1>(0, 3).into_owned() });
    Some(rotations.into_iter().zip(translations).map(|(r, t)| motion(r, t)).collect())
}

/// The change of basis after which every fourth row is (0,0,0,1) in the least squares sense.
fn affine_basis(space: &[Matrix4<f64>]) -> Option<Matrix4<f64>> {
    let fourth = DMatrix::from_fn(space.len(), 4, |i, c| space[i][(3, c)]);
    let gram: Matrix4<f64> = Matrix4::from_iterator((fourth.transpose() * &fourth).iter().copied());
    let eigen = gram.symmetric_eigen();
    let mut order = [0, 1, 2, 3];
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let largest = eigen.eigenvalues[order[3]];
    (largest > 0.0).then_some(())?;
    // Three directions in which the fourth rows vanish, and q with F q = 1.
    let along: Vector4<f64> = eigen.eigenvectors.column(order[3]).into_owned();
    let sum: f64 = (0..space.len()).map(|i| fourth.row(i).dot(&along.transpose())).sum();
    let q = along * (sum / largest);
    let null = |k: usize| eigen.eigenvectors.column(order[k]).into_owned();
    Some(Matrix4::from_columns(&[null(0), null(1), null(2), q]))
}

/// Cauchy weights of the links at these poses (scaled like the motions).
fn cauchy_weights(network: &Network, motions: &[Matrix4<f64>], scan_from_world: &[RigidMotion]) -> Vec<f64> {
    let residuals: Vec<f64> = network
        .links
        .iter()
        .zip(motions)
        .map(|(link, t)| {
            let fitted = scan_from_world[link.i] * scan_from_world[link.j].inverse();
            // Both directions, so that it does not matter which way an edge points.
            let forward = (t - fitted.to_homogeneous()).norm_squared();
            let backward = (inverse(t) - fitted.inverse().to_homogeneous()).norm_squared();
            (0.5 * (forward + backward)).sqrt()
        })
        .collect();
    let middle = median(&residuals);
    let spread = median(&residuals.iter().map(|r| (r - middle).abs()).collect::<Vec<_>>());
    // Exact links have no spread, and all count in full.
    let scale = (CAUCHY * MAD * spread).max(1e-9);
    residuals.iter().map(|r| 1.0 / (1.0 + (r / scale).powi(2))).collect()
}

fn median(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
