//! The layer that turns local descriptors into one global feature a scan.

use super::gem::{Gem, GemConfig, mean_pooling};
use super::netvlad::{NetVlad, NetVladWeights, values};
use crate::error::{Error, Result};
use crate::monitor::Monitor;
use crate::scan::Descriptors;
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use rayon::prelude::*;

/// Parameters of a pooling head as plain numbers: what a checkpoint holds.
#[derive(Debug, Clone, PartialEq)]
pub enum HeadWeights {
    /// NetVLAD.
    NetVlad(NetVladWeights),
    /// Generalised mean.
    Gem {
        /// The layer's settings, with its learnt exponent.
        config: GemConfig,
        /// Descriptor dimension D it was trained for.
        dim: usize,
    },
}

impl HeadWeights {
    /// Descriptor dimension D.
    pub fn dim(&self) -> usize {
        match self {
            HeadWeights::NetVlad(w) => w.dim,
            HeadWeights::Gem { dim, .. } => *dim,
        }
    }

    /// The trainable parameters, row-major, in the order of [`Head::gradients`].
    pub fn parameters(&self) -> Vec<&[f32]> {
        match self {
            HeadWeights::NetVlad(w) => vec![&w.weight, &w.bias, &w.centroids],
            HeadWeights::Gem { config, .. } => vec![std::slice::from_ref(&config.power)],
        }
    }

    /// [`parameters`](Self::parameters), to be changed.
    pub fn parameters_mut(&mut self) -> Vec<&mut [f32]> {
        match self {
            HeadWeights::NetVlad(w) => vec![&mut w.weight, &mut w.bias, &mut w.centroids],
            HeadWeights::Gem { config, .. } => vec![std::slice::from_mut(&mut config.power)],
        }
    }

    /// Puts the parameters on a device.
    pub fn init(&self, device: &Device) -> Head {
        match self {
            HeadWeights::NetVlad(w) => Head::NetVlad(w.init(device)),
            HeadWeights::Gem { config, .. } => Head::Gem(config.init(device)),
        }
    }
}

/// A pooling layer, trained or not.
#[derive(Debug, Clone)]
pub enum Head {
    /// NetVLAD.
    NetVlad(NetVlad),
    /// Generalised mean.
    Gem(Gem),
    /// Plain mean, which has nothing to learn.
    Mean,
}

impl Head {
    /// Global feature of one scan.
    ///
    /// # Shapes
    /// - descriptors `[n,D]`, n ≥ 1
    /// - output `[F]`, unit length; F = K·D for NetVLAD, D otherwise
    pub fn forward(&self, descriptors: Tensor<2>) -> Tensor<1> {
        match self {
            Head::NetVlad(layer) => layer.forward(descriptors),
            Head::Gem(layer) => layer.forward(descriptors),
            Head::Mean => mean_pooling(descriptors),
        }
    }

    /// Gradient of every trainable parameter, row-major, in the order of
    /// [`HeadWeights::parameters`]; empty where a parameter took no part.
    pub fn gradients(&self, gradients: &Gradients) -> Vec<Vec<f32>> {
        fn of<const D: usize>(parameter: Tensor<D>, gradients: &Gradients) -> Vec<f32> {
            parameter.grad(gradients).map(values).unwrap_or_default()
        }
        match self {
            Head::NetVlad(layer) => vec![
                of(layer.weight.val(), gradients),
                of(layer.bias.val(), gradients),
                of(layer.centroids.val(), gradients),
            ],
            Head::Gem(layer) => vec![of(layer.power.val(), gradients)],
            Head::Mean => Vec::new(),
        }
    }
}

/// Global features of all scans on the CPU; `None` for a scan without descriptors.
///
/// # Errors
/// [`Error::Interrupted`], or an input error when a feature comes out as not finite.
pub fn global_features(
    head: &Head,
    scans: &[&Descriptors],
    monitor: &dyn Monitor,
) -> Result<Vec<Option<Vec<f32>>>> {
    const STAGE: &str = "global features";
    monitor.begin(STAGE, scans.len());
    let device = Device::flex();
    let result = scans
        .par_iter()
        .enumerate()
        .map(|(i, scan)| {
            monitor.check(STAGE)?;
            let feature = (!scan.is_empty()).then(|| {
                let data = TensorData::new(scan.values().to_vec(), [scan.len(), scan.dim()]);
                values(head.forward(Tensor::from_data(data, &device)))
            });
            monitor.advance(1);
            if feature.as_ref().is_some_and(|f| f.iter().any(|v| !v.is_finite())) {
                return Err(Error::input(
                    format!("global feature of scan {i}"),
                    "a value that is not finite",
                    "finite values",
                    "check the weights of the checkpoint and the descriptors of this scan",
                ));
            }
            Ok(feature)
        })
        .collect();
    monitor.end();
    result
}
