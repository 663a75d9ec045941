//! Features of all scans: from files, from the cache of an earlier run, or computed.

use crate::config::Config;
use crate::descriptor::Describer;
use crate::error::{Error, Result};
use crate::io::features::CacheKey;
use crate::io::{self, ReadOptions};
use crate::monitor::Monitor;
use crate::scan::{Features, PointCloud, Scan, Surface, WorkingScale};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Raised when cached features of an older version must not be used any more.
const CACHE_VERSION: u32 = 4;
const STAGE: &str = "features";

/// Where features may come from.
#[derive(Debug, Clone, Copy)]
pub enum FeatureSource<'a> {
    /// Computed every time.
    Computed,
    /// Computed, and kept in this folder, which is made when needed.
    Cached(&'a Path),
    /// From this folder, where an earlier run kept them: one that it lacks is an error.
    Kept(&'a Path),
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
    let (cache, must_be_kept) = match source {
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
        FeatureSource::Computed => (None, false),
        FeatureSource::Kept(folder) => (Some(*folder), true),
        FeatureSource::Cached(folder) => {
            std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
            (Some(*folder), false)
        }
    };
    let describer = Describer::new(&config.descriptor)?;
    monitor.begin(STAGE, scans.len());
    let results: Vec<Result<(Features, bool)>> = scans
        .par_iter()
        .zip(surfaces)
        .map(|(scan, surface)| {
            monitor.check(STAGE)?;
            let compute = || describer.describe(scan, surface, scale, config.seed);
            let key = || key(scan, surface, describer.features_hash(scale, config.seed));
            let result = match cache {
                None => (io::features::as_read(compute()?), false),
                Some(folder) if must_be_kept => (kept(folder, scan, &key())?, true),
                Some(folder) => through_cache(folder, &key(), compute)?,
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
///
/// An entry is named by its key, so that it never goes stale, and holds it, so that a file that was
/// renamed or copied is not taken for another.
fn through_cache(
    folder: &Path,
    key: &CacheKey,
    compute: impl FnOnce() -> Result<Features>,
) -> Result<(Features, bool)> {
    let path = &entry(folder, key);
    if path.exists() {
        match io::features::read_cached(path, key) {
            Ok(features) => return Ok((features, true)),
            Err(error) => tracing::warn!("computing again what the cache should hold: {error}"),
        }
    }
    io::features::write_cached(path, &compute()?, key)?;
    // Reading normalises descriptors, which may change a last bit: only what was read back is
    // the same in this run and in the next.
    Ok((io::features::read_cached(path, key)?, false))
}

/// The features of a scan that an earlier run kept.
fn kept(folder: &Path, scan: &Scan, key: &CacheKey) -> Result<Features> {
    let path = entry(folder, key);
    if path.exists() {
        return io::features::read_cached(&path, key).map_err(|error| match error {
            Error::File { path, found, expected, .. } => {
                Error::file(path, found, expected, "delete it and run `scanweave describe` again")
            }
            other => other,
        });
    }
    let found = format!("no features of {} among these scans, with these settings and this seed", scan.name);
    let expected = "those of every scan, as `scanweave describe` keeps them";
    let remedy = "run `scanweave describe` with the same scans and settings, for every shard";
    Err(Error::file(folder, found, expected, remedy))
}

fn entry(folder: &Path, key: &CacheKey) -> PathBuf {
    folder.join(format!("{}.npz", &blake3::Hash::from(*key).to_hex()[..32]))
}

/// Features of every scan that another program computed: `<folder>/<name of the scan>.npz`, or,
/// where `folder` is named `<descriptor>_desc`, the layout of SGHR and IMVR around it. Of `options` counts
/// how much an archive may unpack to.
///
/// # Errors
/// A file is missing, unreadable, or its arrays disagree; or the user asked to stop.
pub fn read_features(
    folder: &Path,
    scans: &[Scan],
    options: &ReadOptions,
    monitor: &dyn Monitor,
) -> Result<Vec<Features>> {
    let name = folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let published = name.strip_suffix("_desc").filter(|_| !folder.is_file());
    monitor.begin("reading features", scans.len());
    let results: Vec<Result<Features>> = scans
        .par_iter()
        .map(|scan| {
            monitor.check("reading features")?;
            let own = folder.join(format!("{}.npz", scan.name));
            let features = match published {
                Some(descriptor) if !own.exists() => {
                    let dataset = folder.parent().unwrap_or(Path::new(""));
                    io::features::read_sghr_features(dataset, descriptor, number_of(scan)?, &scan.cloud)
                }
                _ => io::features::read_features_with(&own, options),
            };
            monitor.advance(1);
            features
        })
        .collect();
    monitor.end();
    results.into_iter().collect()
}

/// The number at the end of a scan's name, by which the published layout calls it.
fn number_of(scan: &Scan) -> Result<usize> {
    let digits = scan.name.len() - scan.name.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    scan.name[scan.name.len() - digits..].parse().map_err(|_| {
        Error::input(
            scan.name.as_str(),
            "a name without a number at its end",
            "scans named as in cloud_bin_12.ply",
            "rename the scans, or give one NPZ a scan",
        )
    })
}

/// Digest of everything that the features of a scan depend on: its content, the settings, and what its
/// collection decides, the lengths among the settings and where it was seen from.
fn key(scan: &Scan, surface: &Surface, settings: String) -> CacheKey {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&CACHE_VERSION.to_le_bytes());
    hasher.update(settings.as_bytes());
    hash_cloud(&mut hasher, &scan.cloud);
    let place = surface.viewpoint.coords.iter().chain([&surface.viewpoint_confidence]);
    place.for_each(|v| {
        hasher.update(&v.to_le_bytes());
    });
    hasher.finalize().into()
}

/// The content of a cloud, whatever file format it came in.
pub(super) fn hash_cloud(hasher: &mut blake3::Hasher, cloud: &PointCloud) {
    let mut block = Vec::with_capacity(12 * 4096);
    hasher.update(&(cloud.points.len() as u64).to_le_bytes());
    hasher.update(&[u8::from(cloud.viewpoint.is_some())]);
    for points in cloud.viewpoint.as_slice().chunks(1).chain(cloud.points.chunks(4096)) {
        block.clear();
        block.extend(points.iter().flat_map(|p| p.coords.iter().flat_map(|v| v.to_le_bytes())));
        hasher.update(&block);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use crate::scan::Descriptors;

    /// One keypoint at `x`.
    fn features(x: f32) -> Features {
        let descriptors = Descriptors::new(2, vec![0.6, 0.8]).unwrap();
        Features::new(vec![Point::new(x, 0.0, 0.0)], None, descriptors).unwrap()
    }

    #[test]
    fn what_is_not_kept_is_the_same_as_what_is() {
        let place = tempfile::tempdir().unwrap();
        // Lengths whose last bits change when they are made unit length again.
        let values: Vec<f32> = (1..=300).map(|k| (k as f32).sin() / 3.0).collect();
        let descriptors = Descriptors::new(3, values.clone()).unwrap().normalized();
        let normals = values.chunks_exact(3).map(|v| nalgebra::Vector3::new(v[0], v[1], v[2]).normalize());
        let keypoints = values.chunks_exact(3).map(|v| Point::new(v[0], v[1], v[2])).collect();
        let computed = Features::new(keypoints, Some(normals.collect()), descriptors).unwrap();
        let (kept, _) = through_cache(place.path(), &[1; 32], || Ok(computed.clone())).unwrap();
        assert_ne!(kept, computed);
        assert_eq!(io::features::as_read(computed), kept);
    }

    #[test]
    fn entries_of_two_scans_that_are_swapped_are_made_again() {
        let place = tempfile::tempdir().unwrap();
        let keys: [CacheKey; 2] = [[1; 32], [2; 32]];
        let get = |k: usize| {
            through_cache(place.path(), &keys[k], || Ok(features(k as f32 + 1.0)))
                .map(|(f, reused)| (f.keypoints[0].x, reused))
                .unwrap()
        };
        assert_eq!([get(0), get(1)], [(1.0, false), (2.0, false)]);
        assert_eq!([get(0), get(1)], [(1.0, true), (2.0, true)]);
        let names = ["01", "02"].map(|byte| place.path().join(byte.repeat(16) + ".npz"));
        let other = place.path().join("other");
        std::fs::rename(&names[0], &other).unwrap();
        std::fs::rename(&names[1], &names[0]).unwrap();
        std::fs::rename(&other, &names[1]).unwrap();
        assert_eq!([get(0), get(1)], [(1.0, false), (2.0, false)]);
        // So is one without a key.
        io::features::write_features(&names[0], &features(7.0)).unwrap();
        assert_eq!([get(0), get(1)], [(1.0, false), (2.0, true)]);
    }
}
