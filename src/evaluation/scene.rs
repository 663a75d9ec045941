//! Ground truth of one scene of a data set: its scans, their poses, and the pairs
//! that its benchmarks count.

use super::protocol::Protocol;
use crate::geometry::RigidMotion;
use crate::io::{read_benchmark, read_scene};
use crate::io::{read_overlaps, scan_files, unique_names};
use crate::scan::PairTruth;
use crate::{Error, Result};
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};

/// Name of the file that lists a benchmark's pairs.
pub const PAIRS_FILE: &str = "gt.log";

/// A benchmark of a data set.
#[derive(Debug, Clone, PartialEq)]
pub struct Benchmark {
    /// What it is called in tables.
    pub name: String,
    /// How it counts.
    pub protocol: Protocol,
    /// Folder with `<scene>/gt.log` and gt.info, or with those of the only scene; `None` where they
    /// lie beside the scans.
    pub folder: Option<PathBuf>,
}

/// The pairs that one benchmark counts in one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenePairs {
    /// Name of the benchmark.
    pub benchmark: String,
    /// How it counts.
    pub protocol: Protocol,
    /// The pairs; ids are the scans' numbers, as in gt.log.
    pub pairs: Vec<PairTruth>,
    /// Overlap of pairs of numbers, as published in gt_overlap.log; empty where there is none.
    pub overlaps: BTreeMap<(usize, usize), f32>,
}

/// Truth of one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneTruth {
    /// Name of the scene.
    pub name: String,
    /// Names of its scans, in order.
    pub scans: Vec<String>,
    /// Number of each scan, by which gt.log calls it.
    pub numbers: Vec<usize>,
    /// True `world_from_scan` of each scan, where known.
    pub world_from_scan: Option<Vec<RigidMotion>>,
    /// How far the worst rotation of any truth file was from orthonormal before it was replaced
    /// by the nearest rotation.
    pub deviation: f64,
    /// The benchmarks that count pairs.
    pub pairs: Vec<ScenePairs>,
}

impl SceneTruth {
    /// Reads the truth of the scene in `folder`. Where scans have no poses, they are chained from
    /// the pairs of gt.log, if these connect all scans.
    ///
    /// # Errors
    /// Files that cannot be read or do not fit; fewer than two scans; a pair of gt.log whose scan
    /// is missing; the ScanNet protocol without poses.
    pub fn read(folder: &Path, benchmarks: &[Benchmark]) -> Result<Self> {
        let scene = read_scene(folder)?;
        if let [only] = &scene.scans[..] {
            return Err(Error::file(
                folder,
                format!("one scan, {}", only.display()),
                "at least two scans to be registered with each other",
                "add the other scans, or leave this scene out",
            ));
        }
        let numbers = numbers(folder, &scene.numbers(), !benchmarks.is_empty())?;
        let mut deviation = scene.world_from_scan.as_ref().map_or(0.0, |t| t.deviation);
        let mut pairs = Vec::new();
        for benchmark in benchmarks.iter().filter(|b| b.protocol != Protocol::Scannet) {
            let place = benchmark.place(folder, &scene.name)?;
            let read = read_benchmark(&place)?;
            check_pairs(&place, &read.pairs, &numbers)?;
            deviation = deviation.max(read.deviation);
            let published = place.join("gt_overlap.log");
            let overlaps = if published.is_file() { read_overlaps(&published)? } else { BTreeMap::new() };
            let (benchmark, protocol) = (benchmark.name.clone(), benchmark.protocol);
            pairs.push(ScenePairs { benchmark, protocol, pairs: read.pairs, overlaps });
        }
        let world_from_scan = match scene.world_from_scan {
            Some(poses) => Some(poses.value),
            None => chained(&numbers, pairs.iter().flat_map(|b| &b.pairs)),
        };
        if world_from_scan.is_none() && benchmarks.iter().any(|b| b.protocol == Protocol::Scannet) {
            return Err(Error::file(
                folder,
                "scans without true poses",
                "truth.json, a pose file beside each scan, poses/, poses.txt, one .conf, or a gt.log that connects all scans",
                "add the poses, or choose another protocol",
            ));
        }
        let scans = unique_names(&scene.scans);
        Ok(Self { name: scene.name, scans, numbers, world_from_scan, deviation, pairs })
    }

    /// Error from which a pose is wrong when failures are looked into, metres: that of the
    /// strictest benchmark.
    pub fn wrong_beyond_m(&self) -> f64 {
        let strictest = self.pairs.iter().map(|b| b.protocol.wrong_beyond_m()).reduce(f64::min);
        strictest.unwrap_or(Protocol::Scannet.wrong_beyond_m())
    }

    /// Index of the scan with a number, for every number.
    pub fn by_number(&self) -> BTreeMap<usize, usize> {
        self.numbers.iter().enumerate().map(|(index, &number)| (number, index)).collect()
    }
}

