//! A run, epoch by epoch.

use super::batch::PreparedScene;
use super::journal::{Journal, Record};
use super::learner::Learner;
use super::start::{differing_keys, initial_weights, summary_of};
use super::validation::{Validation, Validator};
use super::{STAGE, TrainConfig, TrainingData};
use crate::Monitor;
use crate::random::generator;
use crate::retrieval::SimilaritySource;
use crate::retrieval::{Checkpoint, CheckpointMeta, DataSummary, FORMAT_VERSION, OptimizerState};
use crate::training::run_folder;
use crate::{Error, Result};
use burn::tensor::Device;
use rand::seq::SliceRandom;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const BEST: &str = "best_spearman";

/// Time spent in steps.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Clock {
    pub steps: usize,
    total: Duration,
    outside: Duration,
}

impl Clock {
    pub fn since(&self, before: &Clock) -> Clock {
        Clock {
            steps: self.steps - before.steps,
            total: self.total - before.total,
            outside: self.outside - before.outside,
        }
    }

    pub fn step_ms(&self) -> f64 {
        self.total.as_secs_f64() * 1e3 / self.steps.max(1) as f64
    }

    pub fn outside_share(&self) -> f64 {
        self.outside.as_secs_f64() / self.total.as_secs_f64().max(1e-12)
    }
}

/// A run between epochs.
pub(super) struct Run<'a> {
    config: &'a TrainConfig,
    data: &'a TrainingData,
    summary: DataSummary,
    pub learner: Learner,
    /// Epochs done.
    pub epoch: usize,
    /// Scores of the last validation, and the best Spearman correlation so far.
    metrics: BTreeMap<String, f64>,
    pub journal: Journal,
    pub best: PathBuf,
    pub last: PathBuf,
}

impl<'a> Run<'a> {
    pub fn start(
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

    pub fn resume(
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
        // Without validation every epoch is the best so far.
        if data.valid.is_empty() || checkpoint.meta.metrics.contains_key(BEST) {
            let found = Checkpoint::load_for(&best, &data.descriptor)?.meta;
            if found.recipe != checkpoint.meta.recipe || found.data != checkpoint.meta.data {
                let found = "the best checkpoint of another run";
                let remedy = "put that of this run back, or start the run anew with --force";
                return Err(Error::file(&best, found, "that of the run to go on with", remedy));
            }
        }
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

    /// One pass over the scenes in a random order; the mean loss. The input of each step is drawn
    /// while the network works on the one before.
    pub fn epoch_of(
        &mut self,
        scenes: &[PreparedScene<'_>],
        clock: &mut Clock,
        monitor: &dyn Monitor,
    ) -> Result<f64> {
        let mut order: Vec<usize> = (0..scenes.len()).collect();
        order.shuffle(&mut generator(self.config.seed, "order of an epoch", self.epoch as u64));
        let learning_rate = self.config.learning_rate_at(self.epoch);
        let mut sum = 0.0;
        let mut drawn = None;
        for (k, &scene) in order.iter().enumerate() {
            monitor.check(STAGE)?;
            let (start, step, config) = (Instant::now(), self.learner.state.steps, self.config);
            let batch = match drawn.take() {
                Some(batch) => batch?,
                None => scenes[scene].batch(step, config)?,
            };
            // What a step draws depends on its number alone, so the next one can be drawn meanwhile.
            let next = order.get(k + 1).map(|&scene| &scenes[scene]);
            let learner = &mut self.learner;
            let ((loss, busy), ahead) = rayon::join(
                || {
                    let start = Instant::now();
                    (learner.step(&batch, learning_rate), start.elapsed())
                },
                || next.map(|scene| scene.batch(step + 1, config)),
            );
            let loss = loss?;
            drawn = ahead;
            clock.total += start.elapsed();
            clock.outside += start.elapsed().saturating_sub(busy);
            clock.steps += 1;
            sum += loss;
            monitor.note(&format!("loss {loss:.5}, learning rate {learning_rate:.2e}"));
            monitor.advance(1);
        }
        Ok(sum / scenes.len() as f64)
    }

    /// Every few epochs, and after the last one.
    pub fn validates(&self, epoch: usize) -> bool {
        (epoch + 1).is_multiple_of(self.config.validate_every) || epoch + 1 == self.config.epochs
    }

    pub fn finish_epoch(&mut self, loss: f64, clock: Clock, validation: Option<Validation>) -> Result<()> {
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
        // The state to go on from is written last: a run killed before it does the epoch again,
        // writes the same best, and drops from the log what came after the state.
        self.journal.records.push(Record::Epoch {
            epoch: self.epoch,
            loss,
            learning_rate,
            step_ms: clock.step_ms(),
            outside_share: clock.outside_share(),
            validation,
        });
        self.journal.save()?;
        if improved {
            self.checkpoint(None).save(&self.best)?;
        }
        self.checkpoint(Some(self.learner.state.clone())).save(&self.last)
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
    (out_dir.join(run_folder::BEST), out_dir.join(run_folder::LAST))
}

/// Six decimals: the JSON of a checkpoint gives such a number back exactly.
fn short(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}
