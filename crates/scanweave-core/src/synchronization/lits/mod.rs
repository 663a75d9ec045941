//! Learned transformation synchronisation.
//!
//! Yew & Lee, "Learning Iterative Robust Transformation Synchronization" (3DV 2021): a graph
//! network starts all poses at the identity and, in ten rounds with the same weights, moves
//! every scan by what the links around it leave over.

mod network;
mod weights;

use network::{GLOBAL, NODE, ROUNDS};
pub use weights::LitsWeights;

use super::network::{Link, Network};
use crate::geometry::RigidMotion;
use nalgebra::{Matrix3, Matrix4, UnitQuaternion, Vector3};
use network::{GraphNetwork, Messages, Rows};

/// Poses by the network with these weights.
///
/// The weights were trained on metres and know no other unit.
pub(super) fn solve(network: &Network, weights: &LitsWeights) -> Option<Vec<RigidMotion>> {
    let layers = GraphNetwork::new(weights);
    let turned: Vec<Link> = network.links.iter().map(Link::turned).collect();
    // Along a link i → j and back: every message is (from, to, to_from_from).
    let messages: Vec<(usize, usize, RigidMotion)> =
        turned.iter().chain(&network.links).map(|l| (l.j, l.i, l.i_from_j)).collect();
    let ends =
        Messages { from: messages.iter().map(|m| m.0).collect(), to: messages.iter().map(|m| m.1).collect() };
    let mut scan_from_world = vec![RigidMotion::identity(); network.n];
    let (mut nodes, mut global) = (Rows::zeros(network.n, NODE), Rows::zeros(1, GLOBAL));
    for _ in 0..ROUNDS {
        let errors: Vec<f32> = messages
            .iter()
            .flat_map(|(from, to, to_from_from)| {
                let expected = scan_from_world[*to] * scan_from_world[*from].inverse();
                flat(&(expected * to_from_from.inverse()))
            })
            .collect();
        let round = layers.round(&nodes, &global, &ends, &Rows::new(12, errors));
        (nodes, global) = (round.nodes, round.global);
        for (pose, update) in scan_from_world.iter_mut().zip(round.updates.iter()) {
            let values: [f64; 6] = std::array::from_fn(|k| f64::from(update[k]));
            *pose = exponential(&bounded(values)) * *pose;
        }
    }
    let finite = |p: &RigidMotion| p.translation.vector.iter().all(|v| v.is_finite());
    scan_from_world.iter().all(finite).then(|| scan_from_world.iter().map(RigidMotion::inverse).collect())
}

/// A motion as the network reads it: the three columns of the rotation, then the translation.
fn flat(motion: &RigidMotion) -> [f32; 12] {
    let m: Matrix4<f64> = motion.to_homogeneous();
    std::array::from_fn(|k| m[(k % 3, k / 3)] as f32)
}

/// An update (translation part, then rotation vector ω) with its rotation squashed to less than
/// half a turn: ω ← π·‖ω‖/(1 + ‖ω‖²)·ω.
fn bounded(update: [f64; 6]) -> [f64; 6] {
    let mut update = update;
    let square: f64 = update[3..].iter().map(|v| v * v).sum();
    let factor = std::f64::consts::PI * square.sqrt() / (1.0 + square);
    update[3..].iter_mut().for_each(|v| *v *= factor);
    update
}

/// The exponential of se(3), translation part first.
fn exponential(twist: &[f64; 6]) -> RigidMotion {
    let (v, omega) = (Vector3::from_column_slice(&twist[..3]), Vector3::from_column_slice(&twist[3..]));
    let (angle, hat) = (omega.norm(), omega.cross_matrix());
    let (first, second) = if angle < 1e-6 {
        (0.5, 1.0 / 6.0)
    } else {
        ((1.0 - angle.cos()) / angle.powi(2), (angle - angle.sin()) / angle.powi(3))
    };
    let translation = (Matrix3::identity() + hat * first + hat * hat * second) * v;
    RigidMotion::from_parts(translation.into(), UnitQuaternion::from_scaled_axis(omega))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_the_series_of_its_matrix() {
        let twist = [0.5, -1.0, 2.0, 0.7, -0.4, 1.1];
        let (v, w) = (Vector3::new(0.5, -1.0, 2.0), Vector3::new(0.7, -0.4, 1.1));
        let mut generator = Matrix4::zeros();
        generator.fixed_view_mut::<3, 3>(0, 0).copy_from(&w.cross_matrix());
        generator.fixed_view_mut::<3, 1>(0, 3).copy_from(&v);
        let (mut series, mut term) = (Matrix4::identity(), Matrix4::identity());
        for k in 1..40 {
            term = term * generator / f64::from(k);
            series += term;
        }
        assert!((exponential(&twist).to_homogeneous() - series).norm() < 1e-12);
    }

    #[test]
    fn rotations_of_updates_stay_below_half_a_turn() {
        // The largest factor π·m²/(1+m²) tends to π.
        let norm = |u: [f64; 6]| u[3..].iter().map(|v| v * v).sum::<f64>().sqrt();
        assert!((norm(bounded([9.0, 9.0, 9.0, 1.0, 0.0, 0.0])) - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert!(norm(bounded([0.0, 0.0, 0.0, 1e3, -1e3, 0.0])) < std::f64::consts::PI);
        assert_eq!(bounded([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]), [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]);
    }
}
