//! Fusing global features with their nearest neighbours.

use super::similarity::squared_distance;

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
pub fn fuse(features: &[Vec<f32>], neighbours: usize, beta: f64) -> Vec<Vec<f32>> {
    (0..features.len()).map(|i| fuse_one(features, i, neighbours, beta)).collect()
}

fn fuse_one(features: &[Vec<f32>], i: usize, neighbours: usize, beta: f64) -> Vec<f32> {
    let own = &features[i];
    let mut others: Vec<(f64, usize)> =
        (0..features.len()).filter(|&j| j != i).map(|j| (squared_distance(own, &features[j]), j)).collect();
    others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut sum: Vec<f64> = own.iter().map(|&v| f64::from(v)).collect();
    let mut total = 1.0;
    for &(_, j) in others.iter().take(neighbours) {
        let product: f64 = own.iter().zip(&features[j]).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
        let weight = beta * product;
        total += weight;
        sum.iter_mut().zip(&features[j]).for_each(|(s, v)| *s += weight * f64::from(*v));
    }
    if total <= 0.0 {
        return own.clone();
    }
    sum.into_iter().map(|s| (s / total) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_neighbours_pull_by_their_product() {
        let features = vec![vec![1.0, 0.0], vec![0.6, 0.8], vec![0.0, 1.0]];
        // By hand, one neighbour, beta 0.5: (g0 + 0.3 g1)/1.3; g1's nearest is g2 (product 0.8).
        let fused = fuse(&features, 1, 0.5);
        let expected =
            [[1.18 / 1.3, 0.24 / 1.3], [0.6 / 1.4, 1.2 / 1.4], [0.24 / 1.4, (1.0 + 0.4 * 0.8) / 1.4]];
        for (f, e) in fused.iter().zip(expected) {
            assert!((f[0] - e[0]).abs() < 1e-6 && (f[1] - e[1]).abs() < 1e-6, "{f:?} {e:?}");
        }
        assert_eq!(fuse(&features, 0, 0.5), features);
        assert_eq!(fuse(&features[..1], 3, 0.5), features[..1]);
        // The denominator 1 − 2 is not positive.
        let opposite = vec![vec![1.0, 0.0], vec![-1.0, 0.0]];
        assert_eq!(fuse(&opposite, 3, 2.0), opposite);
    }
}
