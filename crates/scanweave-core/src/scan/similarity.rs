//! Predicted overlap between scans.

use crate::error::{Error, Result};

/// Symmetric `[N,N]` matrix of predicted overlap with a zero diagonal.
#[derive(Debug, Clone, PartialEq)]
pub struct SimilarityMatrix {
    n: usize,
    values: Vec<f32>,
}

impl SimilarityMatrix {
    /// Wraps row-major `values` `[n·n]`, symmetrised by the mean, diagonal set to zero.
    ///
    /// # Errors
    /// When the length is not `n²` or a value is not finite.
    pub fn new(n: usize, mut values: Vec<f32>) -> Result<Self> {
        if values.len() != n * n || values.iter().any(|v| !v.is_finite()) {
            return Err(Error::input(
                "similarity matrix",
                format!("{} values", values.len()),
                format!("{} finite values for {n} scans", n * n),
                "compute it again from the features of these scans",
            ));
        }
        for i in 0..n {
            values[i * n + i] = 0.0;
            for j in 0..i {
                let mean = 0.5 * (values[i * n + j] + values[j * n + i]);
                values[i * n + j] = mean;
                values[j * n + i] = mean;
            }
        }
        Ok(Self { n, values })
    }

    /// Number of scans N.
    pub fn len(&self) -> usize {
        self.n
    }

    /// True when there is no scan.
    pub fn is_empty(&self) -> bool {
        self.n == 0
    }

    /// Similarity of scans `i` and `j`.
    pub fn get(&self, i: usize, j: usize) -> f32 {
        self.values[i * self.n + j]
    }

    /// Row `i`, `[N]`.
    pub fn row(&self, i: usize) -> &[f32] {
        &self.values[i * self.n..(i + 1) * self.n]
    }
}
