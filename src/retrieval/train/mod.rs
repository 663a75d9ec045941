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
mod learner;
mod targets;
mod validation;

pub use batch::TrainingScene;
pub use config::{CentroidStart, TrainConfig};
pub use journal::Record;
pub use targets::overlap_matrix;
pub use validation::Validation;

use super::checkpoint::{Checkpoint, CheckpointMeta, DataSummary, FORMAT_VERSION, OptimizerState};
use super::gem::GemConfig;
use super::head::HeadWeights;
use super::kmeans::{KmeansConfig, kmeans};
use super::netvlad::NetVladConfig;
use super::scores::RetrievalScores;
use super::{DescriptorTag, SimilaritySource, gem_shift, generator};
use crate::error::{Error, Result};
use crate::monitor::Monitor;
use batch::PreparedScene;
use burn::tensor::Device;
use journal::Journal;
use learner::Learner;
use rand::seq::SliceRandom;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use validation::Validator;

const STAGE: &str = "training";
const BEST: &str = "best_spearman";

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
    /// Share of the steps' time spent outside the network (crops, dropout, targets).
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
            .then(|| validator.score(&run.learner.weights.init(&Device::flex())))
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

/// Time spent in steps.
#[derive(Debug, Clone, Copy, Default)]
struct Clock {
    steps: usize,
    total: Duration,
    outside: Duration,
}

impl Clock {
    fn since(&self, before: &Clock) -> Clock {
        Clock {
            steps: self.steps - before.steps,
            total: self.total - before.total,
            outside: self.outside - before.outside,
        }
    }

    fn step_ms(&self) -> f64 {
        self.total.as_secs_f64() * 1e3 / self.steps.max(1) as f64
    }

    fn outside_share(&self) -> f64 {
        self.outside.as_secs_f64() / self.total.as_secs_f64().max(1e-12)
    }
}

/// A run between epochs.
struct Run<'a> {
    config: &'a TrainConfig,
    data: &'a TrainingData,
    summary: DataSummary,
    learner: Learner,
    /// Epochs done.
    epoch: usize,
    /// Scores of the last validation, and the best Spearman correlation so far.
    metrics: BTreeMap<String, f64>,
    journal: Journal,
    best: PathBuf,
    last: PathBuf,
}

impl<'a> Run<'a> {
    fn start(
        data: &'a TrainingData,
        config: &'a TrainConfig,
        out_dir: &Path,
        device: &Device,
        validator: &Validator<'_>,
    ) -> Result<Self> {
        let (best, last) = checkpoints(out_dir);
        if last.exists() || best.exists() {
            return Err(Error::OutputExists { path: out_dir.to_path_buf() });
        }
        let weights = initial_weights(data, config);
        let learner = Learner::new(weights, OptimizerState::default(), config, device);
        let mut journal = Journal::new(out_dir);
        if !validator.is_empty() {
            let baselines = validator.baselines(config)?;
            let record = |(name, validation)| Record::Baseline { name, validation };
            journal.records = baselines.into_iter().map(record).collect();
        }
        let summary = summary_of(data);
        Ok(Self { config, data, summary, learner, epoch: 0, metrics: BTreeMap::new(), journal, best, last })
    }

    fn resume(
        data: &'a TrainingData,
        config: &'a TrainConfig,
        out_dir: &Path,
        device: &Device,
    ) -> Result<Self> {
        let (best, last) = checkpoints(out_dir);
        let checkpoint = Checkpoint::load_for(&last, &data.descriptor)?;
        let refuse =
            |found: String, expected: &str, remedy: &str| Err(Error::file(&last, found, expected, remedy));
        let recipe: TrainConfig = match serde_json::from_value(checkpoint.meta.recipe.clone()) {
            Ok(recipe) => recipe,
            Err(e) => {
                return refuse(
                    format!("no training settings ({e})"),
                    "a checkpoint of a training run",
                    "start a run",
                );
            }
        };
        if recipe != *config {
            let keys = differing_keys(&recipe, config);
            let remedy = "use the settings it was started with, or start a new run";
            return refuse(format!("a run with other settings ({keys})"), "the same settings", remedy);
        }
        let summary = summary_of(data);
        if checkpoint.meta.data != summary {
            let remedy = "give it the scenes and features it was started with, or start a new run";
            return refuse("a run on other scenes or features".into(), "the same data", remedy);
        }
        let Some(state) = checkpoint.optimizer else {
            return refuse("no optimiser state".into(), "a checkpoint to go on from", "start a new run");
        };
        Ok(Self {
            config,
            data,
            summary,
            learner: Learner::new(checkpoint.weights, state, config, device),
            epoch: checkpoint.meta.epoch,
            metrics: checkpoint.meta.metrics,
            journal: Journal::resume(out_dir, checkpoint.meta.epoch)?,
            best,
            last,
        })
    }

