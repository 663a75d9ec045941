//! Fusing global features with their nearest neighbours.

use super::similarity::{ROWS, squared_distances};
use crate::error::Result;
use crate::monitor::Monitor;
use rayon::prelude::*;

/// g_i = (g̃_i + Σ_{j∈M_i} β (g̃_j·g̃_i) g̃_j) / (1 + Σ_{j∈M_i} β (g̃_j·g̃_i)).
///
/// M_i are the `neighbours` nearest other features of i (ties to the lower index). Li et al. 2025
/// print g̃_i inside the first sum, which would make the step the identity; the published code has
/// g̃_j. Inference only; the result is not scaled to unit length again.
///
/// Where the denominator is not positive (all neighbours nearly opposite), the feature stays as it is.
///
/// # Shapes
/// - features N × `[F]`, unit length → N × `[F]`
///
/// # Errors
/// Only when the user asked to stop.
pub fn fuse(
    features: &[Vec<f32>],
    neighbours: usize,
    beta: f64,
    monitor: &dyn Monitor,
) -> Result<Vec<Vec<f32>>> {
    const STAGE: &str = "fusing features";
    monitor.begin(STAGE, features.len());
    let block = |(block, own): (usize, &[Vec<f32>])| {
        monitor.check(STAGE)?;
        let first = block * ROWS;
        let mut nearest = vec![Vec::with_capacity(neighbours + 1); own.len()];
        let rows: Vec<&[f32]> = own.iter().map(Vec::as_slice).collect();
        for (j, other) in features.iter().enumerate().filter(|_| neighbours > 0) {
            for (k, squared) in squared_distances(&rows, other).into_iter().enumerate() {
                if first + k != j {
                    offer(&mut nearest[k], (squared, j), neighbours);
                }
            }
        }
        monitor.advance(own.len());
        Ok(own.iter().zip(nearest).map(|(own, nearest)| fuse_one(features, own, &nearest, beta)).collect())
    };
    let fused: Vec<Vec<Vec<f32>>> =
        features.par_chunks(ROWS).enumerate().map(block).collect::<Result<_>>()?;
    monitor.end();
    Ok(fused.into_iter().flatten().collect())
}

/// Keeps the `most` nearest, the nearest first, of equal ones the lower index.
fn offer(nearest: &mut Vec<(f64, usize)>, new: (f64, usize), most: usize) {
    let before = |a: &(f64, usize)| a.0.total_cmp(&new.0).then(a.1.cmp(&new.1)).is_lt();
    let at = nearest.partition_point(before);
    if at < most {
        nearest.insert(at, new);
        nearest.truncate(most);
    }
}

/// The feature `own` with its nearest others.
fn fuse_one(features: &[Vec<f32>], own: &[f32], nearest: &[(f64, usize)], beta: f64) -> Vec<f32> {
    let mut sum: Vec<f64> = own.iter().map(|&v| f64::from(v)).collect();
    let mut total = 1.0;
    for &(_, j) in nearest {
        let product: f64 = own.iter().zip(&features[j]).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
        let weight = beta * product;
        total += weight;
        sum.iter_mut().zip(&features[j]).for_each(|(s, v)| *s += weight * f64::from(*v));
    }
    if total <= 0.0 {
        return own.to_vec();
    }
    sum.into_iter().map(|s| (s / total) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::monitor::Silent;

    #[test]
    fn the_nearest_neighbours_pull_by_their_product() {
        let features = vec![vec![1.0, 0.0], vec![0.6, 0.8], vec![0.0, 1.0]];
        // By hand, one neighbour, beta 0.5: (g0 + 0.3 g1)/1.3; g1's nearest is g2 (product 0.8).
        let fused = fuse(&features, 1, 0.5, &Silent).unwrap();
        let expected =
            [[1.18 / 1.3, 0.24 / 1.3], [0.6 / 1.4, 1.2 / 1.4], [0.24 / 1.4, (1.0 + 0.4 * 0.8) / 1.4]];
        for (f, e) in fused.iter().zip(expected) {
            assert!((f[0] - e[0]).abs() < 1e-6 && (f[1] - e[1]).abs() < 1e-6, "{f:?} {e:?}");
        }
        assert_eq!(fuse(&features, 0, 0.5, &Silent).unwrap(), features);
        assert_eq!(fuse(&features[..1], 3, 0.5, &Silent).unwrap(), features[..1]);
        // The denominator 1 − 2 is not positive.
        let opposite = vec![vec![1.0, 0.0], vec![-1.0, 0.0]];
        assert_eq!(fuse(&opposite, 3, 2.0, &Silent).unwrap(), opposite);
    }

    #[test]
    fn the_nearest_of_many_are_those_of_a_sort() {
        let at = |i: usize| vec![((i * 7919) % 97) as f32, ((i * 104_729) % 89) as f32];
        let features: Vec<Vec<f32>> = (0..100).map(at).collect();
        let fused = fuse(&features, 3, 1e-4, &Silent).unwrap();
        for (i, own) in features.iter().enumerate() {
            let mut others: Vec<usize> = (0..100).filter(|&j| j != i).collect();
            let distance = |j: &usize| (own[0] - features[*j][0]).hypot(own[1] - features[*j][1]);
            others.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b)));
            let weight = |j: &usize| 1e-4 * (own[0] * features[*j][0] + own[1] * features[*j][1]);
            let total = 1.0 + others[..3].iter().map(weight).sum::<f32>();
            for axis in 0..2 {
                let sum = own[axis] + others[..3].iter().map(|j| weight(j) * features[*j][axis]).sum::<f32>();
                assert!((fused[i][axis] - sum / total).abs() < 1e-3, "{i}: {:?} {}", fused[i], sum / total);
            }
        }
    }
}
