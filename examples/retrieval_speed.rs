//! Prints the speed of the retrieval stage and of a training step; run it on an idle machine.
//!
//! Usage: `cargo run --release --example retrieval_speed`

use rand::{RngExt, SeedableRng};
use scanweave::Silent;
use scanweave::geometry::{Point, RigidMotion};
use scanweave::retrieval::{DescriptorTag, RetrievalConfig, similarity_of};
use scanweave::scan::{Descriptors, Features};
use scanweave::training::overlap_head::{TrainConfig, TrainingData, TrainingScene, train};
use std::time::Instant;

fn main() {
    similarity_of_sixty_scans();
    training_steps();
}

fn similarity_of_sixty_scans() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let features: Vec<Features> = (0..60)
        .map(|_| {
            let values = (0..5000 * 33).map(|_| rng.random_range(0.0f32..1.0)).collect();
            let descriptors = Descriptors::new(33, values).unwrap().normalized();
            Features::new(vec![Point::origin(); 5000], None, descriptors).unwrap()
        })
        .collect();
    let start = Instant::now();
    similarity_of(&features, &RetrievalConfig::default(), None, 1, &Silent).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    println!("60 scans x 5000 x 33, k-means and NetVLAD: {seconds:.2} s");
}

/// Wall time of a training step and the share spent outside the network, at the real sizes: sixty
/// scans of 5000 keypoints around a cylindrical room, each covering a quarter of it.
fn training_steps() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let features: Vec<Features> = (0..60)
        .map(|i| {
            let mut point = || {
                let angle = (i as f32 / 60.0 + rng.random_range(0.0f32..0.25)) * std::f32::consts::TAU;
                Point::new(3.0 * angle.cos(), 3.0 * angle.sin(), rng.random_range(0.0f32..2.5))
            };
            let keypoints: Vec<Point> = (0..5000).map(|_| point()).collect();
            let values = (0..5000 * 33).map(|_| rng.random_range(0.0f32..1.0)).collect();
            Features::new(keypoints, None, Descriptors::new(33, values).unwrap().normalized()).unwrap()
        })
        .collect();
    let scene = TrainingScene {
        name: "cylinder".into(),
        world_from_scan: vec![RigidMotion::identity(); features.len()],
        features,
    };
    let descriptor = DescriptorTag { name: "noise".into(), dim: 33, settings_hash: String::new() };
    let data = TrainingData { train: vec![scene], valid: Vec::new(), descriptor };
    let folder = tempfile::tempdir().unwrap();
    let config = TrainConfig { epochs: 20, ..TrainConfig::default() };
    let report = train(&data, &config, folder.path(), false, &Silent).unwrap();
    println!("{:.0} ms a step, {:.1} % outside the network", report.step_ms, 100.0 * report.outside_share);
}
