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

pub(crate) mod batch;
mod config;
mod learner;
mod module;
mod pairs;
mod run;

pub use config::TrainConfig;
pub use module::{MiniSpinNet, Mode};
pub use pairs::{PairLengths, PairScene, PatchPair, PosedSurface, extract};
pub use run::{PairData, Record, TrainReport, train};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The generator of one item of one step.
fn generator(seed: u64, step: u64, item: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ step.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    rng.set_stream(item);
    rng
}

#[cfg(test)]
mod parity_tests;
#[cfg(test)]
mod tests;
