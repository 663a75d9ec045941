//! The heads of [`crate::retrieval`] as Burn modules, to be trained: the same formulas with gradients.
//!
//! Dropout on the input is applied by the trainer before the descriptors get here, with its own
//! counter-based generator: a resumed run must draw the same masks, and the normalisation of x_n
//! comes after the dropout, as in the published training code.

use crate::retrieval::Gem;
use crate::retrieval::HeadWeights;
use crate::retrieval::NetVlad;
use burn::module::{Module, Param};
use burn::tensor::activation::softmax;
use burn::tensor::{Device, Gradients, Tensor, TensorData};

/// Floor of a norm before it divides, as in PyTorch's `normalize`.
const NORM_FLOOR: f64 = 1e-12;

/// NetVLAD ([`NetVlad`] has paper and formula).
#[derive(Module, Debug)]
pub struct NetVladLayer {
    /// w, `[K,D]`.
    weight: Param<Tensor<2>>,
    /// b, `[K]`.
    bias: Param<Tensor<1>>,
    /// c, `[K,D]`.
    centroids: Param<Tensor<2>>,
}

impl NetVladLayer {
    fn new(layer: &NetVlad, device: &Device) -> Self {
        let (clusters, dim) = (layer.clusters(), layer.dim);
        let matrix =
            |values: &[f32]| Param::from_data(TensorData::new(values.to_vec(), [clusters, dim]), device);
        Self {
            weight: matrix(&layer.weight),
            bias: Param::from_data(TensorData::new(layer.bias.clone(), [clusters]), device),
            centroids: matrix(&layer.centroids),
        }
    }

    fn forward(&self, descriptors: Tensor<2>) -> Tensor<1> {
        let x = unit_rows(descriptors);
        let logits = x.clone().matmul(self.weight.val().transpose()) + self.bias.val().unsqueeze::<2>();
        let assignment = softmax(logits, 1);
        let mass = assignment.clone().sum_dim(0).transpose();
        let residuals = assignment.transpose().matmul(x) - self.centroids.val() * mass;
        let [clusters, dim] = residuals.dims();
        let flat = unit_rows(residuals).reshape([1, clusters * dim]);
        unit_rows(flat).reshape([clusters * dim])
    }
}

/// Generalised mean ([`Gem`] has paper and formula).
#[derive(Module, Debug)]
pub struct GemLayer {
    /// p, `[1]`.
    power: Param<Tensor<1>>,
    shift: f32,
    floor: f32,
}

impl GemLayer {
    fn new(layer: &Gem, device: &Device) -> Self {
        Self {
            power: Param::from_data(TensorData::new(vec![layer.power], [1]), device),
            shift: layer.shift,
            floor: layer.floor,
        }
    }

    fn forward(&self, descriptors: Tensor<2>) -> Tensor<1> {
        let [_, dim] = descriptors.dims();
        let x = (unit_rows(descriptors) + self.shift).clamp_min(self.floor);
        let power = self.power.val().unsqueeze::<2>();
        // x^p = exp(p ln x): the derivative with respect to p needs the logarithm anyway.
        let mean = (x.log() * power.clone()).exp().mean_dim(0);
        let root = (mean.log() / power).exp() - self.shift;
        unit_rows(root).reshape([dim])
    }
}

/// A trainable head.
#[derive(Debug, Clone)]
pub enum HeadLayer {
    /// NetVLAD.
    NetVlad(NetVladLayer),
    /// Generalised mean.
    Gem(GemLayer),
}

impl HeadLayer {
    /// Puts the parameters on a device.
    pub fn new(weights: &HeadWeights, device: &Device) -> Self {
        match weights {
            HeadWeights::NetVlad(layer) => HeadLayer::NetVlad(NetVladLayer::new(layer, device)),
            HeadWeights::Gem { layer, .. } => HeadLayer::Gem(GemLayer::new(layer, device)),
        }
    }

