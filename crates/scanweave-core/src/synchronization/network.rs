//! A connected part of a pose graph, its scans renumbered from zero.

use crate::geometry::RigidMotion;
use crate::scan::{PoseGraph, ScanId};
use std::collections::BTreeMap;

/// An edge between two nodes; in a network, `i < j`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Link {
    pub i: usize,
    pub j: usize,
    pub i_from_j: RigidMotion,
    pub inliers: usize,
    pub similarity: f64,
}

impl Link {
    /// The node at the other end.
    pub fn other(&self, node: usize) -> usize {
        self.i + self.j - node
    }

    /// Pose of the end that is not `known`, from the pose of the end that is.
    pub fn carry(&self, known: usize, world_from_known: &RigidMotion) -> RigidMotion {
        if known == self.i {
            world_from_known * self.i_from_j
        } else {
            world_from_known * self.i_from_j.inverse()
        }
    }

    /// The same link seen from its other end.
    pub fn turned(&self) -> Self {
        Self { i: self.j, j: self.i, i_from_j: self.i_from_j.inverse(), ..*self }
    }

    /// What is left of the motion around the edge at these poses: identity where they agree.
    pub fn error(&self, poses: &[RigidMotion]) -> RigidMotion {
        self.i_from_j.inverse() * poses[self.i].inverse() * poses[self.j]
    }
}

/// A connected graph of nodes `0..n`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Network {
    pub n: usize,
    /// Ordered by `(i, j)`.
    pub links: Vec<Link>,
    /// The node whose links have most inliers.
    pub pivot: usize,
    /// τ, metres.
    pub inlier_radius_m: f64,
}

impl Network {
    /// The same nodes with only some links.
    pub fn with_links(&self, keep: impl Fn(usize, &Link) -> bool) -> Self {
        let kept = self.links.iter().enumerate().filter(|(at, link)| keep(*at, link));
        Self { links: kept.map(|(_, link)| *link).collect(), ..*self }
    }

    /// For every node, its neighbours and the links to them, by neighbour.
    pub fn adjacency(&self) -> Vec<BTreeMap<usize, usize>> {
        let mut adjacency = vec![BTreeMap::new(); self.n];
        for (at, link) in self.links.iter().enumerate() {
            adjacency[link.i].insert(link.j, at);
            adjacency[link.j].insert(link.i, at);
        }
        adjacency
    }

    /// The tree of most inliers from the pivot (Prim): nodes in the order they join, each with
    /// the link it joins by; the pivot is left out. Ties go to the earlier link.
    pub fn strongest_tree(&self) -> Vec<(usize, usize)> {
        let mut joined = vec![false; self.n];
        joined[self.pivot] = true;
        let mut tree = Vec::with_capacity(self.n);
        let adjacency = self.adjacency();
        // Links from the tree outwards, strongest first.
        let mut frontier: std::collections::BTreeSet<(std::cmp::Reverse<usize>, usize)> = Default::default();
        let reach = |node: usize, frontier: &mut std::collections::BTreeSet<_>| {
            for &link in adjacency[node].values() {
                frontier.insert((std::cmp::Reverse(self.links[link].inliers), link));
            }
        };
        reach(self.pivot, &mut frontier);
        while let Some((_, link)) = frontier.pop_first() {
            let Link { i, j, .. } = self.links[link];
            let node = if joined[i] { j } else { i };
            if !joined[node] {
                joined[node] = true;
                tree.push((node, link));
                reach(node, &mut frontier);
            }
        }
        tree
    }

    /// Poses along the strongest tree, in the frame of the pivot.
    pub fn tree_poses(&self) -> Vec<RigidMotion> {
        let mut poses = vec![RigidMotion::identity(); self.n];
        for (node, link) in self.strongest_tree() {
            let link = &self.links[link];
            let known = link.other(node);
            poses[node] = link.carry(known, &poses[known]);
        }
        poses
    }
}

/// A connected part of a pose graph.
#[derive(Debug)]
pub(super) struct Component {
    /// Scan of every node, ascending.
    pub scans: Vec<ScanId>,
    /// Edge of the pose graph behind every link.
    pub edges: Vec<usize>,
    pub network: Network,
}

/// The connected parts of two or more scans: largest first, then by their first scan.
pub(super) fn components(graph: &PoseGraph) -> Vec<Component> {
    // Union-find; the root of a set is its lowest scan.
    let mut root: Vec<usize> = (0..graph.scans).collect();
    fn find(root: &mut [usize], mut scan: usize) -> usize {
        while root[scan] != scan {
            root[scan] = root[root[scan]];
            scan = root[scan];
        }
        scan
    }
    for edge in &graph.edges {
        let (a, b) = (find(&mut root, edge.i.0), find(&mut root, edge.j.0));
        root[a.max(b)] = a.min(b);
    }
    let mut sets: BTreeMap<usize, Vec<ScanId>> = BTreeMap::new();
    for scan in 0..graph.scans {
        sets.entry(find(&mut root, scan)).or_default().push(ScanId(scan));
    }
    let mut sets: Vec<Vec<ScanId>> = sets.into_values().filter(|s| s.len() > 1).collect();
    sets.sort_by_key(|s| (std::cmp::Reverse(s.len()), s[0]));
    sets.into_iter().map(|scans| component(graph, scans)).collect()
}

fn component(graph: &PoseGraph, scans: Vec<ScanId>) -> Component {
    let place = |scan: ScanId| scans.binary_search(&scan).ok();
    let mut links: Vec<(Link, usize)> = graph
        .edges
        .iter()
        .enumerate()
        .filter_map(|(at, edge)| {
            let edge = if edge.i < edge.j { *edge } else { edge.reversed() };
            let (i, j) = (place(edge.i)?, place(edge.j)?);
            let link = Link {
                i,
                j,
                i_from_j: *edge.i_from_j(),
                inliers: edge.pair.inliers,
                similarity: edge.similarity,
            };
            Some((link, at))
        })
        .collect();
    links.sort_by_key(|(link, _)| (link.i, link.j));
    let (links, edges): (Vec<Link>, Vec<usize>) = links.into_iter().unzip();
    let mut inliers = vec![0usize; scans.len()];
    for link in &links {
        inliers[link.i] += link.inliers;
        inliers[link.j] += link.inliers;
    }
    let pivot = (0..scans.len()).rev().max_by_key(|&node| inliers[node]).unwrap_or(0);
    let network = Network { n: scans.len(), links, pivot, inlier_radius_m: graph.inlier_radius_m };
    Component { scans, edges, network }
}
