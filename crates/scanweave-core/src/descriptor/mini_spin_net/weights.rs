//! The network's parameters as plain numbers, and their folding for inference.

use super::RADII;
use super::product::GROUP;
use crate::tensor_file::{Array, Arrays};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Added to a variance before its root, as in PyTorch.
const NORM_EPSILON: f32 = 1e-5;

/// Numbers of channels. Those of the published network are the default.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Architecture {
    /// Channels of the layer that every point goes through.
    pub point_channels: usize,
    /// Output channels of the convolutions; those of the last are the descriptor's dimension D.
    pub channels: Vec<usize>,
    /// Hidden channels of the attention.
    pub attention_channels: usize,
}

impl Default for Architecture {
    fn default() -> Self {
        let channels = vec![64, 64, 128, 128, 64, 64, 32, 32];
        Self { point_channels: 16, channels, attention_channels: 16 }
    }
}

impl Architecture {
    /// Descriptor dimension D.
    pub fn dim(&self) -> usize {
        self.channels.last().copied().unwrap_or(0)
    }

    /// What is wrong with it, if anything.
    pub fn fault(&self) -> Option<String> {
        let all = [self.point_channels, self.attention_channels];
        let bad = all.iter().chain(&self.channels).find(|&&n| n == 0 || n > 4096 || n % GROUP != 0);
        match bad {
            Some(n) => Some(format!("a layer of {n} channels, not a multiple of {GROUP} up to 4096")),
            None if self.channels.is_empty() => Some("no convolution".to_owned()),
            None => None,
        }
    }

    /// Inputs, outputs and taps of every layer in the order of [`Weights::layers`]: point layer,
    /// convolutions, two layers of attention.
    pub fn shapes(&self) -> Vec<LayerShape> {
        let shape = |name: String, inputs, outputs, taps| LayerShape { name, inputs, outputs, taps };
        let mut shapes = vec![shape("point".to_owned(), 3, self.point_channels, 1)];
        let mut inputs = self.point_channels * RADII;
        for (at, &outputs) in self.channels.iter().enumerate() {
            shapes.push(shape(format!("convolution.{at}"), inputs, outputs, 9));
            inputs = outputs;
        }
        shapes.push(shape("attention.0".to_owned(), inputs, self.attention_channels, 1));
        shapes.push(shape("attention.1".to_owned(), self.attention_channels, 1, 1));
        shapes
    }
}

/// Name and sizes of a layer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LayerShape {
    /// Name in files.
    pub name: String,
    /// Input channels.
    pub inputs: usize,
    /// Output channels.
    pub outputs: usize,
    /// Filter taps: 9 for a 3×3 convolution, 1 where every cell is on its own.
    pub taps: usize,
}

/// Batch normalisation: (x − mean)/√(variance + ε) · scale + shift.
#[derive(Debug, Clone, PartialEq)]
pub struct Norm {
    /// Running mean, `[outputs]`.
    pub mean: Vec<f32>,
    /// Running variance, `[outputs]`.
    pub variance: Vec<f32>,
    /// Scale and shift, `[outputs]` each; none for a layer without.
    pub affine: Option<(Vec<f32>, Vec<f32>)>,
}

/// A layer: filter, bias, and the normalisation behind them.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// `[outputs, inputs, taps]`; taps are (elevation, azimuth).
    pub weight: Vec<f32>,
    /// `[outputs]`.
    pub bias: Vec<f32>,
    /// None behind the last convolution.
    pub norm: Option<Norm>,
}

impl Layer {
    /// The same layer without a normalisation: weight and bias with the running one multiplied in.
    pub fn folded(&self) -> (Vec<f32>, Vec<f32>) {
        let Some(norm) = &self.norm else { return (self.weight.clone(), self.bias.clone()) };
        let per_output = self.weight.len() / self.bias.len().max(1);
        let (mut weight, mut bias) = (self.weight.clone(), self.bias.clone());
        for (o, row) in weight.chunks_exact_mut(per_output).enumerate() {
            let (scale, shift) = norm.affine.as_ref().map_or((1.0, 0.0), |(s, t)| (s[o], t[o]));
            let factor = scale / (norm.variance[o] + NORM_EPSILON).sqrt();
            row.iter_mut().for_each(|w| *w *= factor);
            bias[o] = (bias[o] - norm.mean[o]) * factor + shift;
        }
        (weight, bias)
    }
}

