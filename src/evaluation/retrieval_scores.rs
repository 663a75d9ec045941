//! How well predicted similarity agrees with true overlap.

use crate::scan::SimilarityMatrix;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// Agreement of predicted similarity with true overlap in one scene, or averaged over scenes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct RetrievalScores {
    /// Mean absolute difference over all pairs.
    pub mae: f64,
    /// Spearman rank correlation over all pairs, ties sharing their mean rank; 0 where either
    /// side is constant.
    pub spearman: f64,
    /// Recall of scans with overlap above 0.3, see [`recall_at`]; 1 when there is none to find.
    pub recall_overlap_30: f64,
    /// Recall of scans with overlap above 0.1, see [`recall_at`]; 1 when there is none to find.
    pub recall_overlap_10: f64,
}

impl RetrievalScores {
    /// Scores of one scene, with recall at `k`.
    ///
    /// # Errors
    /// When the matrices are of different size.
    pub fn of(similarity: &SimilarityMatrix, overlap: &SimilarityMatrix, k: usize) -> Result<Self> {
        let n = overlap.len();
        if similarity.len() != n {
            return Err(Error::input(
                "similarity matrix",
                format!("{} scans", similarity.len()),
                format!("{n} as in the overlap matrix"),
                "compute both from the same scans",
            ));
        }
        let pairs = || (0..n).flat_map(|i| (0..i).map(move |j| (i, j)));
        let predicted: Vec<f64> = pairs().map(|(i, j)| f64::from(similarity.get(i, j))).collect();
        let truth: Vec<f64> = pairs().map(|(i, j)| f64::from(overlap.get(i, j))).collect();
        let gap: f64 = predicted.iter().zip(&truth).map(|(p, t)| (p - t).abs()).sum();
        Ok(Self {
            mae: gap / predicted.len().max(1) as f64,
            spearman: spearman(&predicted, &truth).unwrap_or(0.0),
            recall_overlap_30: recall_at(similarity, overlap, k, 0.3).unwrap_or(1.0),
            recall_overlap_10: recall_at(similarity, overlap, k, 0.1).unwrap_or(1.0),
        })
    }

    /// Mean over scenes.
    pub fn mean(scenes: &[Self]) -> Self {
        let over = |get: fn(&Self) -> f64| scenes.iter().map(get).sum::<f64>() / scenes.len().max(1) as f64;
        Self {
            mae: over(|s| s.mae),
            spearman: over(|s| s.spearman),
            recall_overlap_30: over(|s| s.recall_overlap_30),
            recall_overlap_10: over(|s| s.recall_overlap_10),
        }
    }
}

/// Recall at `k`: the share of the scans overlapping scan i by more than `above` that are among the
/// k most similar to i; mean over all i that have such scans, `None` when none has. Ties in
/// similarity go to the lower index, as in the incremental strategy. Where more than k scans overlap
/// i, even the true order stays below 1.
pub fn recall_at(
    similarity: &SimilarityMatrix,
    overlap: &SimilarityMatrix,
    k: usize,
    above: f32,
) -> Option<f64> {
    let n = overlap.len();
    let (mut sum, mut counted) = (0.0, 0usize);
    for i in 0..n {
        let mut others: Vec<usize> = (0..n).filter(|&j| j != i).collect();
        let overlapping = |j: &&usize| overlap.get(i, **j) > above;
        let all = others.iter().filter(overlapping).count();
        if all == 0 {
            continue;
        }
        others.sort_by(|&a, &b| similarity.get(i, b).total_cmp(&similarity.get(i, a)).then(a.cmp(&b)));
        let hits = others.iter().take(k).filter(overlapping).count();
        sum += hits as f64 / all as f64;
        counted += 1;
    }
    (counted > 0).then(|| sum / counted as f64)
}

/// Spearman's rank correlation: Pearson's of the ranks, equal values sharing their mean rank.
/// `None` when the lengths differ, there are fewer than two values, or one side is constant.
pub fn spearman(a: &[f64], b: &[f64]) -> Option<f64> {
    if a.len() != b.len() || a.len() < 2 {
        return None;
    }
    let (ra, rb) = (ranks(a), ranks(b));
    // Ranks 0..n−1 sum up to n(n−1)/2 with or without ties.
    let middle = 0.5 * (a.len() as f64 - 1.0);
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - middle) * (y - middle)).sum::<f64>();
    let scale = (dot(&ra, &ra) * dot(&rb, &rb)).sqrt();
    (scale > 0.0).then(|| dot(&ra, &rb) / scale)
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let mut ranks = vec![0.0; values.len()];
    let mut start = 0;
    while start < order.len() {
        let same = |&&i: &&usize| values[i] == values[order[start]];
        let count = order[start..].iter().take_while(same).count();
        let rank = start as f64 + (count as f64 - 1.0) / 2.0;
        order[start..start + count].iter().for_each(|&i| ranks[i] = rank);
        start += count;
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(upper: [f32; 6]) -> SimilarityMatrix {
        let mut values = vec![0.0; 16];
        let mut next = upper.iter();
        for i in 0..4 {
            for j in i + 1..4 {
                let v = *next.next().unwrap();
                values[i * 4 + j] = v;
                values[j * 4 + i] = v;
            }
        }
        SimilarityMatrix::new(4, values).unwrap()
    }

    #[test]
    fn spearman_matches_known_values() {
        // With ties, by scipy.stats.spearmanr([1,2,2,4],[1,3,2,4]) = 0.9486832980505138.
        assert!(
            (spearman(&[1.0, 2.0, 2.0, 4.0], &[1.0, 3.0, 2.0, 4.0]).unwrap() - 0.948_683_298_050_513_8).abs()
                < 1e-12
        );
        assert!((spearman(&[1.0, 5.0, 9.0], &[3.0, 2.0, 1.0]).unwrap() + 1.0).abs() < 1e-12);
        assert_eq!(spearman(&[1.0, 1.0], &[1.0, 2.0]), None);
    }

    #[test]
    fn recall_is_the_share_of_overlapping_scans_that_is_found() {
        let overlap = matrix([0.5, 0.4, 0.0, 0.2, 0.0, 0.0]);
        let similarity = matrix([0.9, 0.1, 0.2, 0.3, 0.0, 0.0]);
        let close = |found: Option<f64>, expected: f64| (found.unwrap() - expected).abs() < 1e-12;
        // By hand at k = 1, above 0.3: scan 0 has {1,2} and finds one of the two; 1 has {0} and
        // finds it; 2 has {0} and its most similar is 1: missed; 3 has none and is left out.
        assert!(close(recall_at(&similarity, &overlap, 1, 0.3), 1.5 / 3.0));
        // At k = 2 scan 0 finds 1 of 2 (its second is 3), the others all.
        assert!(close(recall_at(&similarity, &overlap, 2, 0.3), 2.5 / 3.0));
        assert!(close(recall_at(&similarity, &overlap, 3, 0.3), 1.0));
        assert_eq!(recall_at(&similarity, &overlap, 2, 0.9), None);
        let scores = RetrievalScores::of(&similarity, &overlap, 1).unwrap();
        assert!((scores.mae - (0.4 + 0.3 + 0.2 + 0.1) / 6.0).abs() < 1e-7);
    }
}
