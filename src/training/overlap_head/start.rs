//! What a run begins with, and what it is told by when it is resumed.

use super::config::{CentroidStart, TrainConfig};
use super::{TrainingData, TrainingScene};
use crate::retrieval::DataSummary;
use crate::retrieval::Gem;
use crate::retrieval::HeadWeights;
use crate::retrieval::NetVladConfig;
use crate::retrieval::{KmeansConfig, kmeans};
use crate::retrieval::{SimilaritySource, gem_shift};

/// Weights before the first step.
pub(super) fn initial_weights(data: &TrainingData, config: &TrainConfig) -> HeadWeights {
    let dim = data.descriptor.dim;
    let scans = data.train.iter().flat_map(|s| &s.features).filter(|f| !f.is_empty());
    let sets: Vec<&[f32]> = scans.map(|f| f.descriptors.values()).collect();
    if config.head == SimilaritySource::Gem {
        let layer = Gem { power: config.gem_power as f32, shift: gem_shift(&sets), ..Gem::default() };
        return HeadWeights::Gem { layer, dim };
    }
    let layer = NetVladConfig {
        clusters: config.clusters,
        dim,
        alpha: config.alpha as f32,
        bias: config.bias,
        seed: config.seed,
    };
    HeadWeights::NetVlad(match config.centroids {
        CentroidStart::Uniform => layer.init(),
        CentroidStart::Kmeans => {
            let settings = KmeansConfig {
                clusters: config.clusters,
                sample: config.kmeans_sample,
                rounds: config.kmeans_rounds,
                seed: config.seed,
            };
            layer.init_from(&kmeans(&sets, dim, &settings))
        }
    })
}

/// What identifies the data of a run: names, numbers, and a hash of features and poses.
pub(super) fn summary_of(data: &TrainingData) -> DataSummary {
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
pub(super) fn differing_keys(a: &TrainConfig, b: &TrainConfig) -> String {
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
