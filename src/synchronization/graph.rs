//! Which pairs of scans are registered and which become edges.

use super::config::{GraphKind, SynchronizationConfig};
use crate::scan::{PairRegistration, ScanId, SimilarityMatrix};

/// Pairs `(i, j)`, i < j, that a graph of this kind needs registered, in order.
///
/// Full and pruned graphs need all; the sparse one the union of every scan's `neighbours`
/// most similar scans (ties go to the lower index).
pub fn pairs(similarity: &SimilarityMatrix, config: &SynchronizationConfig) -> Vec<(ScanId, ScanId)> {
    let n = similarity.len();
    let all = (0..n).flat_map(|i| (i + 1..n).map(move |j| (ScanId(i), ScanId(j))));
    if config.graph != GraphKind::Sparse {
        return all.collect();
    }
    let mut chosen: Vec<(ScanId, ScanId)> = Vec::new();
    for i in 0..n {
        let mut others: Vec<usize> = (0..n).filter(|&j| j != i).collect();
        others.sort_by(|&a, &b| similarity.get(i, b).total_cmp(&similarity.get(i, a)).then(a.cmp(&b)));
        chosen
            .extend(others.into_iter().take(config.neighbours).map(|j| (ScanId(i.min(j)), ScanId(i.max(j)))));
    }
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

/// Whether a registered pair becomes an edge.
pub fn keeps(
    pair: &PairRegistration,
    config: &SynchronizationConfig,
    min_inliers: usize,
    inlier_radius_m: f64,
) -> bool {
    pair.inliers >= min_inliers
        && (config.graph != GraphKind::Pruned
            || pair.median_distance_m < config.max_median_distance * inlier_radius_m)
}
