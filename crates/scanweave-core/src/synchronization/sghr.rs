//! Spectral rotation synchronisation with history reweighting.
//!
//! Wang et al., "Robust Multiview Point Cloud Registration with Reliable Pose Graph
//! Initialization and History Reweighting" (CVPR 2023). The eigenproblem is taken relative to
//! the degrees of the nodes: its exact solutions are those of the printed Laplacian, but a
//! scan whose links have all lost their weight does not claim the smallest eigenvalues.

use super::increments::with_translations;
use super::network::Network;
use super::rotations::errors;
use super::spectral::{rotations_of, smallest_three};
use crate::geometry::RigidMotion;
use crate::geometry::sparse::BlockMatrix;
use nalgebra::{Matrix3, UnitQuaternion};

/// Rounds of reweighting M.
const ROUNDS: usize = 50;
/// Inliers are counted in hundreds.
const INLIERS: f64 = 100.0;
/// Weights below this share of the largest count as this share.
const LEAST_SHARE: f64 = 1e-12;

/// Rotations by [`ROUNDS`] rounds of history reweighting, then translations.
pub(super) fn solve(network: &Network) -> Option<Vec<RigidMotion>> {
    let start = |l: &super::network::Link| l.similarity.max(0.0) * l.inliers as f64 / INLIERS;
    let mut weights: Vec<f64> = network.links.iter().map(start).collect();
    if weights.iter().all(|w| *w <= 0.0) {
        weights = vec![1.0; weights.len()];
    }
    let mut blocks = network.tree_poses().iter().map(|p| matrix(&p.rotation).transpose()).collect();
    let (mut rotations, found) = spectral_rotations(network, &weights, blocks)?;
    blocks = found;
    for round in 0..ROUNDS {
        for (w, error) in weights.iter_mut().zip(errors(network, &rotations)) {
            *w *= history_factor(round, error.norm().to_degrees());
        }
        (rotations, blocks) = spectral_rotations(network, &weights, blocks)?;
    }
    with_translations(network, &rotations, &weights)
}

/// exp(−2(m+1)·δ / Σ_{m<M}(m+1)) in round m: later rounds, whose rotations are better, count more.
fn history_factor(round: usize, error_deg: f64) -> f64 {
    let total = (ROUNDS * (ROUNDS + 1)) as f64 / 2.0;
    (-2.0 * (round + 1) as f64 * error_deg / total).exp()
}

/// world_from_scan of every node, and the eigenvectors to start the next round from: block i is
/// scan_from_world up to a common factor.
type Found = (Vec<UnitQuaternion<f64>>, Vec<Matrix3<f64>>);

fn spectral_rotations(network: &Network, weights: &[f64], start: Vec<Matrix3<f64>>) -> Option<Found> {
    let largest = weights.iter().copied().fold(0.0, f64::max);
    (largest > 0.0).then_some(())?;
    let mut laplacian = BlockMatrix::<3>::zeros(network.n);
    let mut degree = vec![0.0; network.n];
    for (link, &w) in network.links.iter().zip(weights) {
        let w = (w / largest).max(LEAST_SHARE);
        degree[link.i] += w;
        degree[link.j] += w;
        laplacian.add(link.i, link.j, &(-w * matrix(&link.i_from_j.rotation)));
    }
    for (node, d) in degree.iter().enumerate() {
        laplacian.add(node, node, &(Matrix3::identity() * *d));
    }
    let blocks = smallest_three(&laplacian, &degree, start)?;
    let scan_from_world = rotations_of(&blocks)?;
    let rotations = scan_from_world.iter().map(|r| UnitQuaternion::from_rotation_matrix(&r.inverse()));
    Some((rotations.collect(), blocks))
}

fn matrix(rotation: &UnitQuaternion<f64>) -> Matrix3<f64> {
    rotation.to_rotation_matrix().into_inner()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_whole_history_of_a_constant_error_weighs_twice_its_degrees() {
        // Σ(m+1)/Σ(m+1) = 1, so that a link that is always δ off ends at exp(−2δ).
        let product: f64 = (0..ROUNDS).map(|m| history_factor(m, 3.0)).product();
        assert!((product / (-6.0f64).exp() - 1.0).abs() < 1e-12);
        assert!(history_factor(49, 1.0) < history_factor(0, 1.0));
    }
}
