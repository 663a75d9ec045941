//! A scene, and a whole data set, by the protocols.

use super::estimate::SceneEstimate;
use super::pose_error::{ErrorDistribution, PairError, pair_errors};
use super::recall::{RecallReport, RecallSummary, registration_recall};
use super::scene::SceneTruth;
use crate::Result;
use crate::scan::ScanId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A scan without a pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Declined {
    /// Its name.
    pub scan: String,
    /// Why it has none.
    pub reason: String,
}

/// One scene by all protocols asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneReport {
    /// Name of the scene.
    pub scene: String,
    /// Scans of the scene.
    pub scans: usize,
    /// Scans with a pose.
    pub placed: usize,
    /// The others. Every pair with one of them is a failure.
    pub declined: Vec<Declined>,
    /// How far the worst true rotation was from orthonormal before it was repaired.
    pub truth_deviation: f64,
    /// Registration recall by benchmark; scans are called by their numbers.
    pub recalls: BTreeMap<String, RecallReport>,
    /// Errors of the relative poses of all pairs, where the true poses are known; scans are called
    /// by their numbers.
    pub pairs: Vec<PairError>,
    /// Their distribution.
    pub errors: Option<ErrorDistribution>,
}

/// Evaluates one scene.
///
/// # Errors
/// A counted pair without information matrix.
pub fn evaluate_scene(
    truth: &SceneTruth,
    estimate: &SceneEstimate,
    reference_quirks: bool,
) -> Result<SceneReport> {
    let by_number = truth.by_number();
    let relative =
        |i: ScanId, j: ScanId| estimate.relative_in_component(*by_number.get(&i.0)?, *by_number.get(&j.0)?);
    let mut recalls = BTreeMap::new();
    for benchmark in &truth.pairs {
        let Some(config) = benchmark.protocol.recall(reference_quirks) else { continue };
        recalls
            .insert(benchmark.benchmark.clone(), registration_recall(&benchmark.pairs, relative, &config)?);
    }
    let mut pairs = match &truth.world_from_scan {
        Some(poses) => pair_errors(poses, |i, j| estimate.relative(i.0, j.0)),
        None => Vec::new(),
    };
    for pair in &mut pairs {
        (pair.i, pair.j) = (ScanId(truth.numbers[pair.i.0]), ScanId(truth.numbers[pair.j.0]));
    }
    let reasons = truth.scans.iter().zip(&estimate.reasons);
    Ok(SceneReport {
        scene: truth.name.clone(),
        scans: truth.scans.len(),
        placed: estimate.placed(),
        declined: reasons
            .filter_map(|(scan, reason)| Some(Declined { scan: scan.clone(), reason: reason.clone()? }))
            .collect(),
        truth_deviation: truth.deviation,
        recalls,
        errors: ErrorDistribution::of_scene(&pairs),
        pairs,
    })
}

/// All scenes of a data set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SetReport {
    /// Every scene.
    pub scenes: Vec<SceneReport>,
    /// Recall over the scenes, by benchmark.
    pub recalls: BTreeMap<String, RecallSummary>,
    /// The ScanNet protocol's figures: averaged over the scenes.
    pub errors: Option<ErrorDistribution>,
}

impl SetReport {
    /// Sums up scenes.
    pub fn new(scenes: Vec<SceneReport>) -> Self {
        let names: std::collections::BTreeSet<String> =
            scenes.iter().flat_map(|s| s.recalls.keys().cloned()).collect();
        let summary = |name: &str| RecallSummary::new(scenes.iter().filter_map(|s| s.recalls.get(name)));
        let recalls = names.into_iter().map(|name| (name.clone(), summary(&name))).collect();
        let errors: Vec<ErrorDistribution> = scenes.iter().filter_map(|s| s.errors.clone()).collect();
        let errors = ErrorDistribution::over_scenes(&errors);
        Self { scenes, recalls, errors }
    }
}
