//! A training run: steps, validation, checkpoints, log.

use super::TrainConfig;
use super::batch::Batch;
use super::learner::{Learner, State};
use super::pairs::{PairScene, PatchPair};
use crate::Monitor;
use crate::descriptor::mini_spin_net::{
    Checkpoint, DESCRIPTOR, FORMAT_VERSION, Meta, Network, Patch, Weights, Workspace,
};
use crate::files::{self, Array};
use crate::training::run_folder;
use crate::{Error, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

const STAGE: &str = "training";
const ACCURACY: &str = "accuracy";
const BEST: &str = "best_accuracy";
/// Pairs of a scene used for validation.
const VALIDATED: usize = 512;

/// What a network is trained on. The split is by scene.
#[derive(Debug, Clone, Default)]
pub struct PairData {
    /// Scenes that steps are drawn from.
    pub train: Vec<PairScene>,
    /// Scenes that only score the result; may be empty.
    pub valid: Vec<PairScene>,
}

/// One line of `metrics.jsonl`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Steps taken.
    pub step: usize,
    /// Mean loss since the record before.
    pub loss: f64,
    /// Mean duration of a step, milliseconds.
    pub step_ms: f64,
    /// Share of validation patches whose counterpart is the nearest, where it was computed.
    pub accuracy: Option<f64>,
}

/// What a run came to.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainReport {
    /// Steps of this call.
    pub steps: usize,
    /// The whole log, of earlier calls too.
    pub records: Vec<Record>,
    /// The best checkpoint.
    pub best: PathBuf,
}

/// Trains a network and writes checkpoints and log into `out_dir`, which must exist. With `resume`
/// it continues from `out_dir/last.safetensors`.
///
/// # Errors
/// When a setting or scene cannot be used; when `out_dir` holds a run and `resume` is not set, or
/// one of other settings or data and it is set; when a file cannot be written; when the loss is no
/// longer finite; when the user asks to stop.
pub fn train(
    data: &PairData,
    config: &TrainConfig,
    out_dir: &Path,
    resume: bool,
    monitor: &dyn Monitor,
) -> Result<TrainReport> {
    config.validate()?;
    check(data)?;
    let mut run = Run::open(data, config, out_dir, resume)?;
    let learner = Learner::new(config);
    let before = run.state.steps;
    monitor.begin(STAGE, config.steps - before);
    let (mut start, mut sum, mut count) = (Instant::now(), 0.0, 0);
    while run.state.steps < config.steps {
        monitor.check(STAGE)?;
        let batch = Batch::draw(&data.train, run.state.steps, config);
        let loss = learner.step(&mut run.state, &batch)?;
        (sum, count) = (sum + loss, count + 1);
        monitor.note(&format!("loss {loss:.4}"));
        monitor.advance(1);
        let done = run.state.steps;
        if done.is_multiple_of(config.checkpoint_every) || done == config.steps {
            let step_ms = start.elapsed().as_secs_f64() * 1e3 / f64::from(count);
            let loss = sum / f64::from(count);
            run.finish(Record { step: done, loss, step_ms, accuracy: None })?;
            (start, sum, count) = (Instant::now(), 0.0, 0);
        }
    }
    monitor.end();
    Ok(TrainReport { steps: run.state.steps - before, records: run.records, best: run.best })
}

fn check(data: &PairData) -> Result<()> {
    if data.train.is_empty() {
        return Err(Error::input("training data", "no scene", "at least one", "name scenes to train on"));
    }
    match data.train.iter().chain(&data.valid).find(|s| s.pairs.len() < 2) {
        None => Ok(()),
        Some(scene) => Err(Error::input(
            format!("scene {}", scene.name),
            format!("{} pairs of patches", scene.pairs.len()),
            "at least two places seen in two scans",
            "leave the scene out, or check its poses",
        )),
    }
}

/// A run between steps.
struct Run<'a> {
    data: &'a PairData,
    config: &'a TrainConfig,
    recipe: serde_json::Value,
    state: State,
    metrics: BTreeMap<String, f64>,
    records: Vec<Record>,
    folder: PathBuf,
    best: PathBuf,
    last: PathBuf,
}

