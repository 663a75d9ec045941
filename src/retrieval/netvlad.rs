//! NetVLAD pooling of local descriptors.

use super::generator;
use burn::module::{Module, Param};
use burn::tensor::activation::softmax;
use burn::tensor::{Device, Tensor, TensorData};
use rand::RngExt;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Floor of a norm before it divides, as in PyTorch's `normalize`.
const NORM_FLOOR: f64 = 1e-12;

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

/// Shape and initialisation of a [`NetVlad`] layer.
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
    pub fn init(&self, device: &Device) -> NetVlad {
        let mut rng = generator(self.seed, "netvlad centroids", 0);
        let centroids: Vec<f32> =
            (0..self.clusters * self.dim).map(|_| rng.random_range(0.0f32..1.0)).collect();
        self.init_from(&centroids, device)
    }

    /// A layer around the given centroids, row-major `[K·D]`: w_k = 2α c_k, b_k by [`BiasRule`].
    pub fn init_from(&self, centroids: &[f32], device: &Device) -> NetVlad {
        let weight = centroids.iter().map(|c| 2.0 * self.alpha * c).collect();
        let bias = centroids
            .chunks_exact(self.dim)
            .map(|c| {
                let square: f32 = c.iter().map(|v| v * v).sum();
                -self.alpha * if self.bias == BiasRule::Norm { square.sqrt() } else { square }
            })
            .collect();
        NetVladWeights { dim: self.dim, weight, bias, centroids: centroids.to_vec() }.init(device)
    }
}

/// The free parameters of a [`NetVlad`] layer as plain numbers.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NetVladWeights {
    /// Descriptor dimension D.
    pub dim: usize,
    /// Assignment weights w, row-major `[K·D]`.
    pub weight: Vec<f32>,
    /// Assignment biases b, `[K]`.
    pub bias: Vec<f32>,
    /// Centroids c, row-major `[K·D]`.
    pub centroids: Vec<f32>,
}

impl NetVladWeights {
    /// Clusters K.
    pub fn clusters(&self) -> usize {
        self.bias.len()
    }

    /// Puts the parameters on a device.
    pub fn init(&self, device: &Device) -> NetVlad {
        let matrix = |values: &[f32]| {
            Param::from_data(TensorData::new(values.to_vec(), [self.clusters(), self.dim]), device)
        };
        NetVlad {
            weight: matrix(&self.weight),
            bias: Param::from_data(TensorData::new(self.bias.clone(), [self.clusters()]), device),
            centroids: matrix(&self.centroids),
        }
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
///
/// Dropout on the input while training is applied by the trainer before the descriptors get here,
/// with its own counter-based generator: a resumed run must draw the same masks, and the
/// normalisation of x_n comes after the dropout, as in the published training code.
#[derive(Module, Debug)]
pub struct NetVlad {
    /// w, `[K,D]`.
    pub weight: Param<Tensor<2>>,
    /// b, `[K]`.
    pub bias: Param<Tensor<1>>,
    /// c, `[K,D]`.
    pub centroids: Param<Tensor<2>>,
}

impl NetVlad {
    /// Global feature of one scan.
    ///
    /// # Shapes
    /// - descriptors `[n,D]`, any scale, n ≥ 1
    /// - output `[K·D]`, cluster-major, unit length
    pub fn forward(&self, descriptors: Tensor<2>) -> Tensor<1> {
        let x = unit_rows(descriptors);
        let logits = x.clone().matmul(self.weight.val().transpose()) + self.bias.val().unsqueeze::<2>();
        let assignment = softmax(logits, 1);
        let mass = assignment.clone().sum_dim(0).transpose();
        let residuals = assignment.transpose().matmul(x) - self.centroids.val() * mass;
        let [clusters, dim] = residuals.dims();
        let flat = unit_rows(residuals).reshape([1, clusters * dim]);
        unit_rows(flat).reshape([clusters * dim])
    }

    /// The parameters as plain numbers.
    pub fn weights(&self) -> NetVladWeights {
        NetVladWeights {
            dim: self.weight.val().dims()[1],
            weight: values(self.weight.val()),
            bias: values(self.bias.val()),
            centroids: values(self.centroids.val()),
        }
    }
}

/// Rows scaled to unit length; a zero row stays zero and passes a zero gradient.
///
/// # Shapes
/// - rows `[n,D]` → `[n,D]`
pub(super) fn unit_rows(rows: Tensor<2>) -> Tensor<2> {
    let norm = (rows.clone() * rows.clone()).sum_dim(1).clamp_min(NORM_FLOOR * NORM_FLOOR).sqrt();
    rows / norm
}

/// The numbers of a single-precision tensor.
pub(super) fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    // No error once converted; element by element iteration is a hundred times slower.
    tensor.into_data().convert::<f32>().try_into_vec().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Equation 4 written out with loops in double precision.
    fn by_hand(w: &NetVladWeights, rows: &[Vec<f64>]) -> Vec<f64> {
        let (k, d) = (w.clusters(), w.dim);
        let unit = |v: &[f64]| {
            let n = v.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-12);
            v.iter().map(|x| x / n).collect::<Vec<_>>()
        };
        let mut vlad = vec![vec![0.0; d]; k];
        for row in rows {
            let x = unit(row);
            let logit = |c: usize| {
                (0..d).map(|i| f64::from(w.weight[c * d + i]) * x[i]).sum::<f64>() + f64::from(w.bias[c])
            };
            let sum: f64 = (0..k).map(|c| logit(c).exp()).sum();
            for (c, v) in vlad.iter_mut().enumerate() {
                let a = logit(c).exp() / sum;
                (0..d).for_each(|i| v[i] += a * (x[i] - f64::from(w.centroids[c * d + i])));
            }
        }
        unit(&vlad.iter().flat_map(|v| unit(v)).collect::<Vec<_>>())
    }

