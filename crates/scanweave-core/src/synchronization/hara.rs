//! Hierarchical rotation averaging.
//!
//! After Lee & Civera, "HARA: A Hierarchical Approach for Robust Rotation Averaging" (CVPR
//! 2022), from the paper alone. A tree grows over the links with many and strong triplet
//! supports first and over weaker ones later; a node that several accepted links vote on gets
//! their robust average. Links that contradict the start are dropped, the rest are averaged
//! under ℓ½.

use super::increments::with_translations;
use super::network::Network;
use super::rotations::{L_HALF, average, errors};
use crate::geometry::RigidMotion;
use crate::geometry::averaging::rotation_median;
use nalgebra::{Matrix3, UnitQuaternion};

/// Errors up to which the loop of a triplet counts as closed, strongest first, degrees.
const LOOP_ERRORS_DEG: [f64; 3] = [3.0, 6.0, 12.0];
/// Triplets that support a link, most first; the last level takes any link.
const SUPPORTS: [usize; 5] = [10, 5, 3, 2, 1];
/// Error from which a link contradicts the start, degrees.
const CONTRADICTION_DEG: f64 = 15.0;
/// Rounds and step of the average of votes.
const VOTE_ROUNDS: usize = 10;
const VOTE_STOP: f64 = 1e-3;

/// Rotations, then translations from the links that were kept.
pub(super) fn solve(network: &Network) -> Option<Vec<RigidMotion>> {
    let (mut rotations, tree) = initial(network)?;
    let limit = CONTRADICTION_DEG.to_radians();
    let off: Vec<f64> = errors(network, &rotations).iter().map(|e| e.norm()).collect();
    let kept = network.with_links(|at, _| off[at] <= limit || tree[at]);
    let weights = average(&kept, &mut rotations, vec![1.0; kept.links.len()], L_HALF)?;
    with_translations(&kept, &rotations, &weights)
}

/// How many triplets close around each link, for each of [`LOOP_ERRORS_DEG`].
fn supports(network: &Network) -> Vec<[usize; 3]> {
    let adjacency = network.adjacency();
    // Rotation that takes `to` to `from`, over a link.
    let across = |link: usize, from: usize| {
        let l = &network.links[link];
        if l.i == from { l.i_from_j.rotation } else { l.i_from_j.rotation.inverse() }
    };
    network
        .links
        .iter()
        .enumerate()
        .map(|(at, link)| {
            let mut count = [0; 3];
            for (k, &to_k) in &adjacency[link.i] {
                let Some(&from_k) = adjacency[link.j].get(k) else { continue };
                let around = across(at, link.i) * across(from_k, link.j) * across(to_k, *k);
                for (count, limit) in count.iter_mut().zip(LOOP_ERRORS_DEG) {
                    *count += usize::from(around.angle() <= limit.to_radians());
                }
            }
            count
        })
        .collect()
}

/// A start for every node, and the links that hold it together.
fn initial(network: &Network) -> Option<(Vec<UnitQuaternion<f64>>, Vec<bool>)> {
    let supports = supports(network);
    let adjacency = network.adjacency();
    let mut known: Vec<Option<UnitQuaternion<f64>>> = vec![None; network.n];
    let mut tree = vec![false; network.links.len()];
    known[root(network, &supports)] = Some(UnitQuaternion::identity());
    let levels: Vec<(usize, usize)> = SUPPORTS
        .iter()
        .flat_map(|&s| (0..LOOP_ERRORS_DEG.len()).map(move |l| (l, s)))
        .chain([(2, 0)])
        .collect();
    // Whenever a node joins, the strongest level may go on.
    let mut level = 0;
    while level < levels.len() {
        let (strength, least) = levels[level];
        let accepts = |link: usize| supports[link][strength] >= least;
        let Some(node) = next_node(network, &supports, &known, accepts, strength) else {
            level += 1;
            continue;
        };
        let votes: Vec<(usize, UnitQuaternion<f64>)> = adjacency[node]
            .iter()
            .filter(|(_, link)| accepts(**link))
            .filter_map(|(other, &link)| {
                let l = &network.links[link];
                let to_node = if l.i == *other { l.i_from_j.rotation } else { l.i_from_j.rotation.inverse() };
                Some((link, known[*other]? * to_node))
            })
            .collect();
        let rotation = average_votes(network, &votes, &supports, strength)?;
        let closest =
            votes.iter().min_by(|a, b| a.1.angle_to(&rotation).total_cmp(&b.1.angle_to(&rotation)))?;
        tree[closest.0] = true;
        known[node] = Some(rotation);
        level = 0;
    }
    Some((known.into_iter().collect::<Option<_>>()?, tree))
}

/// The node whose links have most support; inliers break ties.
fn root(network: &Network, supports: &[[usize; 3]]) -> usize {
    let mut sum = vec![[0; 4]; network.n];
    for (link, support) in network.links.iter().zip(supports) {
        for node in [link.i, link.j] {
            let of_link = support.iter().chain([&link.inliers]);
            sum[node].iter_mut().zip(of_link).for_each(|(sum, s)| *sum += s);
        }
    }
    (0..network.n).rev().max_by_key(|&node| sum[node]).unwrap_or(network.pivot)
}

/// What decides between links: support, then inliers, then similarity.
fn rank(network: &Network, supports: &[[usize; 3]], link: usize, strength: usize) -> (usize, usize, u64) {
    let l = &network.links[link];
    // The bits of positive numbers are in the order of the numbers.
    (supports[link][strength], l.inliers, l.similarity.max(0.0).to_bits())
}

/// The unknown node that the best accepted link reaches.
fn next_node(
    network: &Network,
    supports: &[[usize; 3]],
    known: &[Option<UnitQuaternion<f64>>],
    accepts: impl Fn(usize) -> bool,
    strength: usize,
) -> Option<usize> {
    network
        .links
        .iter()
        .enumerate()
        .rev()
        .filter(|(at, l)| accepts(*at) && known[l.i].is_some() != known[l.j].is_some())
        .max_by_key(|(at, _)| rank(network, supports, *at, strength))
        .map(|(_, l)| if known[l.i].is_some() { l.j } else { l.i })
}

/// The geometric median of the votes, from the best-supported one.
fn average_votes(
    network: &Network,
    votes: &[(usize, UnitQuaternion<f64>)],
    supports: &[[usize; 3]],
    strength: usize,
) -> Option<UnitQuaternion<f64>> {
    let (_, best) = votes.iter().rev().max_by_key(|v| rank(network, supports, v.0, strength))?;
    if votes.len() < 3 {
        return Some(*best);
    }
    let matrix = |r: &UnitQuaternion<f64>| -> Matrix3<f64> { r.to_rotation_matrix().into_inner() };
    let observations: Vec<(Matrix3<f64>, f64)> = votes.iter().map(|v| (matrix(&v.1), 1.0)).collect();
    let median = rotation_median(&matrix(best), &observations, VOTE_ROUNDS, VOTE_STOP)?;
    Some(UnitQuaternion::from_rotation_matrix(&median))
}
