//! The layer that turns local descriptors into one global feature a scan.

use super::gem::{Gem, mean_pooling};
use super::netvlad::NetVlad;
use crate::error::{Error, Result};
use crate::monitor::Monitor;
use crate::scan::Descriptors;
use rayon::prelude::*;

/// Parameters of a trainable head: what a checkpoint holds.
#[derive(Debug, Clone, PartialEq)]
pub enum HeadWeights {
    /// NetVLAD.
    NetVlad(NetVlad),
    /// Generalised mean.
    Gem {
        /// The layer, with its learnt exponent.
        layer: Gem,
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

    /// The trainable parameters, row-major: w, b, c of NetVLAD, p of the generalised mean.
    pub fn parameters(&self) -> Vec<&[f32]> {
        match self {
            HeadWeights::NetVlad(w) => vec![&w.weight, &w.bias, &w.centroids],
            HeadWeights::Gem { layer, .. } => vec![std::slice::from_ref(&layer.power)],
        }
    }

    /// [`parameters`](Self::parameters), to be changed.
    pub fn parameters_mut(&mut self) -> Vec<&mut [f32]> {
        match self {
            HeadWeights::NetVlad(w) => vec![&mut w.weight, &mut w.bias, &mut w.centroids],
            HeadWeights::Gem { layer, .. } => vec![std::slice::from_mut(&mut layer.power)],
        }
    }

    /// The head with these weights.
    pub fn head(&self) -> Head {
        match self {
            HeadWeights::NetVlad(layer) => Head::NetVlad(layer.clone()),
            HeadWeights::Gem { layer, .. } => Head::Gem(*layer),
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
    pub fn global_feature(&self, descriptors: &Descriptors) -> Vec<f32> {
        match self {
            Head::NetVlad(layer) => layer.global_feature(descriptors),
            Head::Gem(layer) => layer.global_feature(descriptors),
            Head::Mean => mean_pooling(descriptors),
        }
    }
}

/// Global features of all scans; `None` for a scan without descriptors.
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
    let result = scans
        .par_iter()
        .enumerate()
        .map(|(i, scan)| {
            monitor.check(STAGE)?;
            let feature = (!scan.is_empty()).then(|| head.global_feature(scan));
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
