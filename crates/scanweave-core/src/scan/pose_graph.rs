//! Scans joined by pairwise registrations.

use super::{DeclineReason, ScanId};
use crate::geometry::RigidMotion;

/// The content of two scans' features, the same whatever the scans are called.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct PairKey {
    /// Content of the scan whose frame is the target.
    pub target: [u8; 16],
    /// Content of the other.
    pub source: [u8; 16],
}

/// What registering two scans with each other gave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairRegistration {
    /// Takes coordinates of the source to those of the target; identity where `inliers` is zero.
    pub target_from_source: RigidMotion,
    /// Mutual descriptor matches.
    pub matches: usize,
    /// Matches within τ under the motion; zero where no motion was found.
    pub inliers: usize,
    /// Root mean square distance of the inlier matches, metres.
    pub residual_m: f64,
    /// Two-way share of keypoints with a counterpart within τ, in `[0, 1]`.
    pub overlap: f64,
    /// Median distance between counterparts over the registered overlap, metres; infinite
    /// where the scans do not overlap.
    pub median_distance_m: f64,
}

impl Default for PairRegistration {
    /// No motion found.
    fn default() -> Self {
        Self {
            target_from_source: RigidMotion::identity(),
            matches: 0,
            inliers: 0,
            residual_m: 0.0,
            overlap: 0.0,
            median_distance_m: f64::INFINITY,
        }
    }
}

impl PairRegistration {
    /// The same registration seen from the other scan.
    pub fn reversed(&self) -> Self {
        Self { target_from_source: self.target_from_source.inverse(), ..*self }
    }
}

/// An edge of a pose graph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseEdge {
    /// The scan whose frame is the target.
    pub i: ScanId,
    /// The scan whose frame is the source.
    pub j: ScanId,
    /// Its registration.
    pub pair: PairRegistration,
    /// Predicted overlap of the two scans.
    pub similarity: f64,
}

impl PoseEdge {
    /// Takes coordinates of `j` to coordinates of `i`.
    pub fn i_from_j(&self) -> &RigidMotion {
        &self.pair.target_from_source
    }

    /// The same registration seen from the other scan.
    pub fn reversed(&self) -> Self {
        Self { i: self.j, j: self.i, pair: self.pair.reversed(), ..*self }
    }
}

/// Scans and the pairwise registrations between them.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseGraph {
    /// Number of scans; edges name scans below it.
    pub scans: usize,
    /// τ the pairs were registered with, metres.
    pub inlier_radius_m: f64,
    /// At most one edge a pair.
    pub edges: Vec<PoseEdge>,
    /// Why a scan is without edges; read only where it is.
    pub without_edges: Vec<DeclineReason>,
    /// Pairs that were registered to make this graph, this time or before.
    pub registered_pairs: usize,
    /// What they took, seconds of wall-clock time when they were registered.
    pub registration_seconds: f64,
    /// The part of it that belongs to pairs registered before.
    pub reused_seconds: f64,
}
