//! Labelled candidates: relative poses with their evidence, and whether they are right.

use super::VerifierRecipe;
use crate::Monitor;
use crate::config::Config;
use crate::evaluation::pose_error::PoseError;
use crate::geometry::RigidMotion;
use crate::pipeline::{self, FeatureSource, Stopwatch};
use crate::registration::{AgglomerativeConfig, SurfaceVerification};
use crate::registration::{
    MIN_KEYPOINTS, PairScorer, ScanInput, ScanModel, ScoredPairs, most_similar_pairs, predictors,
    score_pairs, unusable, with_aliasing, with_scan_count_prior,
};
use crate::scan::{Scan, ScanId};
use crate::synthetic::ambiguous_scans;
use crate::training::PosedScans;
use crate::training::entries::read_posed;
use crate::{Error, Result};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// A relative pose of two scans.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Predictors of the logistic model, in the order of
    /// [`EvidenceWeights::as_array`](crate::registration::EvidenceWeights::as_array).
    pub predictors: [f64; 10],
    /// What the collection adds to the log odds: its perceptual aliasing and its number of scans.
    pub offset: f64,
    /// Whether the true poses make it right.
    pub right: bool,
}

/// The candidates of a kind.
#[derive(Debug, Clone, PartialEq)]
pub struct KindCandidates {
    /// Name of the kind.
    pub name: String,
    /// Folders that its scans are in; none of a synthetic place.
    pub folders: Vec<PathBuf>,
    /// The candidates, in the order of collections and pairs.
    pub candidates: Vec<Candidate>,
}

/// Candidates of all kinds of a recipe. Folders lie under `root`.
///
/// # Errors
/// Data that cannot be read or has no poses, or the user asked to stop.
pub fn collect(recipe: &VerifierRecipe, root: &Path, monitor: &dyn Monitor) -> Result<Vec<KindCandidates>> {
    // Before minutes are spent on those that are there.
    for (at, kind) in recipe.kinds.iter().enumerate() {
        if let Some(missing) = kind.folders.iter().map(|f| root.join(f)).find(|f| !f.is_dir()) {
            return Err(Error::file(
                missing,
                "no such folder",
                format!("a folder of scans with true poses, as kinds[{at}].folders says"),
                "pass --data-root, or correct the recipe",
            ));
        }
    }
    let mut kinds = Vec::new();
    for kind in &recipe.kinds {
        let mut candidates = Vec::new();
        for folder in &kind.folders {
            candidates.extend(candidates_of(&read_posed(&root.join(folder), monitor)?, recipe, monitor)?);
        }
        kinds.push(KindCandidates { name: kind.name.clone(), folders: kind.folders.clone(), candidates });
    }
    for place in recipe.synthetic_kinds() {
        let mut candidates = Vec::new();
        for &seed in &recipe.synthetic_seeds {
            let set = ambiguous_scans(place, seed);
            let name = format!("{} {seed}", place.name());
            let posed = PosedScans { name, scans: set.scans, world_from_scan: set.world_from_scan };
            candidates.extend(candidates_of(&posed, recipe, monitor)?);
        }
        kinds.push(KindCandidates { name: place.name().to_owned(), folders: Vec::new(), candidates });
    }
    Ok(kinds)
}

/// The labelled hypotheses of all pairs of a collection that a registration would start with.
fn candidates_of(
    posed: &PosedScans,
    recipe: &VerifierRecipe,
    monitor: &dyn Monitor,
) -> Result<Vec<Candidate>> {
    let PosedScans { name, scans, world_from_scan } = posed;
    let scans: &[Scan] = scans;
    let mut config = Config::default();
    config.seed = recipe.seed;
    config.descriptor = recipe.descriptor.clone();
    let mut settings = SurfaceVerification::default();
    settings.weights = recipe.given.clone();
    let described = pipeline::describe(scans, &config, &FeatureSource::Computed, monitor)?;
    let (similarity, _) = pipeline::predict_overlap(&described, &config, monitor, &mut Stopwatch::default())?;
    let (radius_m, voxel_m) = (described.scale.inlier_radius_m, described.scale.voxel_m);
    let inputs: Vec<ScanInput<'_>> = described
        .features
        .iter()
        .zip(&described.surfaces)
        .map(|(features, surface)| ScanInput::new(features, surface))
        .collect();
    let usable: Vec<ScanId> = (0..inputs.len())
        .filter(|&i| unusable(&inputs[i], MIN_KEYPOINTS, voxel_m).is_none())
        .map(ScanId)
        .collect();
    let mut models: Vec<ScanModel<'_>> = inputs
        .par_iter()
        .map(|input| ScanModel::new(input.surface, radius_m as f32, &config.registration))
        .collect();
    let scorer = PairScorer::new(&inputs, &config.registration.estimator, recipe.seed);
    let retrieved = most_similar_pairs(&similarity, &usable, AgglomerativeConfig::default().neighbours);
    let ScoredPairs { pairs, aliasing, noise } =
        score_pairs(&scorer, &retrieved, &mut models, &settings, radius_m, monitor)?;
    let offset = log_odds(with_aliasing(with_scan_count_prior(0.5, models.len()), aliasing));
    // Hypotheses are of the scans' own frames.
    let truth: Vec<RigidMotion> =
        world_from_scan.iter().zip(&described.frames).map(|(pose, frame)| pose * frame).collect();
    let mut candidates = Vec::new();
    for pair in &pairs {
        let (i, j) = (pair.i.0, pair.j.0);
        let i_from_j = truth[i].inverse() * truth[j];
        let centre = models[j].centre.cast::<f64>();
        for found in pair.hypotheses.iter().filter(|h| h.evidence.inliers >= settings.min_inliers) {
            let error = PoseError::at(&found.a_from_b, &i_from_j, &centre);
            if let Some(right) = label(&error, radius_m) {
                candidates.push(Candidate { predictors: predictors(&found.evidence, &noise), offset, right });
            }
        }
    }
    tracing::info!("{name}: {} candidates, offset of the log odds {offset:.2}", candidates.len());
    Ok(candidates)
}

/// Whether a pose with this error, at the centre of the second scan, is right: within 5° and 3τ; `None` for
/// what lies between that and 10°, 6τ.
pub(super) fn label(error: &PoseError, radius_m: f64) -> Option<bool> {
    let within = |deg: f64, radii: f64| error.rotation_deg <= deg && error.translation_m <= radii * radius_m;
    if within(5.0, 3.0) {
        Some(true)
    } else if within(10.0, 6.0) {
        None
    } else {
        Some(false)
    }
}

/// ln(p / (1 − p)).
fn log_odds(p: f64) -> f64 {
    (p / (1.0 - p)).ln()
}
