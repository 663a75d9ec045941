//! Predicted overlap from global features.

use crate::error::Result;
use crate::scan::SimilarityMatrix;

/// Squared Euclidean distance, accumulated in double precision.
pub(super) fn squared_distance(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2)).sum()
}

/// s = (2 − ‖g_i − g_j‖) / 2 of two global features (Li et al. 2025): 1 for equal, 0 for opposite
/// ones of unit length.
pub fn similarity(a: &[f32], b: &[f32]) -> f64 {
    0.5 * (2.0 - squared_distance(a, b).sqrt())
}

/// [`similarity`] of all pairs; zero wherever a scan has no feature, and on the diagonal.
///
/// # Errors
/// When a feature is not finite.
pub fn similarity_matrix(features: &[Option<&Vec<f32>>]) -> Result<SimilarityMatrix> {
    let n = features.len();
    let mut values = vec![0.0f32; n * n];
    for i in 0..n {
        for j in 0..i {
            if let (Some(a), Some(b)) = (features[i], features[j]) {
                let s = similarity(a, b) as f32;
                values[i * n + j] = s;
                values[j * n + i] = s;
            }
        }
    }
    SimilarityMatrix::new(n, values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn similarity_has_its_closed_form_at_known_angles() {
        let (a, b, c) = (vec![1.0, 0.0], vec![0.0, 1.0], vec![-1.0, 0.0]);
        let s = similarity_matrix(&[Some(&a), Some(&b), Some(&c), None, Some(&a)]).unwrap();
        assert!((f64::from(s.get(0, 1)) - (1.0 - 0.5f64.sqrt())).abs() < 1e-7);
        assert_eq!(s.get(0, 2), 0.0);
        assert_eq!(s.get(0, 4), 1.0);
        assert_eq!((s.get(0, 0), s.get(0, 3)), (0.0, 0.0));
    }
}
