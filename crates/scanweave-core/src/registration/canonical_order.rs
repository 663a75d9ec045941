//! Scans in an order of their content, so that the order and the names of files decide nothing.
//!
//! Strategies break ties by the lower scan, orient pairs from the lower to the higher and keep the
//! frame of the lower. A `ScanId` is a label, and what follows from it must not depend on how a
//! user sorts files. Nor may it depend on the coordinates of a file: inside a registration scans are
//! numbered by their size, which a rigid motion does not change, and only of exactly equal size by
//! the digest of their content.

use super::input::{ContentDigest, ScanInput};
use crate::error::Result;
use crate::scan::{
    DeclineReason, Outcome, PoseEdge, PoseGraph, Reconstruction, ScanEdge, ScanId, SimilarityMatrix,
};
use nalgebra::Vector3;
use rayon::prelude::*;

/// The scan of the input at every place of the canonical order.
pub(crate) struct CanonicalOrder(Vec<usize>);

impl CanonicalOrder {
    /// Scans by size, the smallest first; of equal content in the order of the input.
    pub(crate) fn new(scans: &[ScanInput<'_>]) -> Self {
        let keys: Vec<(f64, ContentDigest)> =
            scans.par_iter().map(|scan| (size(scan), ContentDigest::of(scan))).collect();
        let mut order: Vec<usize> = (0..scans.len()).collect();
        order.sort_by(|&i, &j| keys[i].0.total_cmp(&keys[j].0).then(keys[i].1.cmp(&keys[j].1)));
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
        let n = self.0.len();
        // At its full size from the start: of thousands of scans it is among the largest things there are.
        let mut values = vec![0.0; n * n];
        values.par_chunks_mut(n.max(1)).zip(&self.0).for_each(|(row, &i)| {
            let of_i = similarity.row(i);
            row.iter_mut().zip(&self.0).for_each(|(value, &j)| *value = of_i[j]);
        });
        SimilarityMatrix::new(n, values)
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

/// Root mean square distance of a scan's surface, or else its keypoints, from their mean, metres.
fn size(scan: &ScanInput<'_>) -> f64 {
    let points = if scan.surface.is_empty() { &scan.features.keypoints } else { &scan.surface.points };
    let n = points.len().max(1) as f64;
    let mean = points.iter().map(|p| p.coords.cast::<f64>()).sum::<Vector3<f64>>() / n;
    (points.iter().map(|p| (p.coords.cast::<f64>() - mean).norm_squared()).sum::<f64>() / n).sqrt()
}
