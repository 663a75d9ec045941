//! Scans in an order of their content, so that the order and the names of files decide nothing.
//!
//! Strategies break ties by the lower scan, orient pairs from the lower to the higher and keep the
//! frame of the lower. A `ScanId` is a label, and what follows from it must not depend on how a
//! user sorts files: inside a registration scans are numbered by the digest of their content.

use super::input::{ContentDigest, ScanInput};
use crate::error::Result;
use crate::scan::{
    DeclineReason, Outcome, PoseEdge, PoseGraph, Reconstruction, ScanEdge, ScanId, SimilarityMatrix,
};
use rayon::prelude::*;

/// The scan of the input at every place of the canonical order.
pub(crate) struct CanonicalOrder(Vec<usize>);

impl CanonicalOrder {
    /// Scans by digest; of equal content in the order of the input.
    pub(crate) fn new(scans: &[ScanInput<'_>]) -> Self {
        let digests: Vec<ContentDigest> = scans.par_iter().map(ContentDigest::of).collect();
        let mut order: Vec<usize> = (0..scans.len()).collect();
        order.sort_by_key(|&i| digests[i]);
        Self(order)
    }

    /// Scans in this order.
    pub(crate) fn scans<'a>(&self, scans: &[ScanInput<'a>]) -> Vec<ScanInput<'a>> {
        self.0.iter().map(|&i| scans[i]).collect()
    }

    /// Rows and columns in this order.
    ///
    /// # Errors
    /// None for a matrix that is one already.
    pub(crate) fn similarity(&self, similarity: &SimilarityMatrix) -> Result<SimilarityMatrix> {
        let values = self.0.iter().flat_map(|&i| self.0.iter().map(move |&j| similarity.get(i, j)));
        SimilarityMatrix::new(self.0.len(), values.collect())
    }

    /// A pose graph in the order of the input.
    pub(crate) fn restore_graph(&self, canonical: PoseGraph) -> PoseGraph {
        let mut edges: Vec<PoseEdge> = canonical
            .edges
            .iter()
            .map(|edge| {
                let (i, j) = (ScanId(self.0[edge.i.0]), ScanId(self.0[edge.j.0]));
                let turned = j < i;
                let pair = if turned { edge.pair.reversed() } else { edge.pair };
                PoseEdge { i: i.min(j), j: i.max(j), pair, ..*edge }
            })
            .collect();
        edges.sort_by_key(|edge| (edge.i, edge.j));
        let mut reasons: Vec<(usize, DeclineReason)> =
            self.0.iter().copied().zip(canonical.without_edges.iter().cloned()).collect();
        reasons.sort_by_key(|(scan, _)| *scan);
        let without_edges = reasons.into_iter().map(|(_, reason)| reason).collect();
        PoseGraph { edges, without_edges, ..canonical }
    }

    /// A result in the order of the input.
    pub(crate) fn restore(&self, canonical: Reconstruction) -> Reconstruction {
        let named = |scan: ScanId| ScanId(self.0[scan.0]);
        let mut outcomes: Vec<(usize, Outcome)> = self.0.iter().copied().zip(canonical.outcomes).collect();
        for (_, outcome) in &mut outcomes {
            let Outcome::Placed(placement) = outcome else { continue };
            placement.parent = placement.parent.map(named);
            placement.neighbours.iter_mut().for_each(|n| n.scan = named(n.scan));
            placement.neighbours.sort_by_key(|n| n.scan);
            if let Some(edge) = placement.pose_uncertainty.as_mut().and_then(|u| u.weakest_edge.as_mut()) {
                let (a, b) = (named(edge.scans.0), named(edge.scans.1));
                *edge = ScanEdge { scans: (a.min(b), a.max(b)), ..*edge };
            }
        }
        outcomes.sort_by_key(|(scan, _)| *scan);
        Reconstruction { outcomes: outcomes.into_iter().map(|(_, outcome)| outcome).collect() }
    }
}
