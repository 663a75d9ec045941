//! One optimisation step of the head.

use super::TrainConfig;
use super::batch::Batch;
use super::layers::{HeadLayer, values};
use crate::retrieval::HeadWeights;
use crate::retrieval::OptimizerState;
use crate::scan::SimilarityMatrix;
use crate::{Error, Result};
use burn::nn::loss::SmoothL1LossConfig;
use burn::optim::decay::WeightDecayConfig;
use burn::optim::{Adam, AdamConfig, AdamState, AdaptiveMomentumState, Optimizer};
use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;

/// Floor of a squared distance before its root, which has no derivative at zero.
const DISTANCE_FLOOR: f64 = 1e-8;

/// A head and its optimiser, between steps as plain numbers: what a checkpoint stores is the whole
/// state, so a resumed run cannot differ.
pub(super) struct Learner {
    pub weights: HeadWeights,
    pub state: OptimizerState,
    adam: Adam,
    device: Device,
}

impl Learner {
    pub fn new(weights: HeadWeights, state: OptimizerState, config: &TrainConfig, device: &Device) -> Self {
        // Burn's ε is 1e-5 unless told otherwise; PyTorch's, and the recipe's, is 1e-8.
        let adam = AdamConfig::new()
            .with_epsilon(config.epsilon as f32)
            .with_weight_decay(Some(WeightDecayConfig::new(config.weight_decay as f32)))
            .build();
        Self { weights, state, adam, device: device.clone() }
    }

    /// Loss of a batch, and the parameters moved down its gradient.
    ///
    /// Every crop has an autodiff graph of its own, so that crops run side by side and the sum of
    /// their gradients has a fixed order: forward a crop at a time, then the loss over the global
    /// features alone, then its derivative by each feature sent back through the crop's graph.
    ///
    /// # Errors
    /// When the loss is no longer finite.
    pub fn step(&mut self, batch: &Batch, learning_rate: f64) -> Result<f64> {
        let graph = self.device.clone().autodiff();
        let dim = self.weights.dim();
        let forward = |crop: &Vec<f32>| {
            let head = HeadLayer::new(&self.weights, &graph);
            let rows = TensorData::new(crop.clone(), [crop.len() / dim, dim]);
            let feature = head.forward(Tensor::from_data(rows, &graph));
            (head, feature)
        };
        let passes: Vec<(HeadLayer, Tensor<1>)> = batch.crops.par_iter().map(forward).collect();
        let features: Vec<Vec<f32>> = passes.par_iter().map(|(_, f)| values(f.clone().inner())).collect();
        let (loss, slopes) = overlap_loss(&features, &batch.targets, &graph);
        if !loss.is_finite() {
            return Err(Error::setting(
                "train.learning_rate",
                format!("a loss of {loss} after {} steps", self.state.steps),
                "a finite loss",
                "lower the learning rate",
            ));
        }
        let back = |((head, feature), slope): ((HeadLayer, Tensor<1>), Vec<f32>)| {
            let slope = Tensor::from_data(TensorData::from(slope.as_slice()), &graph);
            head.gradients(&(feature * slope).sum().backward())
        };
        let gradients: Vec<Vec<Vec<f32>>> = passes.into_par_iter().zip(slopes).map(back).collect();
        self.descend(&gradients, learning_rate);
        Ok(loss)
    }

    /// Adam on the summed gradients of all crops.
    fn descend(&mut self, gradients: &[Vec<Vec<f32>>], learning_rate: f64) {
        let tensor = |v: &[f32]| Tensor::<1>::from_data(TensorData::from(v), &self.device);
        let mut moments = Vec::new();
        for (p, parameter) in self.weights.parameters_mut().into_iter().enumerate() {
            let mut gradient = vec![0.0f32; parameter.len()];
            for crop in gradients {
                gradient.iter_mut().zip(&crop[p]).for_each(|(sum, g)| *sum += g);
            }
            let state = self.state.moments.get(p).map(|(first, second)| {
                AdamState::new(AdaptiveMomentumState::new(self.state.steps, tensor(first), tensor(second)))
            });
            let (moved, state) = self.adam.step(learning_rate, tensor(parameter), tensor(&gradient), state);
            parameter.copy_from_slice(&values(moved));
            if let Some(AdamState { momentum }) = state {
                moments.push((values(momentum.moment_1), values(momentum.moment_2)));
            }
        }
        self.state = OptimizerState { steps: self.state.steps + 1, moments };
    }
}

