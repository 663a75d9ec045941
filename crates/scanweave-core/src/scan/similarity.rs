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
    pub fn new(n: usize, values: Vec<f32>) -> Result<Self> {
        Self::mirrored(n, values, |below, above| 0.5 * (below + above))
    }

    /// Wraps the values below the diagonal of row-major `values` `[n·n]`; what stands elsewhere is finite.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn of_lower(n: usize, values: Vec<f32>) -> Result<Self> {
        Self::mirrored(n, values, |below, _| below)
    }

    /// What stands on both sides of the diagonal is made of what stands below and above it.
    fn mirrored(n: usize, mut values: Vec<f32>, both: impl Fn(f32, f32) -> f32) -> Result<Self> {
        /// Rows and columns of the tiles that are gone through: a column alone would fetch a line of the cache a value.
        const TILE: usize = 64;
        if values.len() != n * n || values.iter().any(|v| !v.is_finite()) {
            return Err(Error::input(
                "similarity matrix",
                format!("{} values", values.len()),
                format!("{} finite values for {n} scans", n * n),
                "compute it again from the features of these scans",
            ));
        }
        for top in (0..n).step_by(TILE) {
            for left in (0..=top).step_by(TILE) {
                for i in top..n.min(top + TILE) {
                    for j in left..i.min(left + TILE) {
                        let value = both(values[i * n + j], values[j * n + i]);
                        (values[i * n + j], values[j * n + i]) = (value, value);
                    }
                }
            }
        }
        (0..n).for_each(|i| values[i * n + i] = 0.0);
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
