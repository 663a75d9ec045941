//! Robust pose-graph optimisation: the modern yardstick.
//!
//! Levenberg–Marquardt over SE(3) with a Geman–McClure loss that starts convex and hardens
//! (graduated non-convexity, Yang, Antonante, Tzoumas & Carlone 2020).

use super::network::{Link, Network};
use crate::geometry::RigidMotion;
use crate::geometry::sparse::BlockMatrix;
use nalgebra::{Matrix3, Matrix6, SVector, Translation3, UnitQuaternion, Vector3};

type Vector6 = SVector<f64, 6>;

/// Standard deviation of an edge's rotation, radians; that of its translation is τ.
const SIGMA_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
/// Inliers of an edge of unit information.
const INLIERS: f64 = 100.0;
/// Squared error at which an edge stops to count: the 99 % quantile of χ² with six degrees of freedom.
const BARRIER: f64 = 16.81;
/// Factor by which the loss hardens in a round.
const HARDEN: f64 = 1.4;
/// Steps at most while the loss hardens, and at the end.
const STEPS: usize = 5;
const LAST_STEPS: usize = 100;
/// Relative decrease of the cost that is not worth another step.
const STOP: f64 = 1e-12;

/// Poses from the strongest tree, optimised.
pub(super) fn solve(network: &Network) -> Option<Vec<RigidMotion>> {
    let mut poses = network.tree_poses();
    let largest = squared_errors(network, &poses).fold(0.0, f64::max);
    // At this μ the loss is convex over all present errors.
    let mut softness = (2.0 * largest / BARRIER).max(1.0);
    loop {
        let steps = if softness > 1.0 { STEPS } else { LAST_STEPS };
        poses = minimise(network, poses, softness, steps)?;
        if softness <= 1.0 {
            return Some(poses);
        }
        softness = (softness / HARDEN).max(1.0);
    }
}

/// What an edge is worth: a rigid fit to n matches has a covariance of 1/n.
fn information(link: &Link) -> f64 {
    link.inliers.max(1) as f64 / INLIERS
}

/// Weight of an edge of squared error `r2`: derivative of μc²r²/(μc² + r²).
fn weight(r2: f64, softness: f64) -> f64 {
    let m = softness * BARRIER;
    (m / (m + r2)).powi(2)
}

/// Levenberg–Marquardt on the loss of one softness.
fn minimise(
    network: &Network,
    mut poses: Vec<RigidMotion>,
    softness: f64,
    steps: usize,
) -> Option<Vec<RigidMotion>> {
    let cost = |poses: &[RigidMotion]| -> f64 {
        let m = softness * BARRIER;
        squared_errors(network, poses)
            .zip(&network.links)
            .map(|(r2, link)| information(link) * m * r2 / (m + r2))
            .sum()
    };
    let mut damping = 1e-6;
    let mut current = cost(&poses);
    for _ in 0..steps {
        let (hessian, gradient) = normal_equations(network, &poses, softness);
        let mut improved = false;
        for _ in 0..10 {
            let step = step(network, &hessian, &gradient, damping)?;
            let moved: Vec<_> = poses.iter().zip(&step).map(|(p, s)| perturb(p, s)).collect();
            let next = cost(&moved);
            if next.is_nan() || next > current {
                damping *= 10.0;
                continue;
            }
            improved = current - next > STOP * current;
            (poses, current) = (moved, next);
            damping = (damping * 0.1).max(1e-9);
            break;
        }
        if !improved {
            break;
        }
    }
    poses.iter().all(|p| p.translation.vector.iter().all(|v| v.is_finite())).then_some(poses)
}

/// The damped step, which leaves the pivot where it is.
fn step(
    network: &Network,
    hessian: &BlockMatrix<6>,
    gradient: &[Vector6],
    damping: f64,
) -> Option<Vec<Vector6>> {
    let mut damped = hessian.clone();
    for node in 0..network.n {
        let diagonal = hessian.diagonal(node);
        damped.add(node, node, &(Matrix6::from_diagonal(&diagonal.diagonal()) * damping));
    }
    // Moving all poses together changes no error: the pivot can be held.
    let hold = hessian.diagonal(network.pivot).trace().max(1.0);
    damped.add(network.pivot, network.pivot, &(Matrix6::identity() * hold));
    damped.solve(&gradient.iter().map(|g| -g).collect::<Vec<_>>())
}

/// `(Jᵀ W J, Jᵀ W r)` at these poses.
fn normal_equations(
    network: &Network,
    poses: &[RigidMotion],
    softness: f64,
) -> (BlockMatrix<6>, Vec<Vector6>) {
    let mut hessian = BlockMatrix::zeros(network.n);
    let mut gradient = vec![Vector6::zeros(); network.n];
    for link in &network.links {
        let both = [linearise(link, poses, network.inlier_radius_m), {
            let (r, of_j, of_i) = linearise(&link.turned(), poses, network.inlier_radius_m);
            (r, of_i, of_j)
        }];
        let r2 = 0.5 * (both[0].0.norm_squared() + both[1].0.norm_squared());
        let w = 0.5 * information(link) * weight(r2, softness);
        for (r, of_i, of_j) in both {
            hessian.add(link.i, link.i, &(of_i.transpose() * of_i * w));
            hessian.add(link.j, link.j, &(of_j.transpose() * of_j * w));
            hessian.add(link.i, link.j, &(of_i.transpose() * of_j * w));
            gradient[link.i] += of_i.transpose() * r * w;
            gradient[link.j] += of_j.transpose() * r * w;
        }
    }
    (hessian, gradient)
}