impl<'a> Run<'a> {
    fn open(data: &'a PairData, config: &'a TrainConfig, folder: &Path, resume: bool) -> Result<Self> {
        let (best, last) = (folder.join(run_folder::BEST), folder.join(run_folder::LAST));
        // Plain numbers and names always have a JSON form.
        let settings = serde_json::to_value(config).unwrap_or_default();
        let recipe = serde_json::json!({ "train": settings, "data": digest(data) });
        let mut run = Self {
            data,
            config,
            recipe,
            state: State::new(&Weights::initial(&config.architecture(), config.seed)),
            metrics: BTreeMap::new(),
            records: Vec::new(),
            folder: folder.to_path_buf(),
            best,
            last,
        };
        if resume {
            run.read_last()?;
            if run.state.steps < config.steps {
                // Of a run that is prolonged.
                let _ = std::fs::remove_file(run.folder.join(run_folder::FINAL));
            }
        } else if run.last.exists() || run.best.exists() {
            return Err(Error::OutputExists { path: folder.to_path_buf() });
        }
        Ok(run)
    }

    fn read_last(&mut self) -> Result<()> {
        let (meta, arrays): (Meta, _) = files::load_arrays(&self.last, "a checkpoint to go on from")?;
        let refuse = |found: String, expected: &str| {
            let remedy = "use the settings and scenes it was started with, or start a new run";
            Error::file(&self.last, found, expected, remedy)
        };
        if settings_of(&meta.recipe) != settings_of(&self.recipe) {
            return Err(refuse(
                "a run with other settings".to_owned(),
                "the same settings, but for steps and cooldown",
            ));
        }
        if meta.recipe.get("data") != self.recipe.get("data") {
            return Err(refuse("a run on other patches".to_owned(), "the same data"));
        }
        let weights = Checkpoint::load(&self.last)?.weights;
        let mut state = State { steps: meta.steps, ..State::new(&weights) };
        for (p, parameter) in state.parameters.iter_mut().enumerate() {
            let part = |name: &str| arrays.get(&format!("optimizer.{p}.{name}")).map(|a| a.values.clone());
            let (Some(value), Some(first), Some(second)) = (part("value"), part("first"), part("second"))
            else {
                return Err(refuse("no optimiser state".to_owned(), "a checkpoint to go on from"));
            };
            *parameter = value;
            state.moments.push((first, second));
        }
        if meta.metrics.contains_key(BEST) {
            let found = Checkpoint::load(&self.best)?.meta.recipe;
            if settings_of(&found) != settings_of(&meta.recipe)
                || found.get("data") != meta.recipe.get("data")
            {
                let found = "the best checkpoint of another run";
                let remedy = "put that of this run back, or start the run anew with --force";
                return Err(Error::file(&self.best, found, "that of the run to go on with", remedy));
            }
        }
        (self.state, self.metrics) = (state, meta.metrics);
        self.records = read_log(&self.folder.join(run_folder::METRICS), self.state.steps)?;
        Ok(())
    }

    /// Validates where it is time to, and writes everything.
    fn finish(&mut self, mut record: Record) -> Result<()> {
        let last_step = record.step == self.config.steps;
        let validates = record.step.is_multiple_of(self.config.validate_every) || last_step;
        let mut improved = last_step && self.data.valid.is_empty();
        if validates && !self.data.valid.is_empty() {
            let accuracy = accuracy(&self.data.valid, &Network::new(&self.state.weights()), self.config);
            // Six decimals: the JSON of a checkpoint gives such a number back exactly.
            let accuracy = (accuracy * 1e6).round() / 1e6;
            record.accuracy = Some(accuracy);
            self.metrics.insert(ACCURACY.into(), accuracy);
            improved = self.metrics.get(BEST).is_none_or(|&best| accuracy > best);
            if improved {
                self.metrics.insert(BEST.into(), accuracy);
            }
        }
        let checkpoint = self.checkpoint();
        // The state to go on from is written last: a run killed before it does the steps again,
        // writes the same best, and drops from the log what came after the state.
        self.records.push(record);
        self.write_log()?;
        if improved {
            checkpoint.save(&self.best)?;
        }
        if last_step {
            checkpoint.save(&self.folder.join(run_folder::FINAL))?;
        }
        let mut arrays = checkpoint.weights.to_arrays();
        for (p, (value, (first, second))) in self.state.parameters.iter().zip(&self.state.moments).enumerate()
        {
            for (name, values) in [("value", value), ("first", first), ("second", second)] {
                arrays.insert(format!("optimizer.{p}.{name}"), Array::new(&[values.len()], values.clone()));
            }
        }
        files::save_arrays(&self.last, &checkpoint.meta, &arrays)
    }

