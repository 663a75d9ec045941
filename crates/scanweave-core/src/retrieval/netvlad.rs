//! NetVLAD pooling of local descriptors.

use super::pooling::{add_scaled, unit_row};
use crate::random::generator;
use crate::scan::Descriptors;
use rand::RngExt;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How the assignment bias b_k starts out from the centroid c_k.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BiasRule {
    /// b_k = −α‖c_k‖, what the published implementations do.
    #[default]
    Norm,
    /// b_k = −α‖c_k‖², what follows from softmax_k(−α‖x − c_k‖²).
    SquaredNorm,
}

/// Shape and initialisation of a NetVLAD layer.
#[derive(Debug, Clone, PartialEq)]
pub struct NetVladConfig {
    /// Clusters K.
    pub clusters: usize,
    /// Descriptor dimension D.
    pub dim: usize,
    /// Sharpness α of the initial assignment.
    pub alpha: f32,
    /// Rule for the initial bias.
    pub bias: BiasRule,
    /// Seed of the centroids where none are given.
    pub seed: u64,
}

impl NetVladConfig {
    /// A layer with centroids drawn from `U[0,1]`, as in the published code.
    pub fn init(&self) -> NetVlad {
        let mut rng = generator(self.seed, "netvlad centroids", 0);
        let centroids: Vec<f32> =
            (0..self.clusters * self.dim).map(|_| rng.random_range(0.0f32..1.0)).collect();
        self.init_from(&centroids)
    }

    /// A layer around the given centroids, row-major `[K·D]`: w_k = 2α c_k, b_k by [`BiasRule`].
    pub fn init_from(&self, centroids: &[f32]) -> NetVlad {
        let weight = centroids.iter().map(|c| 2.0 * self.alpha * c).collect();
        let bias = centroids
            .chunks_exact(self.dim)
            .map(|c| {
                let square: f32 = c.iter().map(|v| v * v).sum();
                -self.alpha * if self.bias == BiasRule::Norm { square.sqrt() } else { square }
            })
            .collect();
        NetVlad { dim: self.dim, weight, bias, centroids: centroids.to_vec() }
    }
}

/// Soft-assigned sum of residuals to learnt centroids.
///
/// Arandjelović, Gronat, Torii, Pajdla, Sivic, "NetVLAD: CNN architecture for weakly supervised
/// place recognition", CVPR 2016, <https://arxiv.org/abs/1511.07247>, equation 4:
///
/// V_k = Σ_n a_nk (x_n − c_k),  a_nk = softmax_k(w_k·x_n + b_k)
///
/// with x_n the L2-normalised descriptor of keypoint n, c_k the centroid of cluster k, and w_k, b_k
/// the assignment's weight and bias, free of c_k after initialisation. Every V_k is scaled to unit
/// length (intra-normalisation), the rows are laid one after another, and the whole is scaled to
/// unit length.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NetVlad {
    /// Descriptor dimension D.
    pub dim: usize,
    /// Assignment weights w, row-major `[K·D]`.
    pub weight: Vec<f32>,
    /// Assignment biases b, `[K]`.
    pub bias: Vec<f32>,
    /// Centroids c, row-major `[K·D]`.
    pub centroids: Vec<f32>,
}

impl NetVlad {
    /// Clusters K.
    pub fn clusters(&self) -> usize {
        self.bias.len()
    }

    /// Global feature of one scan.
    ///
    /// # Shapes
    /// - descriptors `[n,D]`, any scale, n ≥ 1
    /// - output `[K·D]`, cluster-major, unit length
    pub fn global_feature(&self, descriptors: &Descriptors) -> Vec<f32> {
        let mut feature = vec![0.0; self.clusters() * self.dim];
        let mut mass = vec![0.0; self.clusters()];
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || self.assign(descriptors, &mut feature, &mut mass),
        );
        let centroids = self.centroids.chunks_exact(self.dim);
        for ((row, centroid), mass) in feature.chunks_exact_mut(self.dim).zip(centroids).zip(mass) {
            add_scaled(row, centroid, -mass);
            unit_row(row);
        }
        unit_row(&mut feature);
        feature
    }

    /// Σ_n a_nk x_n into `sums` `[K·D]` and Σ_n a_nk into `mass` `[K]`.
    #[inline(always)]
    fn assign(&self, descriptors: &Descriptors, sums: &mut [f32], mass: &mut [f32]) {
        let (clusters, dim) = (self.clusters(), self.dim);
        // [D,K]: one value of a descriptor meets the weights of all clusters side by side.
        let transposed: Vec<f32> =
            (0..dim * clusters).map(|at| self.weight[at % clusters * dim + at / clusters]).collect();
        let (mut x, mut assignment) = (vec![0.0; dim], vec![0.0; clusters]);
        for row in 0..descriptors.len() {
            x.copy_from_slice(descriptors.row(row));
            unit_row(&mut x);
            assignment.copy_from_slice(&self.bias);
            for (&value, weights) in x.iter().zip(transposed.chunks_exact(clusters)) {
                add_scaled(&mut assignment, weights, value);
            }
            softmax(&mut assignment);
            for ((sum, mass), &share) in sums.chunks_exact_mut(dim).zip(mass.iter_mut()).zip(&assignment) {
                add_scaled(sum, &x, share);
                *mass += share;
            }
        }
    }
}

