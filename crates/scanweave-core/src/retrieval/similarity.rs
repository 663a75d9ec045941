//! Predicted overlap from global features.

use crate::error::Result;
use crate::monitor::Monitor;
use crate::scan::SimilarityMatrix;
use rayon::prelude::*;

/// Features that a task compares with all others: together they stay in the cache.
pub(super) const ROWS: usize = 16;

/// Squared Euclidean distance: summed in single precision over short stretches, these in double precision.
pub(super) fn squared_distance(a: &[f32], b: &[f32]) -> f64 {
    const LANES: usize = 16;
    const STRETCH: usize = 16 * LANES;
    let stretch = |a: &[f32], b: &[f32]| {
        // As many sums side by side as the processor has lanes.
        let mut sums = [0.0f32; LANES];
        let (mut left, mut right) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
        for (x, y) in left.by_ref().zip(right.by_ref()) {
            for lane in 0..LANES {
                let d = x[lane] - y[lane];
                sums[lane] += d * d;
            }
        }
        let rest = left.remainder().iter().zip(right.remainder()).map(|(x, y)| (x - y) * (x - y));
        f64::from(sums.iter().sum::<f32>() + rest.sum::<f32>())
    };
    a.chunks(STRETCH).zip(b.chunks(STRETCH)).map(|(a, b)| stretch(a, b)).sum()
}

/// s = (2 − ‖g_i − g_j‖) / 2 of two global features (Li et al. 2025): 1 for equal, 0 for opposite
/// ones of unit length.
pub fn similarity(a: &[f32], b: &[f32]) -> f64 {
    0.5 * (2.0 - squared_distance(a, b).sqrt())
}

/// [`similarity`] of all pairs; zero wherever a scan has no feature, and on the diagonal.
///
/// # Errors
/// When a feature is not finite, or the user asked to stop.
pub fn similarity_matrix(features: &[Option<&Vec<f32>>], monitor: &dyn Monitor) -> Result<SimilarityMatrix> {
    const STAGE: &str = "similarity";
    let n = features.len();
    monitor.begin(STAGE, n);
    let mut values = vec![0.0f32; n * n];
    values.par_chunks_mut((ROWS * n).max(1)).enumerate().try_for_each(|(block, rows)| {
        monitor.check(STAGE)?;
        let first = block * ROWS;
        // Below the diagonal; a row of the block at a time would fetch all features as often.
        for j in 0..(first + ROWS).min(n) {
            let Some(b) = features[j] else { continue };
            for (k, row) in rows.chunks_exact_mut(n).enumerate().filter(|(k, _)| first + k > j) {
                if let Some(a) = features[first + k] {
                    row[j] = similarity(a, b) as f32;
                }
            }
        }
        monitor.advance(rows.len() / n.max(1));
        Ok(())
    })?;
    monitor.end();
    for i in 0..n {
        for j in 0..i {
            values[j * n + i] = values[i * n + j];
        }
    }
    SimilarityMatrix::new(n, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::monitor::Silent;

    #[test]
    fn similarity_has_its_closed_form_at_known_angles() {
        let (a, b, c) = (vec![1.0, 0.0], vec![0.0, 1.0], vec![-1.0, 0.0]);
        let s = similarity_matrix(&[Some(&a), Some(&b), Some(&c), None, Some(&a)], &Silent).unwrap();
        assert!((f64::from(s.get(0, 1)) - (1.0 - 0.5f64.sqrt())).abs() < 1e-7);
        assert_eq!(s.get(0, 2), 0.0);
        assert_eq!(s.get(0, 4), 1.0);
        assert_eq!((s.get(0, 0), s.get(0, 3)), (0.0, 0.0));
    }

    #[test]
    fn long_features_in_many_blocks_agree_with_a_plain_sum() {
        let value = |i: usize, k: usize| ((i * 37 + k * 11) % 101) as f32 / 101.0 - 0.5;
        let features: Vec<Vec<f32>> = (0..40).map(|i| (0..777).map(|k| value(i, k)).collect()).collect();
        let some: Vec<Option<&Vec<f32>>> =
            features.iter().enumerate().map(|(i, f)| (i != 7).then_some(f)).collect();
        let found = similarity_matrix(&some, &Silent).unwrap();
        for i in 0..40 {
            for j in 0..40 {
                let squares = (0..777).map(|k| (f64::from(value(i, k)) - f64::from(value(j, k))).powi(2));
                let expected =
                    if i == j || i == 7 || j == 7 { 0.0 } else { 1.0 - 0.5 * squares.sum::<f64>().sqrt() };
                assert!((f64::from(found.get(i, j)) - expected).abs() < 1e-6, "{i} {j}");
            }
        }
    }

    /// Cancels after so many questions.
    struct After(std::sync::atomic::AtomicUsize);

    impl Monitor for After {
        fn cancelled(&self) -> bool {
            let left = |n: usize| Some(n.saturating_sub(1));
            let order = std::sync::atomic::Ordering::SeqCst;
            self.0.fetch_update(order, order, left).unwrap_or(0) == 0
        }
    }

    #[test]
    fn a_comparison_stops_between_blocks() {
        let feature = vec![1.0f32; 4];
        let features = vec![Some(&feature); 20 * ROWS];
        assert!(similarity_matrix(&features, &After(5.into())).is_err());
        assert!(similarity_matrix(&features, &After(21.into())).is_ok());
    }
}
