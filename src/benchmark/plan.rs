//! From a suite to the list of its cells, each with a hash of everything it depends on.

use super::cell::{self, CellKey};
use super::suite::{DataSet, Method, SimilarityChoice, Suite};
use crate::Monitor;
use crate::evaluation::protocol::Protocol;
use crate::evaluation::scene::{Benchmark, find_scenes};
use crate::io::scan_files;
use crate::pipeline::Shard;
use crate::{Error, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A cell that is to be computed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlannedCell {
    /// Which.
    pub key: CellKey,
    /// Digest of all settings and data that it depends on, the program apart.
    pub hash: String,
}

/// The cells of a suite, scene by scene.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Plan {
    /// All cells, those of other shards too.
    pub cells: Vec<PlannedCell>,
}

/// Where a scene comes from.
#[derive(Debug, Clone)]
pub(super) enum SceneSource {
    /// A folder.
    Folder(PathBuf),
    /// Made with this seed.
    Synthetic(u64),
}

/// A scene of the suite.
#[derive(Debug, Clone)]
pub(super) struct PlannedScene {
    /// Index of its data set.
    pub dataset: usize,
    /// Its name.
    pub name: String,
    /// Where it comes from.
    pub source: SceneSource,
    /// Digest of its scans, truth and given features.
    pub hash: String,
}

/// A cell with what it takes to compute it.
#[derive(Debug, Clone)]
pub(super) struct Task {
    /// Index of the scene.
    pub scene: usize,
    /// Index of the method.
    pub method: usize,
    /// Which cell and its hash.
    pub cell: PlannedCell,
}

/// Scenes and tasks of a suite.
pub(super) struct Tasks {
    pub scenes: Vec<PlannedScene>,
    pub tasks: Vec<Task>,
}

impl Tasks {
    /// The list of cells.
    pub fn plan(&self) -> Plan {
        Plan { cells: self.tasks.iter().map(|t| t.cell.clone()).collect() }
    }

    /// The tasks of one shard: a contiguous stretch, so that few scenes are loaded by more than one.
    pub fn of_shard(&self, shard: Shard) -> &[Task] {
        &self.tasks[shard.range(self.tasks.len())]
    }
}

/// Finds the scenes of a suite and lists its cells: scene by scene, within it seed by seed, then
/// method by method.
pub(super) fn tasks(suite: &Suite, data_root: &Path, monitor: &dyn Monitor) -> Result<Tasks> {
    let mut scenes = Vec::new();
    for (index, dataset) in suite.datasets.iter().enumerate() {
        scenes.extend(scenes_of(index, dataset, data_root, monitor)?);
    }
    let mut files = FileHashes::default();
    let mut tasks = Vec::new();
    for (at, scene) in scenes.iter().enumerate() {
        let dataset = &suite.datasets[scene.dataset];
        for &seed in &suite.seeds {
            for (method_at, method) in suite.methods.iter().enumerate() {
                for &keypoints in &suite.keypoints {
                    let key = CellKey {
                        dataset: dataset.name.clone(),
                        scene: scene.name.clone(),
                        method: method.name.clone(),
                        keypoints,
                        seed,
                    };
                    let hash = cell_hash(suite, dataset, method, &key, &scene.hash, &mut files)?;
                    tasks.push(Task { scene: at, method: method_at, cell: PlannedCell { key, hash } });
                }
            }
        }
    }
    Ok(Tasks { scenes, tasks })
}

/// Seed that the computed keypoints are chosen with.
pub(super) fn feature_seed(suite: &Suite, seed: u64) -> u64 {
    if suite.vary_features { seed } else { 0 }
}

/// The benchmarks of a data set, with folders under the data root.
pub(super) fn benchmarks(dataset: &DataSet, data_root: &Path) -> Vec<Benchmark> {
    let place = |b: &super::suite::BenchmarkSource| b.folder.as_ref().map(|f| data_root.join(f));
    let benchmark = |b: &super::suite::BenchmarkSource| Benchmark {
        name: b.name.clone(),
        protocol: b.protocol,
        folder: place(b),
    };
    dataset.benchmarks.iter().map(benchmark).collect()
}

/// Folder of a scene's given features.
pub(super) fn features_folder(dataset: &DataSet, data_root: &Path, scene: &str) -> Option<PathBuf> {
    dataset.features.as_ref().map(|f| data_root.join(f.replace("{scene}", scene)))
}