/// All parameters of a network.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    /// Numbers of channels.
    pub architecture: Architecture,
    /// In the order of [`Architecture::shapes`].
    pub layers: Vec<Layer>,
}

impl Weights {
    /// A network before training: He's uniform filters, attention that starts out even.
    pub fn initial(architecture: &Architecture, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let last = architecture.channels.len();
        let layers = architecture.shapes().into_iter().enumerate().map(|(at, shape)| {
            let inputs = shape.inputs * shape.taps;
            let bound = (6.0 / inputs as f32).sqrt();
            let weight = (0..inputs * shape.outputs).map(|_| rng.random_range(-bound..bound)).collect();
            let is_attention = at > last;
            // The published point layer has a bias; ours starts with one, so that a cell's channels
            // tell how many points there are.
            let bias = match at {
                0 => (0..shape.outputs).map(|_| rng.random_range(-0.3..0.3)).collect(),
                _ if at == last + 2 => vec![1.0; shape.outputs],
                _ => vec![0.0; shape.outputs],
            };
            let norm = (at > 0 && at < last && !is_attention).then(|| Norm {
                mean: vec![0.0; shape.outputs],
                variance: vec![1.0; shape.outputs],
                affine: None,
            });
            Layer { weight, bias, norm }
        });
        Self { layers: layers.collect(), architecture: architecture.clone() }
    }

    /// As named arrays.
    pub fn to_arrays(&self) -> Arrays {
        let mut arrays = Arrays::new();
        for (shape, layer) in self.architecture.shapes().iter().zip(&self.layers) {
            let LayerShape { name, inputs, outputs, taps } = shape;
            let mut add = |part: &str, shape: &[usize], values: &[f32]| {
                arrays.insert(format!("{name}.{part}"), Array::new(shape, values.to_vec()));
            };
            add("weight", &[*outputs, *inputs, *taps], &layer.weight);
            add("bias", &[*outputs], &layer.bias);
            if let Some(norm) = &layer.norm {
                add("norm.mean", &[*outputs], &norm.mean);
                add("norm.variance", &[*outputs], &norm.variance);
                if let Some((scale, shift)) = &norm.affine {
                    add("norm.scale", &[*outputs], scale);
                    add("norm.shift", &[*outputs], shift);
                }
            }
        }
        arrays
    }

    /// From named arrays; arrays of other names are left alone.
    ///
    /// # Errors
    /// What was found where a shape does not fit, as a phrase for a message.
    pub fn from_arrays(architecture: &Architecture, arrays: &Arrays) -> Result<Self, String> {
        if let Some(fault) = architecture.fault() {
            return Err(fault);
        }
        let layers = architecture.shapes().into_iter().map(|shape| layer_of(&shape, arrays));
        Ok(Self { architecture: architecture.clone(), layers: layers.collect::<Result<_, _>>()? })
    }
}

fn layer_of(shape: &LayerShape, arrays: &Arrays) -> Result<Layer, String> {
    let LayerShape { name, inputs, outputs, taps } = shape;
    let find = |part: &str| arrays.get(&format!("{name}.{part}"));
    let take = |part: &str, expected: &[usize]| match find(part) {
        Some(array) if array.shape == expected => Ok(array.values.clone()),
        Some(array) => Err(format!("{name}.{part} of shape {:?}, not {expected:?}", array.shape)),
        None => Err(format!("no {name}.{part}")),
    };
    let norm = match find("norm.mean") {
        None => None,
        Some(_) => Some(Norm {
            mean: take("norm.mean", &[*outputs])?,
            variance: non_negative(take("norm.variance", &[*outputs])?, name)?,
            affine: match find("norm.scale") {
                None => None,
                Some(_) => Some((take("norm.scale", &[*outputs])?, take("norm.shift", &[*outputs])?)),
            },
        }),
    };
    Ok(Layer { weight: take("weight", &[*outputs, *inputs, *taps])?, bias: take("bias", &[*outputs])?, norm })
}

fn non_negative(variance: Vec<f32>, name: &str) -> Result<Vec<f32>, String> {
    match variance.iter().find(|v| **v < 0.0) {
        Some(v) => Err(format!("{name} with a variance of {v}")),
        None => Ok(variance),
    }
}
