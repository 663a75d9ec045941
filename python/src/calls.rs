//! The functions of the package.

use crate::config::PyConfig;
use crate::errors::OrRaise;
use crate::matrix;
use crate::run::PyRun;
use crate::scan::{PyScan, points};
use crate::watched::watched;
use numpy::PyArray2;
use pyo3::prelude::*;
use scanweave::pipeline::{self, FeatureSource, PairCache, Stopwatch};
use scanweave::report::remarks::{self, Remark, Weight};
use scanweave::result_folder::kept_features;
use scanweave::scan::ScanId;
use scanweave::synthetic::{self, SynthConfig};
use scanweave::{Config, Scan, io};
use std::path::PathBuf;

/// A scan, and whether the call may take it.
pub type Given<'py> = (Bound<'py, PyScan>, bool);
/// Whether it is a warning, and the text.
pub type Said = (bool, String);

pub fn said(remarks: Vec<Remark>) -> Vec<Said> {
    remarks.into_iter().map(|remark| (remark.weight == Weight::Warning, remark.text)).collect()
}

/// The scans, numbered in their order.
pub fn gathered(py: Python<'_>, given: Vec<Given<'_>>) -> PyResult<Vec<Scan>> {
    let one = |(id, (scan, take)): (usize, Given<'_>)| {
        let scan = scan.get().give(take).or_raise(py)?;
        Ok(Scan { id: ScanId(id), ..scan })
    };
    given.into_iter().enumerate().map(one).collect()
}

/// Every scan of files, folders, patterns and lists; and how they were read.
#[pyfunction]
pub fn read(
    py: Python<'_>,
    inputs: Vec<String>,
    recursive: bool,
    skip_unreadable: bool,
    config: &Bound<'_, PyConfig>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(Vec<PyScan>, Vec<Said>)> {
    let options = &config.get().config.input;
    let read = watched(py, progress.as_ref(), None, |monitor| {
        let found = io::discover_with(&inputs, recursive)?;
        io::read_inputs(&found, options, skip_unreadable, monitor)
    })?;
    let remarks = said(remarks::of_inputs(&read));
    Ok((read.scans.into_iter().map(PyScan::of).collect(), remarks))
}

/// `pipeline::run`. Scans with initial poses have these weighed if `initial_poses`. `stages` are folders of
/// features and of first pairs that other processes computed.
#[pyfunction]
#[pyo3(signature = (scans, config, initial_poses, cache, stages, threads, progress))]
#[expect(clippy::too_many_arguments, reason = "the arguments of a function of Python")]
pub fn register(
    py: Python<'_>,
    scans: Vec<Given<'_>>,
    config: &Bound<'_, PyConfig>,
    initial_poses: bool,
    cache: Option<PathBuf>,
    stages: Option<(PathBuf, PathBuf)>,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<PyRun> {
    let scans = gathered(py, scans)?;
    let mut config: Config = config.get().config.clone();
    config.registration.prior.initial_poses |= initial_poses;
    let kept = stages.as_ref().map(|(described, _)| kept_features(described));
    let source = match (&kept, &cache) {
        (Some(kept), _) => FeatureSource::Kept(kept),
        (None, Some(cache)) => FeatureSource::Cached(cache),
        (None, None) => FeatureSource::Computed,
    };
    let run = watched(py, progress.as_ref(), threads, |monitor| match &stages {
        Some((_, pairs)) => {
            let cache = PairCache::in_memory();
            pipeline::run_with_shards(&scans, &config, &source, &cache, Some(pairs.as_path()), monitor)
        }
        None => pipeline::run(&scans, &config, &source, monitor),
    })?;
    Ok(PyRun { scans, config, run, threads })
}

/// The motion, whether it is accepted, the evidence as JSON, and the reason where it is not.
type Pair = (Option<Py<PyArray2<f64>>>, bool, String, Option<String>);

/// What became of a pair.
#[pyfunction]
pub fn register_pair(
    py: Python<'_>,
    target: Given<'_>,
    source: Given<'_>,
    config: &Bound<'_, PyConfig>,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Pair> {
    let scans = gathered(py, vec![target, source])?;
    let config = &config.get().config;
    let pair = watched(py, progress.as_ref(), threads, |monitor| {
        scanweave::register_pair_with(&scans[0], &scans[1], config, monitor)
    })?;
    let evidence = serde_json::to_string(&pair.evidence).unwrap_or_default();
    let motion = pair.target_from_source.map(|motion| matrix::array(py, &motion));
    Ok((motion, pair.accepted, evidence, pair.declined.map(|reason| reason.to_string())))
}

/// Keypoints `[n,3]` in the coordinates of its file, and descriptors `[n,D]`.
type Described = (Py<PyArray2<f64>>, Py<PyArray2<f32>>);

/// Keypoints and descriptors of every scan.
#[pyfunction]
pub fn describe(
    py: Python<'_>,
    scans: Vec<Given<'_>>,
    config: &Bound<'_, PyConfig>,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Vec<Described>> {
    let scans = gathered(py, scans)?;
    let config = &config.get().config;
    let described = watched(py, progress.as_ref(), threads, |monitor| {
        Ok(pipeline::describe(&scans, config, &FeatureSource::Computed, monitor)?.features_of_files(&scans))
    })?;
    let arrays = described.iter().zip(&scans).map(|(features, scan)| {
        let descriptors = &features.descriptors;
        let values = matrix::rows(py, descriptors.len(), descriptors.dim(), |i, c| descriptors.row(i)[c]);
        (points(py, &features.keypoints, &scan.cloud.origin_m), values)
    });
    Ok(arrays.collect())
}

/// Predicted overlap `[N,N]`.
#[pyfunction]
pub fn predict_overlap(
    py: Python<'_>,
    scans: Vec<Given<'_>>,
    config: &Bound<'_, PyConfig>,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Py<PyArray2<f32>>> {
    let scans = gathered(py, scans)?;
    let config = &config.get().config;
    let similarity = watched(py, progress.as_ref(), threads, |monitor| {
        let described = pipeline::describe(&scans, config, &FeatureSource::Computed, monitor)?;
        Ok(pipeline::predict_overlap(&described, config, monitor, &mut Stopwatch::default())?.0)
    })?;
    Ok(matrix::rows(py, similarity.len(), similarity.len(), |i, j| similarity.get(i, j)))
}

/// Scans, true `world_from_scan` of each, and whether it is of the building.
type Synthetic = (Vec<PyScan>, Vec<Py<PyArray2<f64>>>, Vec<bool>);

/// A synthetic interior.
#[pyfunction]
pub fn synthesize(
    py: Python<'_>,
    scans: usize,
    rooms: usize,
    unrelated: usize,
    noise: f64,
    seed: u64,
) -> PyResult<Synthetic> {
    let config = SynthConfig { scans, rooms, unrelated, noise, seed, ..SynthConfig::default() };
    let set = watched(py, None, None, |monitor| synthetic::generate(&config, monitor))?;
    let truth = set.world_from_scan.iter().map(|pose| matrix::array(py, pose)).collect();
    let of_building = set.building.iter().map(|building| *building == 0).collect();
    Ok((set.scans.into_iter().map(PyScan::of).collect(), truth, of_building))
}