    /// Global feature of one scan, as [`crate::retrieval::Head::global_feature`].
    ///
    /// # Shapes
    /// - descriptors `[n,D]`, any scale, n ≥ 1
    /// - output `[F]`, unit length; F = K·D for NetVLAD, D otherwise
    pub fn forward(&self, descriptors: Tensor<2>) -> Tensor<1> {
        match self {
            HeadLayer::NetVlad(layer) => layer.forward(descriptors),
            HeadLayer::Gem(layer) => layer.forward(descriptors),
        }
    }

    /// Gradient of every trainable parameter, row-major, in the order of
    /// [`HeadWeights::parameters`]; empty where a parameter took no part.
    pub fn gradients(&self, gradients: &Gradients) -> Vec<Vec<f32>> {
        fn of<const D: usize>(parameter: Tensor<D>, gradients: &Gradients) -> Vec<f32> {
            parameter.grad(gradients).map(values).unwrap_or_default()
        }
        match self {
            HeadLayer::NetVlad(layer) => vec![
                of(layer.weight.val(), gradients),
                of(layer.bias.val(), gradients),
                of(layer.centroids.val(), gradients),
            ],
            HeadLayer::Gem(layer) => vec![of(layer.power.val(), gradients)],
        }
    }
}

/// Rows scaled to unit length; a zero row stays zero and passes a zero gradient.
///
/// # Shapes
/// - rows `[n,D]` → `[n,D]`
fn unit_rows(rows: Tensor<2>) -> Tensor<2> {
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
    use crate::random::generator;
    use crate::retrieval::BiasRule;
    use crate::retrieval::NetVladConfig;
    use crate::scan::Descriptors;
    use rand::RngExt;

    /// Inference in the core and the module agree to 1e-5: two implementations of one formula.
    #[test]
    fn modules_and_inference_agree() {
        let mut rng = generator(5, "parity", 0);
        let (n, dim) = (2500, 65);
        // Not about zero: the mean of such values is nothing but rounding once the shift is taken off.
        let data: Vec<f32> = (0..n * dim).map(|_| rng.random_range(-0.4f32..1.0)).collect();
        let netvlad = |alpha, bias| {
            HeadWeights::NetVlad(NetVladConfig { clusters: 64, dim, alpha, bias, seed: 7 }.init())
        };
        let gem = |power, shift| HeadWeights::Gem { layer: Gem { power, shift, floor: 1e-6 }, dim };
        let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("checkpoints/netvlad-minispinnet.safetensors");
        let shipped = crate::retrieval::Checkpoint::load(&file).unwrap().weights;
        let heads = [
            netvlad(10.0, BiasRule::Norm),
            netvlad(1.0, BiasRule::SquaredNorm),
            // Sharper, logits are in the thousands, of which single precision itself does not hold 1e-5.
            netvlad(10.0, BiasRule::SquaredNorm),
            shipped,
            gem(3.0, 1.0),
            gem(1.0, 1.0),
            gem(6.5, 1.0),
        ];
        for (at, weights) in heads.into_iter().enumerate() {
            let device = Device::flex();
            let tensor = Tensor::from_data(TensorData::new(data.clone(), [n, dim]), &device);
            let module = values(HeadLayer::new(&weights, &device).forward(tensor));
            let core = weights.head().global_feature(&Descriptors::new(dim, data.clone()).unwrap());
            assert_eq!(module.len(), core.len());
            let worst = module.iter().zip(&core).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst < 1e-5, "head {at}: {worst}");
            assert!(core.iter().any(|v| v.abs() > 1e-3));
        }
    }

    #[test]
    fn a_zero_descriptor_gives_finite_gradients() {
        let device = Device::flex().autodiff();
        let config = NetVladConfig { clusters: 2, dim: 2, alpha: 1.0, bias: BiasRule::Norm, seed: 3 };
        let layer = HeadLayer::new(&HeadWeights::NetVlad(config.init()), &device);
        let x = Tensor::from_data(TensorData::new(vec![0.0f32, 0.0, 1.0, 0.0], [2, 2]), &device);
        let out = layer.forward(x);
        let grads = (out.clone() * out).slice(0..1).sum().backward();
        let of_weight = &layer.gradients(&grads)[0];
        assert!(of_weight.iter().all(|g| g.is_finite()), "{of_weight:?}");
        assert!(of_weight.iter().any(|g| *g != 0.0), "{of_weight:?}");
    }
}
