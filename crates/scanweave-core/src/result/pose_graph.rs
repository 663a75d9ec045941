//! A component as a pose graph: its scans, what was measured between them, and how firmly.
//!
//! Edges are
//! - the pairs that were registered, where the poses come from a pose graph that is at hand, all marked as
//!   uncertain;
//! - else every scan and its parent: measured is `parent_from_scan`, the pose when the scan joined, or
//!   where that is not known the relative pose of the result;
//! - and, marked as uncertain, the scans that touch each other at the final poses: the relative pose
//!   of the result, which is no measurement of its own.
//!
//! The information of an edge is the inverse of a covariance that is made so as to state less than is
//! known rather than more:
//! - The covariances of both poses, which are relative to the pivot, are added as if independent.
//!   Scans that touch vary together, so that their relative pose is as a rule firmer than that.
//! - Where one is missing, or their sum cannot be inverted, the deviations are those from which on a
//!   scan counts as poorly localised: the inlier radius for the centre of the source, five degrees for
//!   its rotation.
//! - A measurement that differs from the final poses by e has e·eᵀ added: by so much it is known to be
//!   off, which the covariances, being those of the final poses, do not say.

use crate::geometry::RigidMotion;
use crate::io::pose_graphs::{GraphEdge, GraphNode, PoseGraphFile};
use crate::scan::{Placement, PoseEdge, PoseGraph, Reconstruction, ScanId};
use nalgebra::{Matrix6, Point3, Vector3, Vector6};
use std::collections::BTreeMap;

/// Deviation of the rotation where no covariance is known, degrees.
const UNKNOWN_ROTATION_DEG: f64 = 5.0;

/// The scans of `component` and the edges between them, in the order of the input; `names[i]` is that of
/// scan `i`. `registered` are the pairs of a global method, where there are any.
pub fn pose_graph_of_component(
    names: &[&str],
    reconstruction: &Reconstruction,
    registered: Option<&PoseGraph>,
    component: usize,
    inlier_radius_m: f64,
) -> PoseGraphFile {
    let outcomes = reconstruction.outcomes.iter().enumerate();
    let placed = outcomes.filter_map(|(scan, outcome)| Some((scan, outcome.placement()?)));
    let members: Vec<(usize, &Placement)> = placed.filter(|(_, p)| p.component == component).collect();
    let node_of: BTreeMap<usize, usize> = members.iter().enumerate().map(|(k, m)| (m.0, k)).collect();
    let mut links = match registered {
        Some(graph) => registered_links(graph, &node_of),
        None => parent_links(&members, &node_of),
    };
    for (j, (_, placement)) in members.iter().enumerate() {
        for i in placement.neighbours.iter().filter_map(|n| node_of.get(&n.scan.0).copied()) {
            if i != j {
                links.entry((i.min(j), i.max(j))).or_insert(Link { i, j, measured: None, uncertain: true });
            }
        }
    }
    let pivot = members.iter().enumerate().min_by_key(|(_, m)| m.1.step).map_or(0, |(k, _)| k);
    let edge = |link: Link| link.edge(members[link.i].1, members[link.j].1, inlier_radius_m);
    PoseGraphFile {
        nodes: members
            .iter()
            .map(|&(scan, placement)| GraphNode {
                id: ScanId(scan),
                name: names.get(scan).map(|n| (*n).to_owned()).unwrap_or_default(),
                world_from_scan: placement.world_from_scan,
            })
            .collect(),
        pivot,
        edges: links.into_values().map(edge).collect(),
    }
}

/// Two nodes that are going to be joined, by the nodes in ascending order: one edge a pair.
type Links = BTreeMap<(usize, usize), Link>;

struct Link {
    i: usize,
    j: usize,
    /// `i_from_j` as measured; the result's where nothing was.
    measured: Option<RigidMotion>,
    uncertain: bool,
}

/// Every scan and its parent.
fn parent_links(members: &[(usize, &Placement)], node_of: &BTreeMap<usize, usize>) -> Links {
    let link = |(j, (_, placement)): (usize, &(usize, &Placement))| {
        let i = *node_of.get(&placement.parent?.0)?;
        let measured = placement.evidence.and_then(|e| e.parent_from_scan);
        (i != j).then_some(((i.min(j), i.max(j)), Link { i, j, measured, uncertain: false }))
    };
    members.iter().enumerate().filter_map(link).collect()
}

