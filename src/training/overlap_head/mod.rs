//! Training the overlap head.
//!
//! One scene a step: some of its scans, a crop of each, dropout on the crops' descriptors, global
//! features, and the smooth L1 loss between s_ij and the true overlap of the crops, over all pairs
//! (Li et al. 2025; the published training code of SGHR and IMVR where the paper is silent).
//!
//! A run's folder holds `last.safetensors` (after every epoch; training can go on from it),
//! `best.safetensors` (the epoch with the highest validation Spearman correlation, un-fused),
//! `metrics.jsonl` and `curves.svg`. Every file is replaced whole, so it is complete whenever the
//! process ends. What a step draws depends on the seed and the step's number alone, and all state
//! between epochs is in `last.safetensors`: a resumed run gives the same bytes as one that was
//! never interrupted.

mod batch;
mod config;
mod journal;
pub(crate) mod layers;
mod learner;
mod run;
mod start;
mod targets;
mod validation;

pub use batch::TrainingScene;
pub use config::{CentroidStart, TrainConfig};
pub use journal::Record;
pub use targets::overlap_matrix;
pub use validation::Validation;

use crate::Monitor;
use crate::evaluation::retrieval_scores::RetrievalScores;
use crate::retrieval::DescriptorTag;
use crate::{Error, Result};
use batch::PreparedScene;
use burn::tensor::Device;
use run::{Clock, Run};
use std::path::{Path, PathBuf};
use validation::Validator;

const STAGE: &str = "training";

/// What a head is trained on. The split is by scene, never by scan.
#[derive(Debug, Clone, Default)]
pub struct TrainingData {
    /// Scenes that steps are drawn from.
    pub train: Vec<TrainingScene>,
    /// Scenes that only score the result; may be empty, and then the best epoch is the last.
    pub valid: Vec<TrainingScene>,
    /// The descriptor of all features.
    pub descriptor: DescriptorTag,
}

/// What a training run came to.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainReport {
    /// Steps of this call (fewer than the run's when it was resumed).
    pub steps: usize,
    /// Mean duration of a step, milliseconds; 0 without steps.
    pub step_ms: f64,
    /// Share of the steps' time in which the network waited for its input (crops, dropout, targets).
    pub outside_share: f64,
    /// The whole log, of earlier calls too.
    pub records: Vec<Record>,
    /// The best epoch's checkpoint.
    pub best: PathBuf,
    /// The last epoch's checkpoint.
    pub last: PathBuf,
}

/// Trains a head and writes checkpoints, log and curves into `out_dir`, which must exist.
///
/// With `resume` it continues from `out_dir/last.safetensors`.
///
/// # Errors
/// When a setting or scene cannot be used; when `out_dir` holds a run and `resume` is not set, or
/// holds none or one of other settings or data and it is set; when a file cannot be written; when
/// the loss is no longer finite; when the user asks to stop.
pub fn train(
    data: &TrainingData,
    config: &TrainConfig,
    out_dir: &Path,
    resume: bool,
    monitor: &dyn Monitor,
) -> Result<TrainReport> {
    train_on(data, config, out_dir, resume, monitor, &Device::flex())
}

/// [`train`] on a device of the caller's choice, to compare backends.
///
/// # Errors
/// As [`train`].
pub fn train_on(
    data: &TrainingData,
    config: &TrainConfig,
    out_dir: &Path,
    resume: bool,
    monitor: &dyn Monitor,
    device: &Device,
) -> Result<TrainReport> {
    config.validate()?;
    let scenes = prepare(data, config)?;
    let validator = Validator::new(data, config, monitor)?;
    let mut run = if resume {
        Run::resume(data, config, out_dir, device)?
    } else {
        Run::start(data, config, out_dir, device, &validator)?
    };
    let (mut clock, done) = (Clock::default(), run.epoch);
    monitor.begin(STAGE, (config.epochs - done) * scenes.len());
    while run.epoch < config.epochs {
        let before = clock;
        let loss = run.epoch_of(&scenes, &mut clock, monitor)?;
        let validation = (!validator.is_empty() && run.validates(run.epoch))
            .then(|| validator.score(&run.learner.weights.head()))
            .transpose()?;
        run.finish_epoch(loss, clock.since(&before), validation)?;
    }
    monitor.end();
    Ok(TrainReport {
        steps: clock.steps,
        step_ms: clock.step_ms(),
        outside_share: clock.outside_share(),
        records: run.journal.records,
        best: run.best,
        last: run.last,
    })
}

fn prepare<'a>(data: &'a TrainingData, config: &TrainConfig) -> Result<Vec<PreparedScene<'a>>> {
    if data.train.is_empty() {
        return Err(Error::input("training data", "no scene", "at least one", "name scenes to train on"));
    }
    for scene in &data.valid {
        // Checked like the others, so that a bad scene is named before hours of training.
        PreparedScene::new(
            scene,
            data.descriptor.dim,
            &TrainConfig { min_scan_overlap: 0.0, ..config.clone() },
        )?;
        if data.train.iter().any(|s| s.name == scene.name) {
            return Err(Error::input(
                format!("scene {}", scene.name),
                "it among both training and validation scenes",
                "a split by scene",
                "leave it in one of the two",
            ));
        }
    }
    data.train.iter().map(|s| PreparedScene::new(s, data.descriptor.dim, config)).collect()
}
