//! One optimisation step.

use super::TrainConfig;
use super::batch::{Batch, picked};
use super::module::{MAP, MiniSpinNet, Mode, Statistics, parameters_of, statistics_of, values, weights_from};
use crate::descriptor::mini_spin_net::{Architecture, RADII, Weights};
use crate::{Error, Result};
use burn::optim::decay::WeightDecayConfig;
use burn::optim::{Adam, AdamConfig, AdamState, AdaptiveMomentumState, Optimizer};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};

/// Share of the batch in the running statistics, as in PyTorch.
const MOMENTUM: f32 = 0.1;

/// A network and its optimiser, between steps as plain numbers: what a checkpoint stores is the
/// whole state, so a resumed run cannot differ.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Numbers of channels.
    pub architecture: Architecture,
    /// Parameters, in the order of [`Weights::parameters`].
    pub parameters: Vec<Vec<f32>>,
    /// Their moving average: what is used.
    pub averaged: Vec<Vec<f32>>,
    /// Running statistics of the normalised convolutions.
    pub statistics: Vec<Statistics>,
    /// First and second moments, one a parameter; empty before the first step.
    pub moments: Vec<(Vec<f32>, Vec<f32>)>,
    /// Steps taken.
    pub steps: usize,
}

impl State {
    /// Before the first step.
    pub fn new(weights: &Weights) -> Self {
        Self {
            architecture: weights.architecture.clone(),
            parameters: parameters_of(weights),
            averaged: parameters_of(weights),
            statistics: statistics_of(weights),
            moments: Vec::new(),
            steps: 0,
        }
    }

    /// The network to use: the average of the steps so far.
    pub fn weights(&self) -> Weights {
        weights_from(&self.architecture, &self.averaged, &self.statistics)
    }
}

/// What takes steps.
pub struct Learner<'a> {
    config: &'a TrainConfig,
    adam: Adam,
    device: Device,
}

impl<'a> Learner<'a> {
    pub fn new(config: &'a TrainConfig) -> Self {
        let adam = AdamConfig::new()
            .with_epsilon(config.epsilon as f32)
            .with_weight_decay(Some(WeightDecayConfig::new(config.weight_decay as f32)))
            .build();
        Self { config, adam, device: Device::flex() }
    }

    /// Loss of a batch, and the state moved down its gradient.
    ///
    /// # Errors
    /// When the loss is no longer finite.
    pub fn step(&self, state: &mut State, batch: &Batch) -> Result<f64> {
        let weights = weights_from(&state.architecture, &state.parameters, &state.statistics);
        let graph = self.device.clone().autodiff();
        let module = MiniSpinNet::new(&weights, &graph);
        let shape = [batch.patches.len() * MAP, RADII * state.architecture.point_channels, 3];
        let points = TensorData::new(picked(&batch.patches, &weights), shape);
        let (descriptors, statistics) = module.forward(Tensor::from_data(points, &graph), Mode::Batch);
        let loss = circle_loss(descriptors, &batch.negatives, self.config);
        let value = f64::from(loss.clone().inner().into_scalar::<f32>());
        if !value.is_finite() {
            return Err(Error::setting(
                "train.learning_rate",
                format!("a loss of {value} after {} steps", state.steps),
                "a finite loss",
                "lower the learning rate",
            ));
        }
        let gradients = module.gradients(&loss.backward());
        self.descend(state, &gradients);
        for ((mean, variance), (m, v)) in state.statistics.iter_mut().zip(&statistics) {
            let blend = |old: &mut f32, new: &f32| *old += MOMENTUM * (new - *old);
            mean.iter_mut().zip(m).for_each(|(old, new)| blend(old, new));
            variance.iter_mut().zip(v).for_each(|(old, new)| blend(old, new));
        }
        Ok(value)
    }

    fn descend(&self, state: &mut State, gradients: &[Vec<f32>]) {
        let rate = self.config.learning_rate_after(state.steps);
        let tensor = |v: &[f32]| Tensor::<1>::from_data(TensorData::from(v), &self.device);
        let mut moments = Vec::with_capacity(gradients.len());
        for (p, (parameter, gradient)) in state.parameters.iter_mut().zip(gradients).enumerate() {
            let momentum = state.moments.get(p).map(|(first, second)| {
                AdamState::new(AdaptiveMomentumState::new(state.steps, tensor(first), tensor(second)))
            });
            let (moved, momentum) = self.adam.step(rate, tensor(parameter), tensor(gradient), momentum);
            *parameter = values(moved);
            if let Some(AdamState { momentum }) = momentum {
                moments.push((values(momentum.moment_1), values(momentum.moment_2)));
            }
        }
        state.moments = moments;
        state.steps += 1;
        // The first steps count alike, so that the start is soon forgotten.
        let keep = self.config.average.min(1.0 - 1.0 / state.steps as f64) as f32;
        for (average, value) in state.averaged.iter_mut().flatten().zip(state.parameters.iter().flatten()) {
            *average = keep * *average + (1.0 - keep) * value;
        }
    }
}

/// Circle loss (Sun et al., CVPR 2020, <https://arxiv.org/abs/2002.10857>, equations 4 to 6) with
/// one positive an anchor, from the first patches to the second and back:
///
/// mean of log(1 + Σ_n exp(γ [s_n + m]₊ (s_n − m)) · exp(−γ [1 + m − s_p]₊ (s_p − 1 + m)))
///
/// with s inner products of unit descriptors; the brackets pass no gradient.
///
/// # Shapes
/// - descriptors `[2p, D]`: first patch of every pair, then second
/// - negatives `[p · p]`
pub(super) fn circle_loss(descriptors: Tensor<2>, negatives: &[bool], config: &TrainConfig) -> Tensor<1> {
    /// What an exponent becomes where there is no negative.
    const NONE: f32 = -1e4;
    let device = descriptors.device();
    let pairs = descriptors.dims()[0] / 2;
    let (gamma, margin) = (config.circle_scale, config.circle_margin);
    let first = descriptors.clone().narrow(0, 0, pairs);
    let second = descriptors.narrow(0, pairs, pairs);
    let positive = (first.clone() * second.clone()).sum_dim(1);
    let all = first.matmul(second.transpose());
    let bracket = |s: Tensor<2>| Tensor::from_inner(s.inner().clamp_min(0.0));
    let near = bracket(positive.clone().mul_scalar(-1.0).add_scalar(1.0 + margin));
    let pull = (near * (positive.sub_scalar(1.0 - margin))).mul_scalar(-gamma);
    let far = bracket(all.clone().add_scalar(margin));
    let push = (far * all.sub_scalar(margin)).mul_scalar(gamma);
    let mask = |value: f32| {
        let values: Vec<f32> = negatives.iter().map(|n| if *n { 0.0 } else { value }).collect();
        Tensor::<2>::from_data(TensorData::new(values, [pairs, pairs]), &device)
    };
    let push = push + mask(NONE);
    // No exponent exceeds γ(1 + m)(1 − m), so the sums stay finite in single precision.
    let sum = |dim: usize| push.clone().exp().sum_dim(dim).add_scalar(1e-30).log();
    let rows = softplus(sum(1) + pull.clone());
    let columns = softplus(sum(0).transpose() + pull);
    (rows + columns).mean().mul_scalar(0.5)
}

/// log(1 + exp(x)) without overflow.
fn softplus(x: Tensor<2>) -> Tensor<2> {
    relu(x.clone()) + x.abs().mul_scalar(-1.0).exp().add_scalar(1.0).log()
}
