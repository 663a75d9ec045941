//! Results against truth.

use crate::errors::OrRaise;
use crate::matrix;
use crate::run::PyRun;
use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use scanweave::evaluation::RecallConfig;
use scanweave::evaluation::evaluate_against_truth;
use scanweave::evaluation::{Limits, PlacementReport};
use scanweave::evaluation::{Truth, benchmark_recall};
use scanweave::geometry::RigidMotion;
use scanweave::scan::{DeclineReason, Outcome, Placement, Reconstruction};
use scanweave::{Error, Result};
use std::path::PathBuf;

/// Inlier radii up to which a pair is right where nothing else is said, as `scanweave evaluate` has it.
const RADII: f64 = 3.0;

/// The motions of many arrays, one a scan.
pub fn motions(subject: &str, arrays: &[PyReadonlyArray2<'_, f64>]) -> Result<Vec<RigidMotion>> {
    arrays
        .iter()
        .enumerate()
        .map(|(i, array)| matrix::motion(&format!("{subject} of scan {i}"), array))
        .collect()
}

/// A run against `truth` or what a folder holds of it.
pub fn of_run(
    run: &PyRun,
    truth: Option<Vec<RigidMotion>>,
    folder: Option<PathBuf>,
    limits: (Option<f64>, f64),
    benchmark: Option<(PathBuf, f64)>,
) -> Result<String> {
    let (reconstruction, document) = (&run.run.reconstruction, run.document());
    let truth = match (truth, folder) {
        (Some(truth), _) => truth,
        (None, Some(folder)) => Truth::read(&document, &folder)?.world_from_scan,
        (None, None) => {
            return Err(Error::input("truth", "none", "poses by name, or a folder", "pass the true poses"));
        }
    };
    let max_translation_m = limits.0.unwrap_or(RADII * run.run.scale.inlier_radius_m);
    let recall = match benchmark {
        Some((folder, threshold_m)) => {
            let config = RecallConfig { threshold_m, ..RecallConfig::default() };
            config.validate()?;
            Some(benchmark_recall(&folder, &document, reconstruction, &config)?.recall())
        }
        None => None,
    };
    report(reconstruction, &truth, max_translation_m, limits.1, recall.flatten())
}

/// Poses of any program against truth, as JSON; each component has a number.
#[pyfunction]
pub fn evaluate_poses(
    py: Python<'_>,
    poses: Vec<Option<PyReadonlyArray2<'_, f64>>>,
    truth: Vec<PyReadonlyArray2<'_, f64>>,
    limits: (f64, f64),
) -> PyResult<String> {
    let outcome = |(i, pose): (usize, &Option<PyReadonlyArray2<'_, f64>>)| match pose {
        Some(pose) => {
            let motion = matrix::motion(&format!("pose of scan {i}"), pose)?;
            Ok(Outcome::Placed(Placement::at(motion, 0)))
        }
        None => Ok(Outcome::Declined(DeclineReason::TooFewInliers { inliers: 0, needed: 0, matches: 0 })),
    };
    let outcomes: Result<Vec<Outcome>> = poses.iter().enumerate().map(outcome).collect();
    let judged = || {
        let reconstruction = Reconstruction::new(outcomes?);
        report(&reconstruction, &motions("truth", &truth)?, limits.0, limits.1, None)
    };
    judged().or_raise(py)
}

fn report(
    reconstruction: &Reconstruction,
    truth: &[RigidMotion],
    max_translation_m: f64,
    max_rotation_deg: f64,
    registration_recall: Option<f64>,
) -> Result<String> {
    for (argument, value) in
        [("max_translation_m", max_translation_m), ("max_rotation_deg", max_rotation_deg)]
    {
        if !(value > 0.0 && value.is_finite()) {
            return Err(Error::input(argument, value.to_string(), "a positive number", "pass another limit"));
        }
    }
    let errors = evaluate_against_truth(reconstruction, truth)?;
    let limits = Limits { max_translation_m, max_rotation_deg, within_m: None };
    let placement = PlacementReport::new(reconstruction, &errors, &[], limits);
    let document = serde_json::json!({
        "errors": errors,
        "placement": placement,
        "recall": placement.right_share(),
        "registration_recall": registration_recall,
    });
    Ok(document.to_string())
}