/// exp(v − max) / Σ exp(v − max).
#[inline(always)]
fn softmax(values: &mut [f32]) {
    let largest = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let mut sum = 0.0;
    for value in values.iter_mut() {
        *value = (*value - largest).exp();
        sum += *value;
    }
    values.iter_mut().for_each(|value| *value /= sum);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Equation 4 written out with loops in double precision.
    fn by_hand(layer: &NetVlad, rows: &[Vec<f64>]) -> Vec<f64> {
        let (k, d) = (layer.clusters(), layer.dim);
        let unit = |v: &[f64]| {
            let n = v.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-12);
            v.iter().map(|x| x / n).collect::<Vec<_>>()
        };
        let mut vlad = vec![vec![0.0; d]; k];
        for row in rows {
            let x = unit(row);
            let logit = |c: usize| {
                let weights = &layer.weight[c * d..(c + 1) * d];
                weights.iter().zip(&x).map(|(w, x)| f64::from(*w) * x).sum::<f64>() + f64::from(layer.bias[c])
            };
            let sum: f64 = (0..k).map(|c| logit(c).exp()).sum();
            for (c, v) in vlad.iter_mut().enumerate() {
                let a = logit(c).exp() / sum;
                (0..d).for_each(|i| v[i] += a * (x[i] - f64::from(layer.centroids[c * d + i])));
            }
        }
        unit(&vlad.iter().flat_map(|v| unit(v)).collect::<Vec<_>>())
    }

    #[test]
    fn the_layer_follows_the_equation() {
        let config = NetVladConfig { clusters: 5, dim: 3, alpha: 10.0, bias: BiasRule::SquaredNorm, seed: 7 };
        let layer = config.init();
        let mut rng = generator(1, "test", 0);
        let rows: Vec<Vec<f64>> =
            (0..40).map(|_| (0..3).map(|_| f64::from(rng.random_range(-1.0f32..1.0))).collect()).collect();
        let values: Vec<f32> = rows.iter().flatten().map(|&v| v as f32).collect();
        let got = layer.global_feature(&Descriptors::new(3, values).unwrap());
        let expected = by_hand(&layer, &rows);
        assert_eq!(got.len(), 15);
        for (g, e) in got.iter().zip(&expected) {
            assert!((f64::from(*g) - e).abs() < 1e-5, "{g} against {e}");
        }
    }

    #[test]
    fn a_zero_descriptor_and_far_logits_give_finite_features() {
        let config = NetVladConfig { clusters: 3, dim: 2, alpha: 1e4, bias: BiasRule::Norm, seed: 3 };
        let feature = config.init().global_feature(&Descriptors::new(2, vec![0.0, 0.0, 1.0, 0.0]).unwrap());
        assert!(feature.iter().all(|v| v.is_finite()), "{feature:?}");
        assert!((feature.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
    }

    #[test]
    fn initialisation_follows_either_bias_rule() {
        let mut config = NetVladConfig { clusters: 1, dim: 2, alpha: 10.0, bias: BiasRule::Norm, seed: 0 };
        let norm = config.init_from(&[0.3, 0.4]);
        assert_eq!(norm.weight, vec![6.0, 8.0]);
        assert!((norm.bias[0] + 5.0).abs() < 1e-5);
        config.bias = BiasRule::SquaredNorm;
        assert!((config.init_from(&[0.3, 0.4]).bias[0] + 2.5).abs() < 1e-5);
    }
}
