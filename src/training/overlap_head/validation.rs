//! Scoring a head on scenes it was not trained on.

use super::batch::TrainingScene;
use super::targets::overlap_matrix;
use super::{TrainConfig, TrainingData};
use crate::Result;
use crate::evaluation::retrieval_scores::RetrievalScores;
use crate::retrieval::similarity_matrix;
use crate::retrieval::{Head, global_features};
use crate::retrieval::{RetrievalConfig, SimilaritySource, choose_head};
use crate::scan::{Descriptors, SimilarityMatrix};
use crate::{Monitor, Silent};
use serde::{Deserialize, Serialize};

/// Scores of one head on every validation scene and on average.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Validation {
    /// Mean over scenes.
    pub mean: RetrievalScores,
    /// Every scene by name, in the order given.
    pub scenes: Vec<(String, RetrievalScores)>,
}

/// The validation scenes with their true overlap: whole scans, no crops, no dropout, no fusion.
pub(super) struct Validator<'a> {
    scenes: Vec<(&'a TrainingScene, SimilarityMatrix)>,
    k: usize,
}

impl<'a> Validator<'a> {
    pub fn new(data: &'a TrainingData, config: &TrainConfig, monitor: &dyn Monitor) -> Result<Self> {
        const STAGE: &str = "overlap of the validation scenes";
        monitor.begin(STAGE, data.valid.len());
        let mut scenes = Vec::new();
        for scene in &data.valid {
            monitor.check(STAGE)?;
            scenes.push((scene, overlap_matrix(&scene.world_keypoints(), config.overlap_radius_m as f32)?));
            monitor.advance(1);
        }
        monitor.end();
        Ok(Self { scenes, k: config.recall_k })
    }

    pub fn is_empty(&self) -> bool {
        self.scenes.is_empty()
    }

    /// Scores of a head on all scenes.
    pub fn score(&self, head: &Head) -> Result<Validation> {
        self.score_each(|_| Ok(head.clone()))
    }

    /// What can be had without training, by name: poolings and NetVLAD around k-means centroids
    /// of the very scans to be compared, as registration does without a trained head.
    pub fn baselines(&self, config: &TrainConfig) -> Result<Vec<(String, Validation)>> {
        let sources = [
            ("mean pooling", SimilaritySource::Mean),
            ("generalised mean", SimilaritySource::Gem),
            ("k-means NetVLAD", SimilaritySource::Netvlad),
        ];
        let score = |(name, source): (&str, SimilaritySource)| {
            let mut settings = RetrievalConfig::default();
            settings.source = source;
            settings.clusters = config.clusters;
            settings.alpha = config.alpha as f32;
            settings.bias = config.bias;
            settings.gem_power = config.gem_power as f32;
            let head = |scans: &[&Descriptors]| Ok(choose_head(scans, &settings, None, config.seed)?.0);
            Ok((name.to_owned(), self.score_each(head)?))
        };
        sources.into_iter().map(score).collect()
    }

    fn score_each(&self, head_for: impl Fn(&[&Descriptors]) -> Result<Head>) -> Result<Validation> {
        let mut scenes = Vec::new();
        for (scene, overlap) in &self.scenes {
            let scans: Vec<&Descriptors> = scene.features.iter().map(|f| &f.descriptors).collect();
            let features = global_features(&head_for(&scans)?, &scans, &Silent)?;
            let features: Vec<Option<&Vec<f32>>> = features.iter().map(Option::as_ref).collect();
            let scores = RetrievalScores::of(&similarity_matrix(&features, &Silent)?, overlap, self.k)?;
            scenes.push((scene.name.clone(), scores));
        }
        let all: Vec<RetrievalScores> = scenes.iter().map(|s| s.1).collect();
        Ok(Validation { mean: RetrievalScores::mean(&all), scenes })
    }
}
