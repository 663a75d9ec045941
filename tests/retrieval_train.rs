//! Training end to end on a small synthetic data set, read like a session.
//!
//! A room's surface carries a smooth random descriptor field; scans are overlapping pieces of it.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scanweave::geometry::{Point, RigidMotion};
use scanweave::retrieval::{Checkpoint, DescriptorTag, RetrievalConfig, similarity_of};
use scanweave::scan::{Descriptors, Features};
use scanweave::training::overlap_head::{
    CentroidStart, Record, TrainConfig, TrainReport, TrainingData, TrainingScene, train,
};
use scanweave::{Monitor, Silent};
use std::f32::consts::TAU;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

const DIM: usize = 8;

/// Waves that give every place of a room its descriptor, smoothly.
struct Field {
    waves: Vec<[f32; 4]>,
}

impl Field {
    fn new(rng: &mut ChaCha8Rng) -> Self {
        let mut draw = || rng.random_range(-1.0f32..1.0);
        Self { waves: (0..DIM).map(|_| [draw() * 2.0, draw() * 2.0, draw() * 2.0, draw() * 3.0]).collect() }
    }

    fn at(&self, p: &Point, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let noise = |rng: &mut ChaCha8Rng| rng.random_range(-0.4f32..0.4);
        self.waves.iter().map(|w| (w[0] * p.x + w[1] * p.y + w[2] * p.z + w[3]).sin() + noise(rng)).collect()
    }
}

/// Scans of a cylinder wall 3 m in radius, each covering a quarter of it.
fn scene(name: &str, scans: usize, seed: u64) -> TrainingScene {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let field = Field::new(&mut ChaCha8Rng::seed_from_u64(77));
    let offset = rng.random_range(0.0..TAU);
    let mut features = Vec::new();
    let mut poses = Vec::new();
    for i in 0..scans {
        let start = offset + TAU * i as f32 / scans as f32;
        let world_from_scan = RigidMotion::translation(f64::from(rng.random_range(-2.0f32..2.0)), 0.3, 0.0);
        let mut keypoints = Vec::new();
        let mut values = Vec::new();
        for _ in 0..400 {
            let angle = start + rng.random_range(0.0..TAU / 4.0);
            let world = Point::new(3.0 * angle.cos(), 3.0 * angle.sin(), rng.random_range(0.0..1.0));
            keypoints.push((world_from_scan.inverse() * world.cast::<f64>()).cast::<f32>());
            values.extend(field.at(&world, &mut rng));
        }
        let descriptors = Descriptors::new(DIM, values).unwrap().normalized();
        features.push(Features::new(keypoints, None, descriptors).unwrap());
        poses.push(world_from_scan);
    }
    TrainingScene { name: name.into(), features, world_from_scan: poses }
}

fn data() -> TrainingData {
    TrainingData {
        train: (0..3).map(|i| scene(&format!("train-{i}"), 12, i)).collect(),
        valid: vec![scene("valid", 14, 100)],
        descriptor: DescriptorTag { name: "waves".into(), dim: DIM, settings_hash: "1".into() },
    }
}

fn config() -> TrainConfig {
    TrainConfig {
        clusters: 8,
        epochs: 12,
        learning_rate: 0.02,
        dropout: 0.1,
        frames_max: 12,
        crop_min: 250,
        crop_max: 380,
        overlap_radius_m: 0.25,
        validate_every: 3,
        recall_k: 3,
        seed: 5,
        ..TrainConfig::default()
    }
}

fn losses(report: &TrainReport) -> Vec<f64> {
    let loss = |r: &Record| match r {
        Record::Epoch { loss, .. } => Some(*loss),
        Record::Baseline { .. } => None,
    };
    report.records.iter().filter_map(loss).collect()
}

fn bytes(folder: &Path, file: &str) -> Vec<u8> {
    std::fs::read(folder.join(file)).unwrap()
}

/// Stops the training after a number of steps, as Ctrl-C would.
struct StopAfter {
    steps: usize,
    done: AtomicUsize,
}

impl Monitor for StopAfter {
    fn note(&self, _: &str) {
        self.done.fetch_add(1, Ordering::SeqCst);
    }
    fn cancelled(&self) -> bool {
        self.done.load(Ordering::SeqCst) >= self.steps
    }
}

#[test]
fn the_loss_halves_from_random_centroids() {
    let folder = tempfile::tempdir().unwrap();
    let config = TrainConfig { centroids: CentroidStart::Uniform, learning_rate: 0.05, ..config() };
    let report = train(&data(), &config, folder.path(), false, &Silent).unwrap();
    let losses = losses(&report);
    assert_eq!((losses.len(), report.steps), (12, 36));
    assert!(losses[11] < 0.5 * losses[0], "{losses:?}");
}

#[test]
fn a_trained_head_beats_the_untrained_ones_on_a_scene_it_never_saw() {
    let folder = tempfile::tempdir().unwrap();
    let report = train(&data(), &config(), folder.path(), false, &Silent).unwrap();
    let mut baselines = Vec::new();
    let mut best = f64::NEG_INFINITY;
    for record in &report.records {
        match record {
            Record::Baseline { name, validation } => baselines.push((name.clone(), validation.mean)),
            Record::Epoch { validation: Some(v), .. } => best = best.max(v.mean.spearman),
            Record::Epoch { .. } => {}
        }
    }
    assert_eq!(baselines.len(), 3);
    for (name, scores) in &baselines {
        assert!(best > scores.spearman + 0.03, "{best} against {name}: {scores:?}");
    }
    // The best checkpoint is the one whose score it states, and registration can use it.
    let checkpoint = Checkpoint::load_for(&report.best, &data().descriptor).unwrap();
    assert!((checkpoint.meta.metrics["spearman"] - best).abs() < 1e-6);
    assert_eq!(checkpoint.meta.data.train_scans, 36);
    assert!(checkpoint.optimizer.is_none());
    let features = &data().valid[0].features;
    let used = similarity_of(features, &RetrievalConfig::default(), Some(&checkpoint), 0, &Silent).unwrap();
    assert_eq!(used.1.to_string(), "trained checkpoint netvlad-waves");
    let log = String::from_utf8(bytes(folder.path(), "metrics.jsonl")).unwrap();
    assert_eq!(log.lines().count(), 3 + 12);
    assert!(bytes(folder.path(), "curves.svg").starts_with(b"<svg"));
}

