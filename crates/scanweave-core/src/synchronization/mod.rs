//! The global paradigm: all pairs first, then all poses at once from the graph of pairs.
//!
//! A [`PoseGraph`] goes in, and every scan comes out with a pose in the frame of its
//! component or with the reason why it has none. The methods differ in how they tell right
//! edges from wrong ones:
//!
//! | Method | Rotations | Wrong edges |
//! |---|---|---|
//! | [`Method::Eigse3`] | leading eigenspace of the block matrix of motions | Cauchy weights |
//! | [`Method::L1Irls`] | least squares on increments | ℓ1 weights |
//! | [`Method::Rotavg`] | the same | ℓ½ weights |
//! | [`Method::Hara`] | tree of triplet support, then as before | dropped, then ℓ½ |
//! | [`Method::Sghr`] | smallest eigenspace of the weighted block Laplacian | weights with a history |
//! | [`Method::Lits`] | a recurrent graph network updates poses | learnt weights |
//! | [`Method::PoseGraph`] | Levenberg–Marquardt on SE(3) | Geman–McClure, graduated |

pub(crate) mod config;
pub(crate) mod graph;
pub(crate) mod lits;

mod eigse3;
mod hara;
mod increments;
mod network;
mod optimization;
mod rotations;
mod sghr;
mod spectral;

pub use config::{GraphKind, Method, SynchronizationConfig};
pub use lits::LitsWeights;

use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::monitor::Monitor;
use crate::scan::{Outcome, Placement, PoseGraph, Reconstruction};
use network::{Component, Network};

/// Poses of all scans from the pairwise registrations between them.
///
/// Scans that no edge joins are components of their own, each in the frame of the scan whose
/// edges have most inliers; a scan without any edge is declined with the reason that the
/// graph gives. Calling the scans something else, or turning edges around, changes nothing.
///
/// `lits` is needed by [`Method::Lits`] alone.
///
/// # Errors
/// When an edge is no rigid motion between two scans of the graph, weights are missing, or the
/// monitor is cancelled.
pub fn synchronize(
    graph: &PoseGraph,
    method: Method,
    lits: Option<&LitsWeights>,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    check(graph)?;
    let solve = solver(method, lits)?;
    let components = network::components(graph);
    let mut outcomes: Vec<Outcome> =
        graph.without_edges.iter().map(|reason| Outcome::Declined(reason.clone())).collect();
    monitor.begin("synchronization", components.len());
    for (number, component) in components.iter().enumerate() {
        monitor.check("synchronization")?;
        let poses = solve(&component.network).ok_or_else(|| {
            Error::input(
                "pose graph",
                format!("edges that {method} finds no poses for"),
                "rigid motions of moderate size",
                "register with another method, or look for scans in other units",
            )
        })?;
        for (place, placement) in placements(graph, component, &poses, number) {
            outcomes[place] = Outcome::Placed(placement);
        }
        monitor.advance(1);
    }
    monitor.end();
    Ok(Reconstruction { outcomes })
}

/// Whether a method has what it needs, to be asked before pairs are registered.
///
/// # Errors
/// [`Error::Setting`] when the learned method has no weights.
pub fn check_weights(method: Method, lits: Option<&LitsWeights>) -> Result<()> {
    solver(method, lits).map(|_| ())
}

/// Poses of a connected network, in any common frame; `None` when its numbers are beyond use.
type Solver<'a> = Box<dyn Fn(&Network) -> Option<Vec<RigidMotion>> + 'a>;

fn solver(method: Method, lits: Option<&LitsWeights>) -> Result<Solver<'_>> {
    Ok(match method {
        Method::Eigse3 => Box::new(eigse3::solve),
        Method::L1Irls => Box::new(|network| rotations::solve(network, &[rotations::L1])),
        Method::Rotavg => Box::new(|network| rotations::solve(network, &[rotations::L1, rotations::L_HALF])),
        Method::Hara => Box::new(hara::solve),
        Method::Sghr => Box::new(sghr::solve),
        Method::Lits => {
            let weights = lits.ok_or_else(|| {
                Error::setting(
                    "synchronization.lits_weights",
                    "nothing",
                    "the weights of the network",
                    "import published ones with `scanweave import-weights --from lits` and name the file",
                )
            })?;
            Box::new(move |network| lits::solve(network, weights))
        }
        Method::PoseGraph => Box::new(optimization::solve),
    })
}

fn check(graph: &PoseGraph) -> Result<()> {
    let wrong = |found: String, expected: &str| {
        Err(Error::input("pose graph", found, expected, "build it again from the scans"))
    };
    if graph.without_edges.len() != graph.scans {
        let found = format!("{} reasons for {} scans", graph.without_edges.len(), graph.scans);
        return wrong(found, "one a scan");
    }
    let mut pairs: Vec<_> = graph.edges.iter().map(|e| (e.i.min(e.j), e.i.max(e.j))).collect();
    pairs.sort_unstable();
    if let Some(twice) = pairs.windows(2).find(|w| w[0] == w[1]) {
        return wrong(format!("two edges between {} and {}", twice[0].0, twice[0].1), "one a pair");
    }
    for e in &graph.edges {
        if e.i == e.j || e.i.0 >= graph.scans || e.j.0 >= graph.scans {
            return wrong(format!("an edge between {} and {}", e.i, e.j), "two scans of the graph");
        }
        let numbers = [e.similarity, e.i_from_j().rotation.norm(), e.i_from_j().translation.vector.norm()];
        if numbers.iter().any(|v| !v.is_finite()) {
            return wrong(format!("an edge between {} and {} that is not finite", e.i, e.j), "numbers");
        }
    }
    Ok(())
}

/// Placements of a component's scans in the frame of its pivot, with the edges of the
/// strongest tree from there as what speaks for them.
fn placements<'a>(
    graph: &'a PoseGraph,
    component: &'a Component,
    poses: &[RigidMotion],
    number: usize,
) -> impl Iterator<Item = (usize, Placement)> + 'a {
    let network = &component.network;
    let pivot_from_world = poses[network.pivot].inverse();
    let placed = move |step: usize, world_from_scan: RigidMotion| Placement {
        world_from_scan,
        component: number,
        step,
        parent: None,
        matches: 0,
        inliers: 0,
        residual_m: 0.0,
        evidence: None,
        neighbours: Vec::new(),
        pose_uncertainty: None,
    };
    let pivot = (component.scans[network.pivot].0, placed(0, RigidMotion::identity()));
    let rest: Vec<_> = network
        .strongest_tree()
        .into_iter()
        .enumerate()
        .map(|(step, (node, link))| {
            let edge = &graph.edges[component.edges[link]];
            let other = network.links[link].other(node);
            let placement = Placement {
                parent: Some(component.scans[other]),
                matches: edge.pair.matches,
                inliers: edge.pair.inliers,
                residual_m: edge.pair.residual_m,
                ..placed(step + 1, pivot_from_world * poses[node])
            };
            (component.scans[node].0, placement)
        })
        .collect();
    std::iter::once(pivot).chain(rest)
}
