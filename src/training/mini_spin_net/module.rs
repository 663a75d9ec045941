//! The network as a Burn module: for training, and as a second implementation of what
//! [`crate::descriptor::mini_spin_net::Network`] computes.

use crate::descriptor::mini_spin_net::{AZIMUTHS, Architecture, ELEVATIONS, Layer, Norm, RADII, Weights};
use burn::module::{Module, Param};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Gradients, Int, Tensor, TensorData};

/// Cells of one shell.
pub const MAP: usize = ELEVATIONS * AZIMUTHS;
const TAPS: usize = 9;
const NORM_EPSILON: f64 = 1e-5;
/// Floor of a descriptor's norm before it divides.
const LENGTH_FLOOR: f64 = 1e-8;

/// Mean and variance of every channel behind a convolution.
pub type Statistics = (Vec<f32>, Vec<f32>);

/// Filter and bias.
#[derive(Module, Debug)]
pub struct Affine {
    /// `[taps · inputs, outputs]`.
    pub weight: Param<Tensor<2>>,
    /// `[outputs]`.
    pub bias: Param<Tensor<1>>,
}

impl Affine {
    fn new(weight: Vec<f32>, bias: Vec<f32>, device: &Device) -> Self {
        let shape = [weight.len() / bias.len().max(1), bias.len()];
        let length = [bias.len()];
        Self {
            weight: Param::from_data(TensorData::new(weight, shape), device),
            bias: Param::from_data(TensorData::new(bias, length), device),
        }
    }

    fn forward(&self, rows: Tensor<2>) -> Tensor<2> {
        rows.matmul(self.weight.val()) + self.bias.val().unsqueeze::<2>()
    }
}

/// MiniSpinNet; [`crate::descriptor::mini_spin_net`] has metadata and stages.
///
/// Maps are matrices with a row a cell, `[n · 7 · 20, channels]`, and a convolution is one matrix
/// product with the nine neighbours of every cell side by side. Normalisations behind the
/// convolutions stay apart while training; those of the point layer and the attention (imported
/// networks have them) are multiplied into their filters.
#[derive(Module, Debug)]
pub struct MiniSpinNet {
    /// `[3, point channels]`.
    pub point: Affine,
    /// One a convolution.
    pub convolutions: Vec<Affine>,
    /// Hidden and output layer.
    pub attention: Vec<Affine>,
}

/// Which statistics normalise.
#[derive(Debug, Clone, Copy)]
pub enum Mode<'a> {
    /// Those of the batch: training.
    Batch,
    /// The running ones, one a normalised convolution: use.
    Running(&'a [Statistics]),
}

impl MiniSpinNet {
    /// Puts the parameters on a device.
    pub fn new(weights: &Weights, device: &Device) -> Self {
        let last = weights.architecture.channels.len();
        let folded = |at: usize| {
            let (weight, bias) = weights.layers[at].folded();
            Affine::new(taps_first(&weight, bias.len(), 1), bias, device)
        };
        let convolution = |layer: &Layer| {
            Affine::new(taps_first(&layer.weight, layer.bias.len(), TAPS), layer.bias.clone(), device)
        };
        Self {
            point: folded(0),
            convolutions: weights.layers[1..=last].iter().map(convolution).collect(),
            attention: vec![folded(last + 1), folded(last + 2)],
        }
    }
}

/// Running statistics of the normalised convolutions.
pub fn statistics_of(weights: &Weights) -> Vec<Statistics> {
    let norms = weights.layers.iter().skip(1).take(weights.architecture.channels.len());
    norms.filter_map(|l| l.norm.as_ref()).map(|n| (n.mean.clone(), n.variance.clone())).collect()
}

/// The weights that parameters (in the order of [`MiniSpinNet::gradients`]) and running
/// statistics make.
pub fn weights_from(
    architecture: &Architecture,
    parameters: &[Vec<f32>],
    statistics: &[Statistics],
) -> Weights {
    let shapes = architecture.shapes();
    let layers = shapes.iter().zip(parameters.chunks(2)).enumerate().map(|(at, (shape, pair))| {
        let statistics = at.checked_sub(1).and_then(|c| statistics.get(c));
        let norm = statistics.map(|(mean, variance)| Norm {
            mean: mean.clone(),
            variance: variance.clone(),
            affine: None,
        });
        let [weight, bias] = pair else { return Layer { weight: vec![], bias: vec![], norm } };
        Layer { weight: outputs_first(weight, shape.outputs, shape.taps), bias: bias.clone(), norm }
    });
    Weights { layers: layers.collect(), architecture: architecture.clone() }
}

/// The parameters of [`MiniSpinNet::new`], in the order of [`MiniSpinNet::gradients`].
pub fn parameters_of(weights: &Weights) -> Vec<Vec<f32>> {
    let last = weights.architecture.channels.len();
    let layers = weights.layers.iter().enumerate();
    layers
        .flat_map(|(at, layer)| {
            let is_convolution = (1..=last).contains(&at);
            let (weight, bias) =
                if is_convolution { (layer.weight.clone(), layer.bias.clone()) } else { layer.folded() };
            [taps_first(&weight, bias.len(), if is_convolution { TAPS } else { 1 }), bias]
        })
        .collect()
}

/// `[outputs, inputs, taps]` as `[taps, inputs, outputs]`.
fn taps_first(weight: &[f32], outputs: usize, taps: usize) -> Vec<f32> {
    let inputs = weight.len() / (outputs * taps).max(1);
    let at = |tap: usize, input: usize, output: usize| weight[(output * inputs + input) * taps + tap];
    let all = (0..taps).flat_map(|t| (0..inputs).map(move |i| (t, i)));
    all.flat_map(|(t, i)| (0..outputs).map(move |o| (t, i, o))).map(|(t, i, o)| at(t, i, o)).collect()
}