#[test]
fn resuming_gives_the_bytes_of_a_run_that_was_never_interrupted() {
    let (data, config) = (data(), config());
    let straight = tempfile::tempdir().unwrap();
    train(&data, &config, straight.path(), false, &Silent).unwrap();
    let resumed = tempfile::tempdir().unwrap();
    // Killed in the middle of the fifth and of the tenth epoch (three steps each), and on another
    // number of threads in between.
    let stop = |steps| StopAfter { steps, done: AtomicUsize::new(0) };
    let message = train(&data, &config, resumed.path(), false, &stop(13)).unwrap_err().to_string();
    assert!(message.contains("interrupted during training"), "{message}");
    let last = Checkpoint::load(&resumed.path().join("last.safetensors")).unwrap();
    assert_eq!((last.meta.epoch, last.optimizer.as_ref().unwrap().steps), (4, 12));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert!(pool.install(|| train(&data, &config, resumed.path(), true, &stop(16))).is_err());
    let report = train(&data, &config, resumed.path(), true, &Silent).unwrap();
    assert_eq!(report.steps, 36 - 27);
    assert_eq!(losses(&report).len(), 12);
    for file in ["last.safetensors", "best.safetensors"] {
        assert!(bytes(straight.path(), file) == bytes(resumed.path(), file), "{file} differs");
    }
    // A finished run has nothing left to do.
    assert_eq!(train(&data, &config, resumed.path(), true, &Silent).unwrap().steps, 0);
    // No temporary file is left behind.
    assert_eq!(std::fs::read_dir(resumed.path()).unwrap().count(), 4);
}

/// A run that dies before its state is written does the epoch again: the log must not lack it.
#[test]
fn the_log_is_written_before_the_state_it_belongs_to() {
    /// Puts a folder where the state would go.
    struct Blocked(std::path::PathBuf);
    impl Monitor for Blocked {
        fn note(&self, _: &str) {
            std::fs::create_dir_all(self.0.join("in the way")).unwrap();
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let last = folder.path().join("last.safetensors");
    let message = train(&data(), &config(), folder.path(), false, &Blocked(last.clone())).unwrap_err();
    assert!(message.to_string().contains("last.safetensors"), "{message}");
    let log = String::from_utf8(bytes(folder.path(), "metrics.jsonl")).unwrap();
    assert_eq!(log.matches(r#""kind":"epoch""#).count(), 1, "{log}");
}

#[test]
fn what_cannot_be_resumed_says_why() {
    let (data, config) = (data(), TrainConfig { epochs: 1, ..config() });
    let folder = tempfile::tempdir().unwrap();
    let message = |r: scanweave::Result<TrainReport>| r.unwrap_err().to_string();
    let nothing = message(train(&data, &config, folder.path(), true, &Silent));
    assert!(nothing.contains("last.safetensors: cannot read it"), "{nothing}");
    train(&data, &config, folder.path(), false, &Silent).unwrap();
    let again = message(train(&data, &config, folder.path(), false, &Silent));
    assert!(again.contains("already holds a result"), "{again}");
    let other = TrainConfig { epochs: 2, dropout: 0.2, ..config.clone() };
    let changed = message(train(&data, &other, folder.path(), true, &Silent));
    assert!(changed.contains("a run with other settings (dropout, epochs)"), "{changed}");
    let mut fewer = data.clone();
    fewer.train.pop();
    let changed = message(train(&fewer, &config, folder.path(), true, &Silent));
    assert!(changed.contains("a run on other scenes or features"), "{changed}");
    let mut mixed = data.clone();
    mixed.valid.push(mixed.train[0].clone());
    let leaked = message(train(&mixed, &config, folder.path(), true, &Silent));
    assert!(leaked.contains("a split by scene"), "{leaked}");
}

#[test]
fn gem_trains_too() {
    let folder = tempfile::tempdir().unwrap();
    let gem =
        TrainConfig { head: scanweave::retrieval::SimilaritySource::Gem, learning_rate: 0.2, ..config() };
    let report = train(&data(), &gem, folder.path(), false, &Silent).unwrap();
    let losses = losses(&report);
    // One parameter only: it can help a little, not much.
    assert!(losses[11] < losses[0], "{losses:?}");
    let checkpoint = Checkpoint::load(&report.best).unwrap();
    assert_eq!(checkpoint.meta.name, "gem-waves");
}

#[test]
fn the_shipped_recipes_are_readable_and_netvlad_is_the_default() {
    #[derive(serde::Deserialize)]
    struct File {
        train: TrainConfig,
    }
    let netvlad: File = toml::from_str(include_str!("../configs/train/netvlad.toml")).unwrap();
    assert_eq!(netvlad.train, TrainConfig::default());
    let gem: File = toml::from_str(include_str!("../configs/train/gem.toml")).unwrap();
    let head = scanweave::retrieval::SimilaritySource::Gem;
    assert_eq!(gem.train, TrainConfig { head, ..TrainConfig::default() });
}
