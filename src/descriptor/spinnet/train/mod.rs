//! Training MiniSpinNet.
//!
//! A step draws pairs of patches that show one place in two scans, changes every patch at random
//! (turn, tilt, noise, density, holes), and goes down the gradient of the circle loss between all
//! of them. A run's folder holds `last.safetensors` (training can go on from it),
//! `best.safetensors` (the validation with the highest accuracy; the last step without one),
//! `final.safetensors` (the last step, without what a training needs to go on) and
//! `metrics.jsonl`. Every file is replaced whole. What a step draws depends on the seed and its
//! number alone, and all state is in `last.safetensors`: a resumed run gives the same bytes as one
//! that was never interrupted.

pub mod batch;
mod config;
mod learner;
mod pairs;
mod run;

pub use config::TrainConfig;
pub use pairs::{PairLengths, PairScene, PatchPair, PosedSurface, extract};
pub use run::{PairData, Record, TrainReport, train};

use super::weights::{Architecture, Layer, Norm, Weights};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The generator of one item of one step.
fn generator(seed: u64, step: u64, item: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ step.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    rng.set_stream(item);
    rng
}

/// A network before training: He's uniform filters, attention that starts out even.
pub fn initial_weights(architecture: &Architecture, seed: u64) -> Weights {
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
    Weights { layers: layers.collect(), architecture: architecture.clone() }
}

#[cfg(test)]
mod tests;
