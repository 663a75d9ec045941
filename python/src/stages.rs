//! The stages of a registration that several processes share out.

use crate::calls::{Given, gathered};
use crate::config::PyConfig;
use crate::errors::OrRaise;
use crate::watched::watched;
use pyo3::prelude::*;
use scanweave::pipeline::{self, FeatureSource, Shard};
use scanweave::result_folder::{StageFolder, kept_features};
use scanweave::{Error, Result};
use std::path::{Path, PathBuf};

/// Refuses settings whose first pairs cannot be registered in shards.
#[pyfunction]
pub fn check_shards(py: Python<'_>, config: &Bound<'_, PyConfig>) -> PyResult<()> {
    pipeline::check_shards(&config.get().config).or_raise(py)
}

/// Features of the scans of a shard, into files of a folder.
#[pyfunction]
#[pyo3(signature = (scans, config, output, shard, force, threads, progress))]
#[expect(clippy::too_many_arguments, reason = "the arguments of a function of Python")]
pub fn describe_shard(
    py: Python<'_>,
    scans: Vec<Given<'_>>,
    config: &Bound<'_, PyConfig>,
    output: PathBuf,
    shard: (usize, usize),
    force: bool,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<()> {
    let scans = gathered(py, scans)?;
    let config = &config.get().config;
    watched(py, progress.as_ref(), threads, |monitor| {
        let folder = open(&output, shard)?;
        let cache = folder.cache();
        folder.describe(&scans, config, &FeatureSource::Cached(&cache), force, monitor).map(|_| ())
    })
}

/// First pairs of a shard, of described scans, into a file of a folder.
#[pyfunction]
#[pyo3(signature = (scans, config, described, output, shard, force, threads, progress))]
#[expect(clippy::too_many_arguments, reason = "the arguments of a function of Python")]
pub fn register_shard(
    py: Python<'_>,
    scans: Vec<Given<'_>>,
    config: &Bound<'_, PyConfig>,
    described: PathBuf,
    output: PathBuf,
    shard: (usize, usize),
    force: bool,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<()> {
    let scans = gathered(py, scans)?;
    let config = &config.get().config;
    watched(py, progress.as_ref(), threads, |monitor| {
        let kept = kept_features(&described);
        let folder = open(&output, shard)?;
        folder.register_pairs(&scans, config, &FeatureSource::Kept(&kept), force, monitor).map(|_| ())
    })
}

fn open(folder: &Path, (index, count): (usize, usize)) -> Result<StageFolder> {
    if index < count {
        return StageFolder::open(folder, Shard { index, count });
    }
    let (found, expected) = (format!("shard {index} of {count}"), "a shard from 0 to their number less one");
    Err(Error::input("shard", found, expected, "pass another one"))
}
