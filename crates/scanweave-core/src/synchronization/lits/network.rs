//! One round of the graph network.

use super::weights::LitsWeights;
use rayon::prelude::*;

/// Width of a node's state.
pub const NODE: usize = 16;
/// Width of the state of the whole graph.
pub const GLOBAL: usize = 4;
/// Width of hidden layers.
pub const HIDDEN: usize = 256;
/// Rounds, with the same weights.
pub const ROUNDS: usize = 10;
/// Added to the length of a node's messages before it divides them.
const LENGTH_FLOOR: f32 = 1e-4;
/// Rows that go through a layer together.
const ROWS: usize = 16;

/// Where messages come from and go to, one a message.
pub(super) struct Messages {
    pub from: Vec<usize>,
    pub to: Vec<usize>,
}

/// What a round leaves.
pub(super) struct Round {
    /// States of the nodes, `[n,NODE]`.
    pub nodes: Rows,
    /// State of the graph, `[1,GLOBAL]`.
    pub global: Rows,
    /// Updates of the poses, `[n,6]`: translation part, then rotation vector, not yet bounded.
    pub updates: Rows,
}

/// A row-major matrix.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rows {
    width: usize,
    values: Vec<f32>,
}

impl Rows {
    /// `values` `[n·width]`; `width` is positive.
    pub fn new(width: usize, values: Vec<f32>) -> Self {
        Self { width, values }
    }

    /// Zeros, `[rows,width]`.
    pub fn zeros(rows: usize, width: usize) -> Self {
        Self::new(width, vec![0.0; rows * width])
    }

    /// The rows in order.
    pub fn iter(&self) -> std::slice::ChunksExact<'_, f32> {
        self.values.chunks_exact(self.width)
    }

    fn len(&self) -> usize {
        self.values.len() / self.width
    }

    fn row(&self, at: usize) -> &[f32] {
        &self.values[at * self.width..][..self.width]
    }

    fn map(mut self, f: impl Fn(f32) -> f32) -> Self {
        self.values.iter_mut().for_each(|v| *v = f(*v));
        self
    }

    /// The named columns.
    fn columns(&self, range: std::ops::Range<usize>) -> Self {
        Self::new(range.len(), self.iter().flat_map(|row| row[range.clone()].iter().copied()).collect())
    }

    /// Rows made one by one from slices laid side by side.
    fn beside<'a, const N: usize>(rows: usize, parts: impl Fn(usize) -> [&'a [f32]; N]) -> Self {
        let values: Vec<f32> = (0..rows).flat_map(|r| parts(r).concat()).collect();
        Self::new(values.len() / rows.max(1), values)
    }
}

/// y = x Wᵀ + b.
#[derive(Debug)]
struct Dense {
    /// `[in,out]`: one value of the input meets the weights of all outputs side by side.
    weight: Vec<f32>,
    /// `[out]`.
    bias: Vec<f32>,
}

impl Dense {
    fn new(weights: &LitsWeights, layer: &str) -> Self {
        let (weight, bias) = weights.layer(layer);
        let (outputs, inputs) = (bias.len(), weight.len() / bias.len().max(1));
        let transposed = (0..weight.len()).map(|at| weight[at % outputs * inputs + at / outputs]).collect();
        Self { weight: transposed, bias: bias.to_vec() }
    }

    fn forward(&self, x: &Rows) -> Rows {
        let outputs = self.bias.len();
        let mut y = Rows::zeros(x.len(), outputs);
        let chunks = y.values.par_chunks_mut(ROWS * outputs).zip(x.values.par_chunks(ROWS * x.width));
        chunks.for_each(|(ys, xs)| {
            pulp::Arch::new().dispatch(
                #[inline(always)]
                || {
                    for (y, x) in ys.chunks_exact_mut(outputs).zip(xs.chunks_exact(x.width)) {
                        y.copy_from_slice(&self.bias);
                        for (&v, weights) in x.iter().zip(self.weight.chunks_exact(outputs)) {
                            y.iter_mut().zip(weights).for_each(|(y, w)| *y += v * w);
                        }
                    }
                },
            );
        });
        y
    }
}

/// The layers, named as published.
#[derive(Debug)]
pub(super) struct GraphNetwork {
    node_mlp_1: [Dense; 2],
    node_mlp_2: [Dense; 2],
    weights_mlp_1: [Dense; 2],
    weights_mlp_2: [Dense; 2],
    global_mlp: [Dense; 2],
}

impl GraphNetwork {
    /// Lays the weights out.
    pub fn new(weights: &LitsWeights) -> Self {
        let pair = |name: &str| [0, 2].map(|at| Dense::new(weights, &format!("{name}.{at}")));
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
    pub fn round(&self, nodes: &Rows, global: &Rows, ends: &Messages, errors: &Rows) -> Round {
        let n = nodes.len();
        let mut mean = [0.0f32; NODE];
        nodes.iter().for_each(|row| mean.iter_mut().zip(row).for_each(|(m, v)| *m += v / n as f32));
        let global = two(&self.global_mlp, &Rows::beside(1, |_| [global.row(0), &mean[..]]));

        let input =
            Rows::beside(ends.to.len(), |m| [nodes.row(ends.from[m]), nodes.row(ends.to[m]), errors.row(m)]);
        let mut features = two(&self.node_mlp_1, &input).map(relu);
        let weights = self.weights(&input, ends, n);
        let width = features.width;
        for (row, weight) in features.values.chunks_exact_mut(width).zip(&weights.values) {
            row.iter_mut().for_each(|v| *v *= weight);
        }
        let mut sum = folded(&features, &ends.to, n, 0.0, |sum, v| sum + v);
        for row in sum.values.chunks_exact_mut(width) {
            let length = row.iter().map(|v| v * v).sum::<f32>().sqrt() + LENGTH_FLOOR;
            row.iter_mut().for_each(|v| *v /= length);
        }

        let out = two(&self.node_mlp_2, &Rows::beside(n, |i| [sum.row(i), nodes.row(i), global.row(0)]));
        let updates = out.columns(NODE..NODE + 6);
        let mut states = out.columns(0..NODE);
        states.values.iter_mut().zip(&nodes.values).for_each(|(s, old)| *s += old);
        Round { nodes: states, global, updates }
    }

    /// How much each message counts, `[m,1]`, in the light of the strongest at its node.
    fn weights(&self, input: &Rows, ends: &Messages, n: usize) -> Rows {
        let own = two(&self.weights_mlp_1, input).map(relu);
        let strongest = folded(&own, &ends.to, n, f32::NEG_INFINITY, f32::max);
        let both = Rows::beside(own.len(), |m| [own.row(m), strongest.row(ends.to[m])]);
        two(&self.weights_mlp_2, &both).map(|v| 1.0 / (1.0 + (-v).exp()))
    }
}

fn relu(v: f32) -> f32 {
    v.max(0.0)
}

/// Two layers with a ReLU between them.
fn two(layers: &[Dense; 2], x: &Rows) -> Rows {
    layers[1].forward(&layers[0].forward(x).map(relu))
}

/// For each of `n` nodes, the rows that go to it folded column by column, in their order.
fn folded(x: &Rows, to: &[usize], n: usize, start: f32, fold: fn(f32, f32) -> f32) -> Rows {
    let mut out = Rows::new(x.width, vec![start; n * x.width]);
    for (row, &node) in x.iter().zip(to) {
        out.values[node * x.width..][..x.width].iter_mut().zip(row).for_each(|(o, v)| *o = fold(*o, *v));
    }
    out
}
