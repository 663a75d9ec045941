//! How well predicted overlaps find scans that truly overlap.

use super::mean;
pub use crate::evaluation::retrieval_scores::{recall_at, spearman};
use crate::scan::SimilarityMatrix;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// Retrieval scores of one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RetrievalReport {
    /// Cut-offs of `recall_at`.
    pub cutoffs: Vec<usize>,
    /// [`recall_at`] for every cut-off.
    pub recall_at: Vec<Option<f64>>,
    /// Spearman's rank correlation of similarity and overlap over all pairs; `None` where one of
    /// them is constant.
    pub spearman: Option<f64>,
    /// Mean absolute difference of similarity and overlap over all pairs.
    pub mean_absolute_error: Option<f64>,
    /// Truly overlapping pairs.
    pub overlapping_pairs: usize,
}

/// Scores `similarity` against true `overlap`; scans overlap truly above `overlap_above`.
///
/// Equal similarities rank by scan index, as the pipeline breaks ties.
///
/// # Errors
/// When the matrices differ in size.
pub fn retrieval_scores(
    similarity: &SimilarityMatrix,
    overlap: &SimilarityMatrix,
    overlap_above: f32,
    cutoffs: &[usize],
) -> Result<RetrievalReport> {
    let n = similarity.len();
    if overlap.len() != n {
        return Err(Error::input(
            "overlap matrix",
            format!("{} scans", overlap.len()),
            format!("{n} scans, as in the similarity matrix"),
            "compute both from the same set",
        ));
    }
    let (mut predicted, mut actual, mut overlapping_pairs) = (Vec::new(), Vec::new(), 0);
    for i in 0..n {
        for j in i + 1..n {
            predicted.push(f64::from(similarity.get(i, j)));
            actual.push(f64::from(overlap.get(i, j)));
            overlapping_pairs += usize::from(overlap.get(i, j) > overlap_above);
        }
    }
    let differences: Vec<f64> = predicted.iter().zip(&actual).map(|(p, a)| (p - a).abs()).collect();
    Ok(RetrievalReport {
        cutoffs: cutoffs.to_vec(),
        recall_at: cutoffs.iter().map(|&k| recall_at(similarity, overlap, k, overlap_above)).collect(),
        spearman: spearman(&predicted, &actual),
        mean_absolute_error: mean(&differences),
        overlapping_pairs,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spearman_of_known_rankings() {
        // One swap of neighbours in five: 1 − 6·Σd²/(n(n²−1)) = 1 − 6·2/120.
        let rho = spearman(&[1.0, 2.0, 3.0, 4.0, 5.0], &[10.0, 30.0, 20.0, 40.0, 1e9]).unwrap();
        assert!((rho - 0.9).abs() < 1e-12);
        assert!((spearman(&[1.0, 2.0, 3.0], &[3.0, 2.0, 1.0]).unwrap() + 1.0).abs() < 1e-12);
        // Ties share ranks: (0.5, 0.5, 2) against (0, 1, 2) gives 1.5/√(1.5·2).
        let tied = spearman(&[1.0, 1.0, 2.0], &[1.0, 2.0, 3.0]).unwrap();
        assert!((tied - 1.5 / 3.0f64.sqrt()).abs() < 1e-12);
        assert_eq!(spearman(&[1.0, 1.0], &[1.0, 2.0]), None);
        assert_eq!(spearman(&[1.0], &[1.0]), None);
    }

    #[test]
    fn recall_at_k_by_hand() {
        let matrix = |entries: &[(usize, usize, f32)]| {
            let mut v = vec![0.0; 16];
            for &(i, j, x) in entries {
                v[i * 4 + j] = x;
                v[j * 4 + i] = x;
            }
            SimilarityMatrix::new(4, v).unwrap()
        };
        let overlap = matrix(&[(0, 1, 0.5), (0, 2, 0.4)]);
        let similarity = matrix(&[(0, 1, 0.3), (0, 3, 0.9), (0, 2, 0.6), (1, 2, 0.2)]);
        let r = retrieval_scores(&similarity, &overlap, 0.1, &[1, 2, 3]).unwrap();
        // Scan 0 ranks 3, 2, 1: finds 0, ½, 1. Scan 1 ranks 0 first, scan 2 ranks 0 first: 1 always.
        // Scan 3 overlaps nothing and is left out.
        let expected = [2.0 / 3.0, 2.5 / 3.0, 1.0];
        for (found, expected) in r.recall_at.iter().zip(expected) {
            assert!((found.unwrap() - expected).abs() < 1e-12);
        }
        // |0.3−0.5| + |0.6−0.4| + 0.9 + 0.2 over six pairs.
        assert!((r.mean_absolute_error.unwrap() - 1.5 / 6.0).abs() < 1e-6);
        assert_eq!(r.overlapping_pairs, 2);
        let nothing = retrieval_scores(&similarity, &matrix(&[]), 0.1, &[1]).unwrap();
        assert_eq!((nothing.recall_at[0], nothing.spearman), (None, None));
        assert!(
            retrieval_scores(&similarity, &SimilarityMatrix::new(1, vec![0.0]).unwrap(), 0.1, &[1]).is_err()
        );
    }
}
