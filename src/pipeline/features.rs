//! Features of all scans: from files, from the cache of an earlier run, or computed.

use crate::config::Config;
use crate::descriptor::{self, WorkingScale};
use crate::error::{Error, Result};
use crate::io;
use crate::monitor::Monitor;
use crate::scan::{Features, PointCloud, Scan, Surface};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Raised when cached features of an older version must not be used any more.
const CACHE_VERSION: u32 = 1;
const STAGE: &str = "features";

/// Where features may come from.
#[derive(Debug, Clone, Copy)]
pub enum FeatureSource<'a> {
    /// Computed every time.
    Computed,
    /// Computed, and kept in this folder, which is made when needed.
    Cached(&'a Path),
    /// Computed by another program, one entry a scan.
    Given(&'a [Features]),
}

/// Features of every scan, and which of them were not computed now.
pub(super) fn of_scans(
    scans: &[Scan],
    surfaces: &[Surface],
    scale: &WorkingScale,
    config: &Config,
    source: &FeatureSource<'_>,
    monitor: &dyn Monitor,
) -> Result<(Vec<Features>, Vec<bool>)> {
    let cache = match source {
        FeatureSource::Given(features) if features.len() == scans.len() => {
            return Ok((features.to_vec(), vec![true; scans.len()]));
        }
        FeatureSource::Given(features) => {
            return Err(Error::input(
                "features",
                format!("those of {} scans", features.len()),
                format!("one set for each of {} scans", scans.len()),
                "give the features of exactly these scans",
            ));
        }
        FeatureSource::Computed => None,
        FeatureSource::Cached(folder) => {
            std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
            Some(*folder)
        }
    };
    monitor.begin(STAGE, scans.len());
    let results: Vec<Result<(Features, bool)>> = scans
        .par_iter()
        .zip(surfaces)
        .map(|(scan, surface)| {
            monitor.check(STAGE)?;
            let compute = || descriptor::describe(scan, surface, scale, &config.descriptor, config.seed);
            let result = match cache {
                None => (compute()?, false),
                Some(folder) => through_cache(&entry(folder, scan, scale, config), compute)?,
            };
            monitor.advance(1);
            Ok(result)
        })
        .collect();
    monitor.end();
    let pairs: Vec<(Features, bool)> = results.into_iter().collect::<Result<_>>()?;
    Ok(pairs.into_iter().unzip())
}

/// The cached features, or computed ones that are then cached.
fn through_cache(path: &Path, compute: impl FnOnce() -> Result<Features>) -> Result<(Features, bool)> {
    if path.exists() {
        match io::features::read_npz(path) {
            Ok(features) => return Ok((features, true)),
            Err(error) => tracing::warn!("computing again what the cache should hold: {error}"),
        }
    }
    let features = compute()?;
    io::features::write_npz(path, &features)?;
    Ok((features, false))
}

/// File of a scan's features: named by everything they depend on, so that it never goes stale.
fn entry(folder: &Path, scan: &Scan, scale: &WorkingScale, config: &Config) -> PathBuf {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&CACHE_VERSION.to_le_bytes());
    hasher.update(config.descriptor.features_hash(scale, config.seed).as_bytes());
    hash_cloud(&mut hasher, &scan.cloud);
    folder.join(format!("{}.npz", &hasher.finalize().to_hex()[..32]))
}

/// The content of a cloud, whatever file format it came in.
fn hash_cloud(hasher: &mut blake3::Hasher, cloud: &PointCloud) {
    let mut block = Vec::with_capacity(12 * 4096);
    hasher.update(&(cloud.points.len() as u64).to_le_bytes());
    for points in [cloud.viewpoint].chunks(1).chain(cloud.points.chunks(4096)) {
        block.clear();
        block.extend(points.iter().flat_map(|p| p.coords.iter().flat_map(|v| v.to_le_bytes())));
        hasher.update(&block);
    }
}