    fn checkpoint(&self) -> Checkpoint {
        Checkpoint {
            meta: Meta {
                format_version: FORMAT_VERSION,
                descriptor: DESCRIPTOR.to_owned(),
                name: "mini-spin-net-scanweave".to_owned(),
                architecture: self.state.architecture.clone(),
                source: "trained by scanweave".to_owned(),
                licence: "MIT OR Apache-2.0".to_owned(),
                recipe: self.recipe.clone(),
                metrics: self.metrics.clone(),
                steps: self.state.steps,
            },
            weights: self.state.weights(),
        }
    }

    fn write_log(&self) -> Result<()> {
        let path = self.folder.join(run_folder::METRICS);
        let fail = |e: std::io::Error| Error::write(&path, e);
        let lines: Vec<String> = self
            .records
            .iter()
            .map(serde_json::to_string)
            .collect::<std::result::Result<_, _>>()
            .map_err(|e| fail(e.into()))?;
        files::write(&path, |out| lines.iter().try_for_each(|line| writeln!(out, "{line}")))
    }
}

/// Settings of a recipe without the number of steps: no step depends on it, so that a run may go
/// on beyond what was planned.
fn settings_of(recipe: &serde_json::Value) -> Option<serde_json::Map<String, serde_json::Value>> {
    let mut settings = recipe.get("train")?.as_object()?.clone();
    // A run is prolonged, or brought to its end, by these.
    settings.remove("steps");
    settings.remove("cooldown");
    Some(settings)
}

/// The log of an interrupted run up to its checkpoint; what came after is done again.
fn read_log(path: &Path, steps: usize) -> Result<Vec<Record>> {
    let text = match crate::files::read_text(path) {
        Ok(text) => text,
        Err(Error::Read { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
            return Ok(Vec::new());
        }
        Err(e) => return Err(e),
    };
    let records = text.lines().enumerate().map(|(number, line)| {
        serde_json::from_str::<Record>(line).map_err(|e| {
            let found = format!("line {} that cannot be read ({e})", number + 1);
            Error::file(path, found, "one record a line", "delete the file; training goes on without it")
        })
    });
    let records: Vec<Record> = records.collect::<Result<_>>()?;
    Ok(records.into_iter().filter(|r| r.step <= steps).collect())
}

/// Share of patches whose nearest counterpart lies at their place, mean over scenes.
fn accuracy(scenes: &[PairScene], network: &Network, config: &TrainConfig) -> f64 {
    let square = (config.negative_radius as f32).powi(2);
    let of_scene = |scene: &PairScene| {
        let pairs = &scene.pairs[..scene.pairs.len().min(VALIDATED)];
        let [first, second] = [0, 1].map(|side| described(pairs, side, network));
        let dim = network.dim();
        let hits = first.par_chunks(dim).zip(pairs).filter(|(row, pair)| {
            let product = |other: &[f32]| row.iter().zip(other).map(|(a, b)| a * b).sum::<f32>();
            let products = second.chunks(dim).map(product).enumerate();
            let nearest = products.max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |n| n.0);
            let away = pair.place.iter().zip(&pairs[nearest].place).map(|(a, b)| (a - b).powi(2));
            away.sum::<f32>() <= square
        });
        hits.count() as f64 / pairs.len() as f64
    };
    scenes.iter().map(of_scene).sum::<f64>() / scenes.len().max(1) as f64
}

fn described(pairs: &[PatchPair], side: usize, network: &Network) -> Vec<f32> {
    let rows = pairs.par_iter().flat_map_iter(|pair| {
        let mut patch = Patch::default();
        patch.fill(pair.points[side].iter().copied());
        let mut row = vec![0.0; network.dim()];
        network.describe(std::slice::from_ref(&patch), &mut Workspace::default(), &mut row);
        row
    });
    rows.collect()
}

/// BLAKE3 of all patches, so that a run is only continued on the same data.
fn digest(data: &PairData) -> String {
    let mut hasher = blake3::Hasher::new();
    for scene in data.train.iter().chain(&data.valid) {
        hasher.update(scene.name.as_bytes());
        for pair in &scene.pairs {
            let points = pair.points.iter().flatten().chain(std::iter::once(&pair.place));
            let bytes: Vec<u8> = points.flatten().flat_map(|v| v.to_le_bytes()).collect();
            hasher.update(&bytes);
        }
    }
    hasher.finalize().to_hex().to_string()
}