/// Mean smooth L1 loss over all pairs i < j of s_ij = (2 − ‖g_i − g_j‖)/2 against the target, and
/// its derivative by every feature.
///
/// The features are the un-fused ones: fusion belongs to inference only. They have unit length, so
/// ‖g_i − g_j‖² = 2 − 2 g_i·g_j.
pub(super) fn overlap_loss(
    features: &[Vec<f32>],
    targets: &SimilarityMatrix,
    graph: &Device,
) -> (f64, Vec<Vec<f32>>) {
    let n = features.len();
    let length = features.first().map_or(0, Vec::len);
    let g = Tensor::<2>::from_data(TensorData::new(features.concat(), [n, length]), graph).require_grad();
    let square = g.clone().matmul(g.clone().transpose()).mul_scalar(-2.0).add_scalar(2.0);
    let similarity = square.clamp_min(DISTANCE_FLOOR).sqrt().mul_scalar(-0.5).add_scalar(1.0);
    let matrix = |value: &dyn Fn(usize, usize) -> f32| {
        let values: Vec<f32> = (0..n * n).map(|at| value(at / n, at % n)).collect();
        Tensor::<2>::from_data(TensorData::new(values, [n, n]), graph)
    };
    let share = 1.0 / (n * n.saturating_sub(1) / 2).max(1) as f32;
    let weight = matrix(&|i, j| if i < j { share } else { 0.0 });
    let target = matrix(&|i, j| targets.get(i, j));
    let loss = SmoothL1LossConfig::new().init().forward(similarity, target);
    let loss = (loss * weight).sum();
    let slopes = g.grad(&loss.backward()).map(values).unwrap_or_default();
    let loss: f32 = loss.inner().into_scalar();
    (f64::from(loss), slopes.chunks(length.max(1)).map(<[f32]>::to_vec).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::generator;
    use crate::retrieval::Gem;
    use crate::retrieval::similarity;
    use crate::retrieval::{BiasRule, NetVladConfig};
    use crate::scan::Descriptors;
    use rand::RngExt;

    fn targets(n: usize) -> SimilarityMatrix {
        SimilarityMatrix::new(n, (0..n * n).map(|at| ((at / n + at % n) as f32 * 0.37).fract()).collect())
            .unwrap()
    }

    fn batch(n: usize, dim: usize) -> Batch {
        let mut rng = generator(4, "test", 0);
        let crop = |k: usize| (0..(20 + k) * dim).map(|_| rng.random_range(-1.0f32..1.0)).collect();
        Batch { crops: (0..n).map(crop).collect(), targets: targets(n) }
    }

    fn netvlad(dim: usize) -> HeadWeights {
        let config = NetVladConfig { clusters: 4, dim, alpha: 5.0, bias: BiasRule::Norm, seed: 2 };
        HeadWeights::NetVlad(config.init())
    }

    /// The loss of a batch by the inference code, in double precision after the features.
    fn loss_by_hand(weights: &HeadWeights, batch: &Batch) -> f64 {
        let head = weights.head();
        let descriptors = |crop: &Vec<f32>| Descriptors::new(weights.dim(), crop.clone()).unwrap();
        let g: Vec<Vec<f32>> = batch.crops.iter().map(|c| head.global_feature(&descriptors(c))).collect();
        let n = g.len();
        let mut sum = 0.0;
        for i in 0..n {
            for j in i + 1..n {
                // Both lie in [0, 1], so smooth L1 is in its quadratic part.
                sum += 0.5 * (similarity(&g[i], &g[j]) - f64::from(batch.targets.get(i, j))).powi(2);
            }
        }
        sum / (n * (n - 1) / 2) as f64
    }

    /// Step with a plain gradient: difference of the parameters over a tiny learning rate, first
    /// Adam step = sign of the gradient, so the moments hold the gradient: m = 0.1 g.
    #[test]
    fn gradients_equal_finite_differences_of_the_loss() {
        let device = Device::flex();
        let gem = HeadWeights::Gem { layer: Gem { shift: 1.5, ..Gem::default() }, dim: 3 };
        for weights in [netvlad(3), gem] {
            let batch = batch(5, 3);
            let config = TrainConfig { weight_decay: 0.0, ..TrainConfig::default() };
            let mut learner = Learner::new(weights.clone(), OptimizerState::default(), &config, &device);
            let loss = learner.step(&batch, 1e-3).unwrap();
            assert!((loss - loss_by_hand(&weights, &batch)).abs() < 1e-6);
            let mut checked = 0;
            for p in 0..weights.parameters().len() {
                for at in 0..weights.parameters()[p].len() {
                    let moved = |by: f32| {
                        let mut w = weights.clone();
                        w.parameters_mut()[p][at] += by;
                        loss_by_hand(&w, &batch)
                    };
                    let h = 1e-2;
                    let expected = (moved(h) - moved(-h)) / (2.0 * f64::from(h));
                    let got = f64::from(learner.state.moments[p].0[at]) / 0.1;
                    // Differences of single-precision features: noise of 1e-7 / h.
                    assert!(
                        (got - expected).abs() < 2e-5 + 0.02 * expected.abs(),
                        "{p} {at}: {got} {expected}"
                    );
                    checked += usize::from(expected.abs() > 1e-4);
                }
            }
            assert!(checked > 0);
        }
    }

    #[test]
    fn adam_follows_its_formula_with_pytorch_epsilon_and_decay() {
        let device = Device::flex();
        let config = TrainConfig::default();
        let start = netvlad(2);
        let mut learner = Learner::new(start.clone(), OptimizerState::default(), &config, &device);
        // Kingma and Ba 2015, algorithm 1, with the decay added to the gradient; in double precision.
        let mut expected: Vec<f64> = start.parameters()[0].iter().map(|&v| f64::from(v)).collect();
        let (mut m, mut v) = (vec![0.0f64; expected.len()], vec![0.0f64; expected.len()]);
        for t in 1..=4 {
            let gradient: Vec<f32> = (0..expected.len()).map(|i| ((i + t) as f32).sin() * 1e-5).collect();
            let zeros = |p: usize| vec![0.0f32; start.parameters()[p].len()];
            // Two crops that share the gradient half and half.
            let half: Vec<f32> = gradient.iter().map(|g| 0.5 * g).collect();
            learner.descend(&[vec![half.clone(), zeros(1), zeros(2)], vec![half, zeros(1), zeros(2)]], 0.01);
            for i in 0..expected.len() {
                let g = f64::from(gradient[i]) + 1e-4 * expected[i];
                m[i] = 0.9 * m[i] + 0.1 * g;
                v[i] = 0.999 * v[i] + 0.001 * g * g;
                let (mh, vh) = (m[i] / (1.0 - 0.9f64.powi(t as i32)), v[i] / (1.0 - 0.999f64.powi(t as i32)));
                expected[i] -= 0.01 * mh / (vh.sqrt() + 1e-8);
            }
        }
        for (got, e) in learner.weights.parameters()[0].iter().zip(&expected) {
            assert!((f64::from(*got) - e).abs() < 2e-5, "{got} {e}");
        }
        assert_eq!(learner.state.steps, 4);
    }

    #[test]
    fn equal_features_have_a_finite_slope() {
        let features = vec![vec![1.0, 0.0], vec![1.0, 0.0], vec![0.0, 1.0]];
        let (loss, slopes) = overlap_loss(&features, &targets(3), &Device::flex().autodiff());
        assert!(loss.is_finite() && slopes.iter().flatten().all(|v| v.is_finite()));
    }

    /// The older CPU backend as an independent implementation of every operation.
    #[cfg(feature = "ndarray")]
    // Deprecated in favour of the very backend it is compared with.
    #[allow(deprecated)]
    #[test]
    fn ndarray_and_flex_agree_over_a_few_steps() {
        let run = |device: Device| {
            let start = netvlad(3);
            let mut learner =
                Learner::new(start, OptimizerState::default(), &TrainConfig::default(), &device);
            let losses: Vec<f64> = (0..5).map(|_| learner.step(&batch(6, 3), 1e-3).unwrap()).collect();
            (losses, learner.weights.parameters().concat())
        };
        let (a, b) = (run(Device::flex()), run(Device::ndarray()));
        assert!(a.0.iter().zip(&b.0).all(|(x, y)| (x - y).abs() < 1e-4), "{:?} {:?}", a.0, b.0);
        assert!(a.1.iter().zip(&b.1).all(|(x, y)| (x - y).abs() < 1e-4));
        assert!(a.0[4] < a.0[0]);
    }
}
