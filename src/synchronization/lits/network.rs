//! One round of the graph network.

use super::weights::LitsWeights;
use burn::module::{Module, Param};
use burn::tensor::activation::{relu, sigmoid};
use burn::tensor::{Device, Tensor, TensorData};

/// Width of a node's state.
pub const NODE: usize = 16;
/// Width of the state of the whole graph.
pub const GLOBAL: usize = 4;
/// Width of hidden layers.
pub const HIDDEN: usize = 256;
/// Rounds, with the same weights.
pub const ROUNDS: usize = 10;
/// Added to the length of a node's messages before it divides them.
const LENGTH_FLOOR: f64 = 1e-4;

/// Where messages come from and go to, one a message.
pub(super) struct Messages {
    pub from: Vec<usize>,
    pub to: Vec<usize>,
}

/// What a round leaves.
pub(super) struct Round {
    /// States of the nodes, `[n,NODE]`.
    pub nodes: Tensor<2>,
    /// State of the graph, `[1,GLOBAL]`.
    pub global: Tensor<2>,
    /// Updates of the poses, `[n,6]`: translation part, then rotation vector, not yet bounded.
    pub updates: Tensor<2>,
}

/// y = x Wᵀ + b.
#[derive(Module, Debug)]
struct Dense {
    /// `[out,in]`.
    weight: Param<Tensor<2>>,
    /// `[out]`.
    bias: Param<Tensor<1>>,
}

impl Dense {
    fn new(weights: &LitsWeights, layer: &str, device: &Device) -> Self {
        let (weight, bias) = weights.layer(layer);
        let shape = [bias.len(), weight.len() / bias.len().max(1)];
        Self {
            weight: Param::from_data(TensorData::new(weight.to_vec(), shape), device),
            bias: Param::from_data(TensorData::new(bias.to_vec(), [bias.len()]), device),
        }
    }

    fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        x.matmul(self.weight.val().transpose()) + self.bias.val().unsqueeze::<2>()
    }
}

/// The layers, named as published.
#[derive(Module, Debug)]
pub(super) struct GraphNetwork {
    node_mlp_1: [Dense; 2],
    node_mlp_2: [Dense; 2],
    weights_mlp_1: [Dense; 2],
    weights_mlp_2: [Dense; 2],
    global_mlp: [Dense; 2],
}

impl GraphNetwork {
    /// Puts the weights on a device.
    pub fn new(weights: &LitsWeights, device: &Device) -> Self {
        let pair = |name: &str| [0, 2].map(|at| Dense::new(weights, &format!("{name}.{at}"), device));
        Self {
            node_mlp_1: pair("node_model.node_mlp_1"),
            node_mlp_2: pair("node_model.node_mlp_2"),
            weights_mlp_1: pair("node_model.weights_mlp_1"),
            weights_mlp_2: pair("node_model.weights_mlp_2"),
            global_mlp: pair("global_model.global_mlp"),
        }
    }

    /// One round: the state of the graph, messages along both directions of every link, their
    /// weighted sum at each node, the states of the nodes and the updates of their poses.
    ///
    /// # Shapes
    /// - nodes `[n,NODE]`, global `[1,GLOBAL]`
    /// - errors `[m,12]`, one transformation error a message; every node gets a message
    pub fn round(&self, nodes: Tensor<2>, global: Tensor<2>, ends: &Messages, errors: Tensor<2>) -> Round {
        let [n, _] = nodes.dims();
        let mean = nodes.clone().mean_dim(0);
        let global = two(&self.global_mlp, Tensor::cat(vec![global, mean], 1));

        let pick = |of: &[usize]| select(nodes.clone(), of);
        let input = Tensor::cat(vec![pick(&ends.from), pick(&ends.to), errors], 1);
        let features = relu(two(&self.node_mlp_1, input.clone()));
        let weights = self.weights(input, ends, n);
        let sum = sum_at(features * weights, &ends.to, n);
        let length = sum.clone().powf_scalar(2.0).sum_dim(1).sqrt() + LENGTH_FLOOR;

        let spread = global.clone().repeat_dim(0, n);
        let out = two(&self.node_mlp_2, Tensor::cat(vec![sum / length, nodes.clone(), spread], 1));
        let updates = out.clone().slice([0..n, NODE..NODE + 6]);
        Round { nodes: nodes + out.slice([0..n, 0..NODE]), global, updates }
    }

    /// How much each message counts, `[m,1]`, in the light of the strongest at its node.
    fn weights(&self, input: Tensor<2>, ends: &Messages, n: usize) -> Tensor<2> {
        let own = relu(two(&self.weights_mlp_1, input));
        let strongest = select(largest_at(own.clone(), &ends.to, n), &ends.to);
        sigmoid(two(&self.weights_mlp_2, Tensor::cat(vec![own, strongest], 1)))
    }
}

/// Two layers with a ReLU between them.
fn two(layers: &[Dense; 2], x: Tensor<2>) -> Tensor<2> {
    layers[1].forward(relu(layers[0].forward(x)))
}

/// The named rows.
fn select(x: Tensor<2>, rows: &[usize]) -> Tensor<2> {
    gathered(x, rows.len(), |values, width| {
        rows.iter().flat_map(|&r| values[r * width..][..width].iter().copied()).collect()
    })
}

/// For each of `n` nodes, the sum of the rows that go to it.
fn sum_at(x: Tensor<2>, to: &[usize], n: usize) -> Tensor<2> {
    folded(x, to, n, 0.0, |sum, v| sum + v)
}

/// For each of `n` nodes, the largest of the rows that go to it, column by column.
fn largest_at(x: Tensor<2>, to: &[usize], n: usize) -> Tensor<2> {
    folded(x, to, n, f32::NEG_INFINITY, f32::max)
}

fn folded(x: Tensor<2>, to: &[usize], n: usize, start: f32, fold: fn(f32, f32) -> f32) -> Tensor<2> {
    gathered(x, n, |values, width| {
        let mut out = vec![start; n * width];
        for (row, &node) in values.chunks_exact(width).zip(to) {
            out[node * width..][..width].iter_mut().zip(row).for_each(|(o, v)| *o = fold(*o, *v));
        }
        out
    })
}

/// A tensor of `rows` rows made from the numbers of `x` on the host: graphs are small, and
/// this order of summation does not depend on the backend.
fn gathered(x: Tensor<2>, rows: usize, make: impl FnOnce(&[f32], usize) -> Vec<f32>) -> Tensor<2> {
    let ([_, width], device) = (x.dims(), x.device());
    let data = x.into_data();
    let made = data
        .as_slice::<f32>()
        .map(|values| make(values, width))
        .unwrap_or_else(|_| vec![f32::NAN; rows * width]);
    Tensor::from_data(TensorData::new(made, [rows, width]), &device)
}