fn scenes_of(
    index: usize,
    dataset: &DataSet,
    data_root: &Path,
    monitor: &dyn Monitor,
) -> Result<Vec<PlannedScene>> {
    if let Some(config) = &dataset.synthetic {
        let made = |&seed: &u64| PlannedScene {
            dataset: index,
            name: format!("{}-{seed}", dataset.name),
            source: SceneSource::Synthetic(seed),
            hash: digest(&format!("{config:?};seed={seed}")),
        };
        return Ok(dataset.synthetic_seeds.iter().map(made).collect());
    }
    let folders = find_scenes(&data_root.join(&dataset.folder), &dataset.scenes)?;
    monitor.begin("looking at scenes", folders.len());
    let scenes = folders
        .into_iter()
        .map(|folder| {
            monitor.check("looking at scenes")?;
            let absolute = std::fs::canonicalize(&folder).map_err(|e| Error::read(&folder, e))?;
            let name = absolute.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            let hash = scene_hash(&folder, &name, dataset, data_root)?;
            monitor.advance(1);
            Ok(PlannedScene { dataset: index, name, source: SceneSource::Folder(folder), hash })
        })
        .collect();
    monitor.end();
    scenes
}

/// Digest of a scene: its scans, every small file beside them (poses, pairs), its benchmarks'
/// files and its given features.
fn scene_hash(folder: &Path, name: &str, dataset: &DataSet, data_root: &Path) -> Result<String> {
    let scans = scan_files(folder)?;
    let mut folders = vec![folder.to_path_buf(), folder.join("PointCloud"), folder.join("poses")];
    for benchmark in &dataset.benchmarks {
        if let Some(folder) = &benchmark.folder {
            let place = data_root.join(folder);
            folders.extend([place.join(name), place.join(name).join("PointCloud"), place]);
        }
    }
    let mut files = scans;
    for folder in folders.iter().filter(|f| f.is_dir()) {
        files.extend(listed(folder)?.into_iter().filter(|p| is_truth(p)));
    }
    if let Some(given) = features_folder(dataset, data_root, name) {
        // The published layout keeps keypoints beside the descriptors.
        for folder in [given.with_file_name("Keypoints"), given].iter().filter(|f| f.is_dir()) {
            files.extend(listed(folder)?);
        }
    }
    let hashes: Vec<Result<String>> = files.par_iter().map(|p| file_digest(p)).collect();
    let mut all = String::new();
    for (file, hash) in files.iter().zip(hashes) {
        let file = file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        all.push_str(&format!("{file}={};", hash?));
    }
    Ok(digest(&all))
}

fn is_truth(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "txt" || e == "log" || e == "info" || e == "conf")
}

/// Files of a folder, sorted by name.
fn listed(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::read(folder, e))?;
    let mut files: Vec<PathBuf> =
        entries.filter_map(|e| e.ok().map(|e| e.path())).filter(|p| p.is_file()).collect();
    files.sort();
    Ok(files)
}

fn file_digest(path: &Path) -> Result<String> {
    let mut file = crate::files::open(path)?;
    let mut hasher = blake3::Hasher::new();
    std::io::copy(&mut file, &mut hasher).map_err(|e| Error::read(path, e))?;
    Ok(hasher.finalize().to_hex().to_string())
}

fn digest(text: &str) -> String {
    blake3::hash(text.as_bytes()).to_hex().to_string()
}

/// Digests of files that settings name, each read once.
#[derive(Default)]
struct FileHashes(BTreeMap<PathBuf, String>);

impl FileHashes {
    /// Digests of all files that values of a table name.
    fn of_settings(&mut self, value: &toml::Value) -> Result<String> {
        let mut text = String::new();
        match value {
            toml::Value::String(s) if Path::new(s).is_file() => {
                let path = PathBuf::from(s);
                if !self.0.contains_key(&path) {
                    let hash = file_digest(&path)?;
                    self.0.insert(path.clone(), hash);
                }
                text.push_str(&self.0[&path]);
            }
            toml::Value::Array(items) => {
                for item in items {
                    text.push_str(&self.of_settings(item)?);
                }
            }
            toml::Value::Table(table) => {
                for item in table.values() {
                    text.push_str(&self.of_settings(item)?);
                }
            }
            _ => {}
        }
        Ok(text)
    }
}

fn cell_hash(
    suite: &Suite,
    dataset: &DataSet,
    method: &Method,
    key: &CellKey,
    scene_hash: &str,
    files: &mut FileHashes,
) -> Result<String> {
    // The name of a preset is only a label.
    let label = String::new();
    let mut config = method.config_for(dataset, key.seed, key.keypoints)?;
    config.preset = label;
    let text = config.to_toml()?;
    let named = text.parse::<toml::Table>().map(toml::Value::Table).ok();
    let named = named.map_or(Ok(String::new()), |table| files.of_settings(&table))?;
    let protocols: Vec<(&str, Protocol)> =
        dataset.benchmarks.iter().map(|b| (b.name.as_str(), b.protocol)).collect();
    let similarity = match method.similarity {
        SimilarityChoice::Predicted => "predicted",
        SimilarityChoice::Oracle => "oracle",
    };
    Ok(digest(&format!(
        "cell/{};{key};{text};{named};computed={};featureseed={};similarity={similarity};scene={scene_hash};\
         protocols={protocols:?};radius={:?}",
        cell::VERSION,
        suite.computed_keypoints,
        feature_seed(suite, key.seed),
        dataset.overlap_radius_m,
    )))
}