/// The registered pairs. Nothing tells which of them are right: a solver may drop any.
fn registered_links(graph: &PoseGraph, node_of: &BTreeMap<usize, usize>) -> Links {
    let link = |e: &PoseEdge| {
        let (i, j) = (*node_of.get(&e.i.0)?, *node_of.get(&e.j.0)?);
        let link = Link { i, j, measured: Some(*e.i_from_j()), uncertain: true };
        (i != j && e.pair.inliers > 0).then_some(((i.min(j), i.max(j)), link))
    };
    graph.edges.iter().filter_map(link).collect()
}

impl Link {
    fn edge(&self, of_i: &Placement, of_j: &Placement, inlier_radius_m: f64) -> GraphEdge {
        let final_pose = of_i.world_from_scan.inverse() * of_j.world_from_scan;
        let i_from_j = self.measured.unwrap_or(final_pose);
        let centre = of_j.pose_uncertainty.as_ref().and_then(|u| u.centre).unwrap_or_else(Point3::origin);
        let error = i_from_j.inverse() * final_pose;
        let displacement = error * centre - centre;
        let e = stacked(&error.rotation.scaled_axis(), &displacement);
        let added = e * e.transpose();
        let inverse = |c: Matrix6<f64>| Some((c + added).cholesky()?.inverse());
        let about_centre = relative_covariance(of_i, of_j)
            .and_then(inverse)
            .or_else(|| inverse(unknown(inlier_radius_m)))
            // An inlier radius of zero tells nothing.
            .unwrap_or_else(Matrix6::zeros);
        // From the centre to the zero of the file's coordinates: the displacement of the centre is
        // t + θ × centre.
        let shift = displaced(&centre.coords);
        let information = shift.transpose() * about_centre * shift;
        let information = (information + information.transpose()) * 0.5;
        GraphEdge { i: self.i, j: self.j, i_from_j, information, uncertain: self.uncertain }
    }
}

/// Covariance of the pose of `j` relative to `i`: of a rotation vector and of the displacement of the
/// centre of `j`, both in the axes of `j`. Each pose is taken to vary independently of the other.
fn relative_covariance(of_i: &Placement, of_j: &Placement) -> Option<Matrix6<f64>> {
    let known = |p: &Placement| {
        let uncertainty = p.pose_uncertainty.as_ref()?;
        let centre = p.world_from_scan * uncertainty.centre?;
        let covariance = uncertainty.covariance?;
        covariance.iter().all(|v| v.is_finite()).then_some((covariance, centre))
    };
    let ((of_i_pose, centre_i), (of_j_pose, centre_j)) = (known(of_i)?, known(of_j)?);
    // How the place where the centre of j lies moves when scan i does.
    let carried = displaced(&(centre_j - centre_i));
    let sum = of_j_pose + carried * of_i_pose * carried.transpose();
    let turn = of_j.world_from_scan.rotation.inverse().to_rotation_matrix().into_inner();
    let mut both = Matrix6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
    both.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
    let turned = both * sum * both.transpose();
    let symmetric = (turned + turned.transpose()) * 0.5;
    symmetric.cholesky().map(|_| symmetric)
}

/// Takes a small motion about a point, `[θ; d]`, to the same motion about one that lies `offset`
/// further: there it displaces by d + θ × offset.
fn displaced(offset: &Vector3<f64>) -> Matrix6<f64> {
    let mut matrix = Matrix6::identity();
    matrix.fixed_view_mut::<3, 3>(3, 0).copy_from(&-offset.cross_matrix());
    matrix
}

fn unknown(inlier_radius_m: f64) -> Matrix6<f64> {
    let rotation = UNKNOWN_ROTATION_DEG.to_radians().powi(2);
    let place = inlier_radius_m.powi(2);
    Matrix6::from_diagonal(&Vector6::new(rotation, rotation, rotation, place, place, place))
}

fn stacked(a: &Vector3<f64>, b: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
}

#[cfg(test)]
mod tests;
