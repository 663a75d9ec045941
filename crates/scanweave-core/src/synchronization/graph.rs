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

#[cfg(test)]
mod tests {
    use super::*;

    fn config(graph: GraphKind, neighbours: usize) -> SynchronizationConfig {
        SynchronizationConfig { graph, neighbours, ..SynchronizationConfig::default() }
    }

    fn named(pairs: Vec<(ScanId, ScanId)>) -> Vec<(usize, usize)> {
        pairs.into_iter().map(|(i, j)| (i.0, j.0)).collect()
    }

    #[test]
    fn the_sparse_graph_is_the_union_of_everyones_choice() {
        // 0 and 1 choose each other, 2 chooses 1, 3 ties between 0 and 2 and takes the lower.
        let values = [[0.0, 0.9, 0.1, 0.3], [0.9, 0.0, 0.5, 0.2], [0.1, 0.5, 0.0, 0.3], [0.3, 0.2, 0.3, 0.0]];
        let similarity = SimilarityMatrix::new(4, values.concat()).unwrap();
        let sparse = |k| named(pairs(&similarity, &config(GraphKind::Sparse, k)));
        assert_eq!(sparse(1), [(0, 1), (0, 3), (1, 2)]);
        assert_eq!(sparse(9), named(pairs(&similarity, &config(GraphKind::Full, 1))));
        assert_eq!(pairs(&similarity, &config(GraphKind::Pruned, 1)).len(), 6);
    }

    #[test]
    fn only_the_pruned_graph_asks_how_far_the_surfaces_are_apart() {
        let pair = |inliers, median_distance_m| PairRegistration {
            inliers,
            median_distance_m,
            ..PairRegistration::default()
        };
        let pruned = config(GraphKind::Pruned, 10);
        // 0.05 m at τ = 0.07 m, as published.
        assert!(keeps(&pair(6, 0.0499), &pruned, 6, 0.07));
        assert!(!keeps(&pair(6, 0.0501), &pruned, 6, 0.07));
        assert!(!keeps(&pair(5, 0.01), &pruned, 6, 0.07));
        assert!(keeps(&pair(6, f64::INFINITY), &config(GraphKind::Full, 10), 6, 0.07));
    }
}