/// Squared whitened error of every link, the mean over both directions: the translation of an
/// error depends on the frame it is seen from.
fn squared_errors(network: &Network, poses: &[RigidMotion]) -> impl Iterator<Item = f64> {
    let squared = move |l: &Link| whitened(&l.error(poses), network.inlier_radius_m).norm_squared();
    network.links.iter().map(move |l| 0.5 * (squared(l) + squared(&l.turned())))
}

/// The error motion E = T_ij⁻¹ X_i⁻¹ X_j as rotation vector and translation over their deviations.
fn whitened(error: &RigidMotion, sigma_m: f64) -> Vector6 {
    let rotation = error.rotation.scaled_axis() / SIGMA_RAD;
    let translation = error.translation.vector / sigma_m;
    Vector6::from_iterator(rotation.iter().chain(translation.iter()).copied())
}

/// A pose moved by a step in its own frame: rotation vector, then translation.
fn perturb(pose: &RigidMotion, step: &Vector6) -> RigidMotion {
    let rotation = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
    let translation = Translation3::from(step.fixed_rows::<3>(3).into_owned());
    pose * RigidMotion::from_parts(translation, rotation)
}

/// The whitened error of a link and its derivatives by steps of its two poses.
///
/// E·(I + δ_j) for a step of j. A step of i acts like one of j by −Ad(G), G = X_j⁻¹X_i.
fn linearise(link: &Link, poses: &[RigidMotion], sigma_m: f64) -> (Vector6, Matrix6<f64>, Matrix6<f64>) {
    let error = link.error(poses);
    let j_from_i = poses[link.j].inverse() * poses[link.i];
    let inverse_jacobian = inverse_right_jacobian(&error.rotation.scaled_axis());
    let turned = error.rotation.to_rotation_matrix().into_inner();
    let mut by_j = Matrix6::zeros();
    by_j.fixed_view_mut::<3, 3>(0, 0).copy_from(&(inverse_jacobian / SIGMA_RAD));
    by_j.fixed_view_mut::<3, 3>(3, 3).copy_from(&(turned / sigma_m));
    let rotation = j_from_i.rotation.to_rotation_matrix().into_inner();
    let lever = j_from_i.translation.vector.cross_matrix();
    let mut adjoint = Matrix6::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(3, 0).copy_from(&(lever * rotation));
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    (whitened(&error, sigma_m), -by_j * adjoint, by_j)
}

/// J with log(exp(φ)·exp(δ)) = φ + J δ to first order.
fn inverse_right_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let angle = phi.norm();
    let hat = phi.cross_matrix();
    let second = if angle < 1e-4 {
        1.0 / 12.0
    } else {
        // (1 + cos)/sin = cot(angle/2), finite up to π.
        1.0 / (angle * angle) - 0.5 / (angle * (0.5 * angle).tan())
    };
    Matrix3::identity() + hat * 0.5 + hat * hat * second
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(v: [f64; 6]) -> RigidMotion {
        RigidMotion::new(Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]))
    }

    #[test]
    fn derivatives_agree_with_central_differences() {
        let poses = [pose([1.0, -2.0, 0.5, 0.3, 1.2, -0.4]), pose([-0.7, 0.2, 2.0, -1.0, 0.1, 0.8])];
        let i_from_j = pose([0.4, 1.0, -0.3, 0.9, -0.2, 0.5]);
        let link = Link { i: 0, j: 1, i_from_j, inliers: 1, similarity: 1.0 };
        let (_, by_i, by_j) = linearise(&link, &poses, 0.07);
        const H: f64 = 1e-6;
        for (node, by) in [(0, by_i), (1, by_j)] {
            for k in 0..6 {
                let at = |h: f64| {
                    let mut step = Vector6::zeros();
                    step[k] = h;
                    let mut moved = poses;
                    moved[node] = perturb(&moved[node], &step);
                    whitened(&link.error(&moved), 0.07)
                };
                let numeric = (at(H) - at(-H)) / (2.0 * H);
                assert!((numeric - by.column(k)).norm() < 1e-5, "node {node}, column {k}");
            }
        }
    }

    #[test]
    fn weights_are_the_slope_of_the_loss() {
        // d/d(r²) of μc²r²/(μc² + r²) by central differences.
        for (r2, softness) in [(0.5, 1.0), (30.0, 1.0), (30.0, 40.0)] {
            let loss = |r2: f64| softness * BARRIER * r2 / (softness * BARRIER + r2);
            let slope = (loss(r2 + 1e-5) - loss(r2 - 1e-5)) / 2e-5;
            assert!((weight(r2, softness) - slope).abs() < 1e-8);
        }
        assert!(weight(100.0 * BARRIER, 1.0) < 1e-3);
    }
}