    /// One pass over the scenes in a random order; the mean loss.
    fn epoch_of(
        &mut self,
        scenes: &[PreparedScene<'_>],
        clock: &mut Clock,
        monitor: &dyn Monitor,
    ) -> Result<f64> {
        let mut order: Vec<usize> = (0..scenes.len()).collect();
        order.shuffle(&mut generator(self.config.seed, "order of an epoch", self.epoch as u64));
        let learning_rate = self.config.learning_rate_at(self.epoch);
        let mut sum = 0.0;
        for scene in order {
            monitor.check(STAGE)?;
            let start = Instant::now();
            let batch = scenes[scene].batch(self.learner.state.steps, self.config)?;
            clock.outside += start.elapsed();
            let loss = self.learner.step(&batch, learning_rate)?;
            clock.total += start.elapsed();
            clock.steps += 1;
            sum += loss;
            monitor.note(&format!("loss {loss:.5}, learning rate {learning_rate:.2e}"));
            monitor.advance(1);
        }
        Ok(sum / scenes.len() as f64)
    }

    /// Every few epochs, and after the last one.
    fn validates(&self, epoch: usize) -> bool {
        (epoch + 1).is_multiple_of(self.config.validate_every) || epoch + 1 == self.config.epochs
    }

    fn finish_epoch(&mut self, loss: f64, clock: Clock, validation: Option<Validation>) -> Result<()> {
        let learning_rate = self.config.learning_rate_at(self.epoch);
        self.epoch += 1;
        let mut improved = self.data.valid.is_empty();
        if let Some(v) = &validation {
            let m = &v.mean;
            let scores = [
                ("mae", m.mae),
                ("spearman", m.spearman),
                ("recall_overlap_30", m.recall_overlap_30),
                ("recall_overlap_10", m.recall_overlap_10),
            ];
            self.metrics.extend(scores.map(|(k, v)| (k.to_owned(), short(v))));
            let spearman = short(m.spearman);
            improved = self.metrics.get(BEST).is_none_or(|&best| spearman > best);
            if improved {
                self.metrics.insert(BEST.into(), spearman);
            }
        }
        // Best before last: a run killed in between does the epoch again and writes the same best.
        if improved {
            self.checkpoint(None).save(&self.best)?;
        }
        self.checkpoint(Some(self.learner.state.clone())).save(&self.last)?;
        self.journal.records.push(Record::Epoch {
            epoch: self.epoch,
            loss,
            learning_rate,
            step_ms: clock.step_ms(),
            outside_share: clock.outside_share(),
            validation,
        });
        self.journal.save()
    }

    fn checkpoint(&self, optimizer: Option<OptimizerState>) -> Checkpoint {
        let head = if self.config.head == SimilaritySource::Gem { "gem" } else { "netvlad" };
        Checkpoint {
            meta: CheckpointMeta {
                format_version: FORMAT_VERSION,
                name: format!("{head}-{}", self.data.descriptor.name),
                architecture: Checkpoint::architecture_of(&self.learner.weights),
                descriptor: self.data.descriptor.clone(),
                // A config of plain numbers and names always has a JSON form.
                recipe: serde_json::to_value(self.config).unwrap_or_default(),
                data: self.summary.clone(),
                metrics: self.metrics.clone(),
                epoch: self.epoch,
            },
            weights: self.learner.weights.clone(),
            optimizer,
        }
    }
}

fn checkpoints(out_dir: &Path) -> (PathBuf, PathBuf) {
    (out_dir.join("best.safetensors"), out_dir.join("last.safetensors"))
}

/// Six decimals: the JSON of a checkpoint gives such a number back exactly.
fn short(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

fn initial_weights(data: &TrainingData, config: &TrainConfig) -> HeadWeights {
    let dim = data.descriptor.dim;
    let scans = data.train.iter().flat_map(|s| &s.features).filter(|f| !f.is_empty());
    let sets: Vec<&[f32]> = scans.map(|f| f.descriptors.values()).collect();
    if config.head == SimilaritySource::Gem {
        let layer =
            GemConfig { power: config.gem_power as f32, shift: gem_shift(&sets), ..GemConfig::default() };
        return HeadWeights::Gem { config: layer, dim };
    }
    let layer = NetVladConfig {
        clusters: config.clusters,
        dim,
        alpha: config.alpha as f32,
        bias: config.bias,
        seed: config.seed,
    };
    let device = Device::flex();
    HeadWeights::NetVlad(match config.centroids {
        CentroidStart::Uniform => layer.init(&device).weights(),
        CentroidStart::Kmeans => {
            let settings = KmeansConfig {
                clusters: config.clusters,
                sample: config.kmeans_sample,
                rounds: config.kmeans_rounds,
                seed: config.seed,
            };
            layer.init_from(&kmeans(&sets, dim, &settings), &device).weights()
        }
    })
}

fn summary_of(data: &TrainingData) -> DataSummary {
    let names = |scenes: &[TrainingScene]| scenes.iter().map(|s| s.name.clone()).collect();
    let scans = |scenes: &[TrainingScene]| scenes.iter().map(|s| s.features.len()).sum();
    let mut hasher = blake3::Hasher::new();
    let mut add = |values: &[f32]| {
        hasher.update(&(values.len() as u64).to_le_bytes());
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        hasher.update(&bytes);
    };
    for scene in data.train.iter().chain(&data.valid) {
        for (features, pose) in scene.features.iter().zip(&scene.world_from_scan) {
            let points: Vec<f32> = features.keypoints.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
            add(&points);
            add(features.descriptors.values());
            let matrix: Vec<f32> = pose.to_homogeneous().iter().map(|&v| v as f32).collect();
            add(&matrix);
        }
    }
    DataSummary {
        train_scenes: names(&data.train),
        valid_scenes: names(&data.valid),
        train_scans: scans(&data.train),
        valid_scans: scans(&data.valid),
        hash: hasher.finalize().to_hex().to_string(),
    }
}

/// Names of the settings in which two recipes differ.
fn differing_keys(a: &TrainConfig, b: &TrainConfig) -> String {
    let value = |c: &TrainConfig| serde_json::to_value(c).unwrap_or_default();
    let (a, b) = (value(a), value(b));
    let keys: Vec<&str> = a
        .as_object()
        .into_iter()
        .flatten()
        .filter(|(key, v)| b.get(key.as_str()) != Some(*v))
        .map(|(key, _)| key.as_str())
        .collect();
    keys.join(", ")
}
