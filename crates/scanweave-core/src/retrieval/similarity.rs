//! Predicted overlap from global features.

use crate::error::Result;
use crate::monitor::Monitor;
use crate::scan::SimilarityMatrix;
use rayon::prelude::*;

/// Features that a task compares with all others: together they stay in the cache.
pub(super) const ROWS: usize = 16;

/// Values of one feature that are summed side by side: as many as the widest processors have lanes.
const LANES: usize = 16;
/// Values that are summed in single precision.
const STRETCH: usize = 16 * LANES;

/// Squared Euclidean distance: summed in single precision over short stretches, these in double precision.
#[inline(always)]
pub(super) fn squared_distance(a: &[f32], b: &[f32]) -> f64 {
    let mut squared = 0.0;
    for (a, b) in a.chunks(STRETCH).zip(b.chunks(STRETCH)) {
        let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
        let mut sums = [0.0f32; LANES];
        for (a, b) in a.iter().zip(b) {
            for lane in 0..LANES {
                let d = a[lane] - b[lane];
                sums[lane] += d * d;
            }
        }
        let mut rest = 0.0;
        for (x, y) in a_rest.iter().zip(b_rest) {
            rest += (x - y) * (x - y);
        }
        squared += f64::from(sums.iter().sum::<f32>() + rest);
    }
    squared
}

/// [`squared_distance`] of features from another one, to the last bit, by the widest instructions that the
/// processor has.
pub(super) fn squared_distances(own: &[&[f32]], other: &[f32]) -> Vec<f64> {
    let mut squared = Vec::with_capacity(own.len());
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            // A loop: a closure in here would be compiled for any processor.
            for own in own {
                squared.push(squared_distance(own, other));
            }
        },
    );
    squared
}

/// s = (2 − ‖g_i − g_j‖) / 2 of two global features (Li et al. 2025): 1 for equal, 0 for opposite
/// ones of unit length.
pub fn similarity(a: &[f32], b: &[f32]) -> f64 {
    of_squared(squared_distance(a, b))
}

fn of_squared(squared: f64) -> f64 {
    0.5 * (2.0 - squared.sqrt())
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
            let below = first.max(j + 1)..(first + ROWS).min(n);
            let (at, own): (Vec<usize>, Vec<&[f32]>) =
                below.filter_map(|i| Some((i - first, features[i]?.as_slice()))).unzip();
            for (k, squared) in at.into_iter().zip(squared_distances(&own, b)) {
                rows[k * n + j] = of_squared(squared) as f32;
            }
        }
        monitor.advance(rows.len() / n.max(1));
        Ok(())
    })?;
    monitor.end();
    SimilarityMatrix::of_lower(n, values)
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

    #[test]
    fn distances_of_several_at_a_time_are_those_of_each_to_the_last_bit() {
        let value = |i: usize, k: usize| ((i * 37 + k * 11) % 101) as f32 / 101.0 - 0.5;
        // Shorter than a chunk, a stretch and a bit, whole stretches.
        for len in [0, 3, 16, 256, 300, 512, 777] {
            let features: Vec<Vec<f32>> = (0..7).map(|i| (0..len).map(|k| value(i, k)).collect()).collect();
            let own: Vec<&[f32]> = features.iter().map(Vec::as_slice).collect();
            let each: Vec<f64> = own.iter().map(|a| plain(a, own[3])).collect();
            assert_eq!(squared_distances(&own, own[3]), each, "{len}");
            assert_eq!(own.iter().map(|a| squared_distance(a, own[3])).collect::<Vec<_>>(), each, "{len}");
        }
    }

    /// The sum as it was first written: results must stay what they were.
    fn plain(a: &[f32], b: &[f32]) -> f64 {
        let stretch = |a: &[f32], b: &[f32]| {
            let mut sums = [0.0f32; 16];
            let (mut left, mut right) = (a.chunks_exact(16), b.chunks_exact(16));
            for (x, y) in left.by_ref().zip(right.by_ref()) {
                (0..16).for_each(|lane| sums[lane] += (x[lane] - y[lane]) * (x[lane] - y[lane]));
            }
            let rest = left.remainder().iter().zip(right.remainder()).map(|(x, y)| (x - y) * (x - y));
            f64::from(sums.iter().sum::<f32>() + rest.sum::<f32>())
        };
        a.chunks(256).zip(b.chunks(256)).map(|(a, b)| stretch(a, b)).sum::<f64>() + 0.0
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