impl Benchmark {
    /// Folder of the pairs of one scene.
    fn place(&self, scene_folder: &Path, scene: &str) -> Result<PathBuf> {
        let candidates = match &self.folder {
            Some(folder) => vec![folder.join(scene), folder.join(scene).join("PointCloud"), folder.clone()],
            None => vec![scene_folder.to_path_buf(), scene_folder.join("PointCloud")],
        };
        candidates.iter().find(|c| c.join(PAIRS_FILE).is_file()).cloned().ok_or_else(|| {
            Error::file(
                &candidates[0],
                "no gt.log",
                format!("gt.log (and gt.info) of the scene {scene} for the benchmark {}", self.name),
                "correct the folder of the benchmark, or leave this scene out",
            )
        })
    }
}

/// Folders of the scenes under `folder`, naturally sorted: those named, or else every subfolder
/// that holds scans, or else `folder` itself.
///
/// # Errors
/// A named scene that is missing, or no scene at all.
pub fn find_scenes(folder: &Path, named: &[String]) -> Result<Vec<PathBuf>> {
    if !named.is_empty() {
        return named
            .iter()
            .map(|name| {
                let scene = folder.join(name);
                if scene.is_dir() {
                    return Ok(scene);
                }
                let remedy = "correct the name, or leave the scene out";
                Err(Error::file(&scene, "no such folder", "a scene of the data set", remedy))
            })
            .collect();
    }
    let entries = std::fs::read_dir(folder).map_err(|e| Error::read(folder, e))?;
    let mut found: Vec<PathBuf> = entries
        .filter_map(|e| e.ok().map(|e| e.path()))
        .filter(|p| p.is_dir() && !is_part_of_a_scene(p) && scan_files(p).is_ok())
        .collect();
    found.sort_by(|a, b| natord::compare(&a.to_string_lossy(), &b.to_string_lossy()).then(a.cmp(b)));
    if found.is_empty() {
        scan_files(folder).map_err(|_| {
            Error::file(
                folder,
                "no scene",
                "subfolders with scans (or scans themselves), as in 3dmatch/<scene>/PointCloud/cloud_bin_0.ply",
                "name the folder that holds the scenes",
            )
        })?;
        found.push(folder.to_path_buf());
    }
    Ok(found)
}

/// Subfolders in which a scene keeps its own scans.
fn is_part_of_a_scene(folder: &Path) -> bool {
    folder.file_name().is_some_and(|n| n == "PointCloud" || n == "depth" || n == "cache")
}

/// Every scan's number; its place where names carry none and no benchmark asks for them.
fn numbers(folder: &Path, found: &[Option<usize>], needed: bool) -> Result<Vec<usize>> {
    let distinct: std::collections::BTreeSet<_> = found.iter().flatten().collect();
    if distinct.len() == found.len() {
        return Ok(found.iter().flatten().copied().collect());
    }
    if !needed {
        return Ok((0..found.len()).collect());
    }
    Err(Error::file(
        folder,
        format!("{} scans whose names end in {} different numbers", found.len(), distinct.len()),
        "a number of its own at the end of every scan's name, by which gt.log calls it",
        "rename the scans as in cloud_bin_12.ply",
    ))
}

fn check_pairs(place: &Path, pairs: &[PairTruth], numbers: &[usize]) -> Result<()> {
    let known = |n: usize| numbers.contains(&n);
    let Some(pair) = pairs.iter().find(|p| !known(p.i.0) || !known(p.j.0)) else { return Ok(()) };
    let missing = if known(pair.i.0) { pair.j } else { pair.i };
    Err(Error::file(
        place.join(PAIRS_FILE),
        format!("the pair {} {}", pair.i, pair.j),
        format!("numbers of the {} scans of the scene; there is no scan {missing}", numbers.len()),
        "add the missing scan, or use the gt.log of this scene",
    ))
}

/// `world_from_scan` of every scan in the frame of the first, by the fewest steps from pair to
/// pair; `None` where the pairs do not connect all scans.
fn chained<'a>(numbers: &[usize], pairs: impl Iterator<Item = &'a PairTruth>) -> Option<Vec<RigidMotion>> {
    let index: BTreeMap<usize, usize> = numbers.iter().enumerate().map(|(k, &n)| (n, k)).collect();
    let mut edges: Vec<Vec<(usize, RigidMotion)>> = vec![Vec::new(); numbers.len()];
    for pair in pairs {
        let (i, j) = (*index.get(&pair.i.0)?, *index.get(&pair.j.0)?);
        edges[i].push((j, pair.i_from_j));
        edges[j].push((i, pair.i_from_j.inverse()));
    }
    let mut poses: Vec<Option<RigidMotion>> = vec![None; numbers.len()];
    *poses.first_mut()? = Some(RigidMotion::identity());
    let mut queue = VecDeque::from([0]);
    while let Some(i) = queue.pop_front() {
        let here = poses[i]?;
        for &(j, i_from_j) in &edges[i] {
            if poses[j].is_none() {
                poses[j] = Some(here * i_from_j);
                queue.push_back(j);
            }
        }
    }
    poses.into_iter().collect()
}

#[cfg(test)]
#[path = "scene_tests.rs"]
mod tests;
