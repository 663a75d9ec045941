//! Rotation averaging by iteratively reweighted least squares.
//!
//! Chatterjee & Govindu, "Efficient and Robust Large-Scale Rotation Averaging" (ICCV 2013)
//! and "Robust Relative Rotation Averaging" (PAMI 2018). With R_i = world_from_i and R_ij
//! taking j to i, every link leaves ω_ij = log(R_i R_ij R_jᵀ) in the world frame; the
//! increments that remove it to first order solve Δω_j − Δω_i = ω_ij in the least squares
//! sense.

use super::increments::{from_differences, with_translations};
use super::network::Network;
use crate::geometry::RigidMotion;
use nalgebra::{UnitQuaternion, Vector3};

/// Rounds of a norm at most.
const ROUNDS: usize = 250;
/// Mean step at which a norm is done, radians.
const STOP_RAD: f64 = 1e-3;
/// Root of the largest weight.
const LARGEST_ROOT: f64 = 1e4;

/// The p of an ℓp norm of rotation errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Norm(f64);

/// ℓ1: root weights r^−½.
pub(super) const L1: Norm = Norm(1.0);
/// ℓ½: root weights r^−¾.
pub(super) const L_HALF: Norm = Norm(0.5);

impl Norm {
    /// Weight of an error of `r` radians.
    pub fn weight(self, r: f64) -> f64 {
        // A zero error has an infinite root weight before it is bounded.
        r.powf(0.5 * (self.0 - 2.0)).min(LARGEST_ROOT).powi(2)
    }
}

/// Rotations under each norm in turn from the strongest tree, then translations.
pub(super) fn solve(network: &Network, norms: &[Norm]) -> Option<Vec<RigidMotion>> {
    let mut rotations: Vec<UnitQuaternion<f64>> =
        network.tree_poses().into_iter().map(|pose| pose.rotation).collect();
    let mut weights = vec![1.0; network.links.len()];
    for &norm in norms {
        weights = average(network, &mut rotations, weights, norm)?;
    }
    with_translations(network, &rotations, &weights)
}

/// Moves `rotations` to the average under `norm`; `weights` count in the first round. Returns
/// the weights at the end.
///
/// The first weights cannot come from the start: on a tree, its own links leave no error and
/// would outweigh all others for ever.
pub(super) fn average(
    network: &Network,
    rotations: &mut [UnitQuaternion<f64>],
    mut weights: Vec<f64>,
    norm: Norm,
) -> Option<Vec<f64>> {
    for _ in 0..ROUNDS {
        let increments = from_differences(network, &weights, &errors(network, rotations))?;
        for (rotation, increment) in rotations.iter_mut().zip(&increments) {
            *rotation = UnitQuaternion::from_scaled_axis(*increment) * *rotation;
        }
        weights = errors(network, rotations).iter().map(|e| norm.weight(e.norm())).collect();
        let mean = increments.iter().map(Vector3::norm).sum::<f64>() / network.n as f64;
        if mean < STOP_RAD {
            break;
        }
    }
    Some(weights)
}

/// ω_ij of every link, radians.
pub(super) fn errors(network: &Network, rotations: &[UnitQuaternion<f64>]) -> Vec<Vector3<f64>> {
    let error = |l: &super::network::Link| {
        (rotations[l.i] * l.i_from_j.rotation * rotations[l.j].inverse()).scaled_axis()
    };
    network.links.iter().map(error).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_those_of_the_norms() {
        // Weighted squares w·r² are r for ℓ1 and √r for ℓ½; near zero root weights end at 1e4.
        for r in [0.01, 0.3, 2.0] {
            assert!((L1.weight(r) * r * r - r).abs() < 1e-12);
            assert!((L_HALF.weight(r) * r * r - r.sqrt()).abs() < 1e-12);
        }
        assert_eq!((L1.weight(0.0), L_HALF.weight(0.0)), (1e8, 1e8));
    }
}