/// `[taps, inputs, outputs]` as `[outputs, inputs, taps]`.
fn outputs_first(weight: &[f32], outputs: usize, taps: usize) -> Vec<f32> {
    let inputs = weight.len() / (outputs * taps).max(1);
    let mut result = vec![0.0; weight.len()];
    for (at, value) in weight.iter().enumerate() {
        let (tap, input, output) = (at / (inputs * outputs), at / outputs % inputs, at % outputs);
        result[(output * inputs + input) * taps + tap] = *value;
    }
    result
}

impl MiniSpinNet {
    /// Descriptors of patches, and the batch's statistics behind every normalised convolution.
    ///
    /// # Shapes
    /// - picked `[n · 7 · 20, 3 · point channels, 3]`: for every cell and channel of the point
    ///   layer, shell by shell, the point at which the channel is largest
    ///   (`super::batch` picks it; the maximum passes its gradient to that point alone)
    /// - output `[n, D]`, unit rows
    pub fn forward(&self, picked: Tensor<3>, mode: Mode<'_>) -> (Tensor<2>, Vec<Statistics>) {
        let device = picked.device();
        let weight = self.point.weight.val().transpose();
        let weight = Tensor::cat(vec![weight; RADII], 0).unsqueeze::<3>();
        let bias = Tensor::cat(vec![self.point.bias.val(); RADII], 0).unsqueeze::<2>();
        let [cells, channels, _] = picked.dims();
        let mut maps = relu((picked * weight).sum_dim(2).reshape([cells, channels]) + bias);
        let around = Tensor::<1, Int>::from_data(TensorData::from(around(cells / MAP).as_slice()), &device);
        let mut statistics = Vec::new();
        for (at, layer) in self.convolutions.iter().enumerate() {
            let [_, channels] = maps.dims();
            // Beyond the first and last elevation lies the row of zeros.
            let padded = Tensor::cat(vec![maps, Tensor::zeros([1, channels], &device)], 0);
            let columns = padded.select(0, around.clone()).reshape([cells, TAPS * channels]);
            maps = layer.forward(columns);
            if at + 1 < self.convolutions.len() {
                let (normalised, own) = normalise(maps, mode, at);
                maps = relu(normalised);
                statistics.extend(own);
            }
        }
        (self.pool(maps, cells / MAP), statistics)
    }

    fn pool(&self, maps: Tensor<2>, n: usize) -> Tensor<2> {
        let attention = self.attention.iter().fold(maps.clone(), |x, layer| relu(layer.forward(x)));
        let [_, dim] = maps.dims();
        let mean = (maps * attention).reshape([n, MAP, dim]).mean_dim(1).reshape([n, dim]);
        let length = (mean.clone() * mean.clone()).sum_dim(1).clamp_min(LENGTH_FLOOR * LENGTH_FLOOR).sqrt();
        mean / length
    }

    /// Gradient of every parameter, row-major: weight and bias of every layer in order; empty
    /// where a parameter took no part.
    pub fn gradients(&self, gradients: &Gradients) -> Vec<Vec<f32>> {
        let layers = std::iter::once(&self.point).chain(&self.convolutions).chain(&self.attention);
        layers
            .flat_map(|layer| {
                let weight = layer.weight.val().grad(gradients).map(values).unwrap_or_default();
                [weight, layer.bias.val().grad(gradients).map(values).unwrap_or_default()]
            })
            .collect()
    }
}

/// (x − mean)/√(variance + ε) by channel, and the batch's own statistics where they were used.
fn normalise(rows: Tensor<2>, mode: Mode<'_>, at: usize) -> (Tensor<2>, Option<Statistics>) {
    match mode {
        Mode::Batch => {
            let mean = rows.clone().mean_dim(0);
            let centred = rows - mean.clone();
            let variance = (centred.clone() * centred.clone()).mean_dim(0);
            let own = (values(mean.inner()), values(variance.clone().inner()));
            (centred / variance.add_scalar(NORM_EPSILON).sqrt(), Some(own))
        }
        Mode::Running(all) => {
            let Some((mean, variance)) = all.get(at) else { return (rows, None) };
            let row =
                |v: &[f32]| Tensor::<1>::from_data(TensorData::from(v), &rows.device()).unsqueeze::<2>();
            let (mean, variance) = (row(mean), row(variance));
            ((rows - mean) / variance.add_scalar(NORM_EPSILON).sqrt(), None)
        }
    }
}

/// For every cell of `n` maps its nine neighbours (elevation, then azimuth) as rows; `n · 140`
/// stands for those outside.
fn around(n: usize) -> Vec<i32> {
    let outside = (n * MAP) as i32;
    let mut rows = Vec::with_capacity(n * MAP * TAPS);
    for map in 0..n {
        for cell in 0..MAP {
            for tap in 0..TAPS {
                let elevation = (cell / AZIMUTHS + tap / 3).checked_sub(1).filter(|&e| e < ELEVATIONS);
                let azimuth = (cell % AZIMUTHS + tap % 3 + AZIMUTHS - 1) % AZIMUTHS;
                rows.push(elevation.map_or(outside, |e| (map * MAP + e * AZIMUTHS + azimuth) as i32));
            }
        }
    }
    rows
}

/// The numbers of a single-precision tensor.
pub(super) fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().convert::<f32>().try_into_vec().unwrap_or_default()
}