    #[test]
    fn the_layer_follows_the_equation() {
        let config = NetVladConfig { clusters: 5, dim: 3, alpha: 10.0, bias: BiasRule::SquaredNorm, seed: 7 };
        let device = Device::flex();
        let layer = config.init(&device);
        let mut rng = generator(1, "test", 0);
        let rows: Vec<Vec<f64>> =
            (0..40).map(|_| (0..3).map(|_| f64::from(rng.random_range(-1.0f32..1.0))).collect()).collect();
        let data: Vec<f32> = rows.iter().flatten().map(|&v| v as f32).collect();
        let got = values(layer.forward(Tensor::from_data(TensorData::new(data, [40, 3]), &device)));
        let expected = by_hand(&layer.weights(), &rows);
        assert_eq!(got.len(), 15);
        for (g, e) in got.iter().zip(&expected) {
            assert!((f64::from(*g) - e).abs() < 1e-5, "{g} against {e}");
        }
    }

    #[test]
    fn initialisation_follows_either_bias_rule() {
        let device = Device::flex();
        let mut config = NetVladConfig { clusters: 1, dim: 2, alpha: 10.0, bias: BiasRule::Norm, seed: 0 };
        let norm = config.init_from(&[0.3, 0.4], &device).weights();
        assert_eq!(norm.weight, vec![6.0, 8.0]);
        assert!((norm.bias[0] + 5.0).abs() < 1e-5);
        config.bias = BiasRule::SquaredNorm;
        assert!((config.init_from(&[0.3, 0.4], &device).weights().bias[0] + 2.5).abs() < 1e-5);
    }

    #[test]
    fn a_zero_descriptor_gives_finite_gradients() {
        let device = Device::flex().autodiff();
        let config = NetVladConfig { clusters: 2, dim: 2, alpha: 1.0, bias: BiasRule::Norm, seed: 3 };
        let layer = config.init(&device);
        let x = Tensor::from_data(TensorData::new(vec![0.0f32, 0.0, 1.0, 0.0], [2, 2]), &device);
        let out = layer.forward(x);
        let grads = (out.clone() * out).slice(0..1).sum().backward();
        let grad = values(layer.weight.val().grad(&grads).expect("the weight takes part"));
        assert!(grad.iter().all(|g| g.is_finite()), "{grad:?}");
        assert!(grad.iter().any(|g| *g != 0.0), "{grad:?}");
    }
}
