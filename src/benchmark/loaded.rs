//! A scene in memory, shared by all its cells.

use super::plan::{PlannedScene, SceneSource, benchmarks, features_folder};
use super::suite::{DataSet, Suite};
use crate::Monitor;
use crate::Result;
use crate::config::Config;
use crate::evaluation::diagnosis::{Case, Diagnosis};
use crate::evaluation::ground_truth::{LO_MATCH_OVERLAP, MATCH_OVERLAP, overlap_matrix, truth_of_pairs};
use crate::evaluation::moments::Moments;
use crate::evaluation::protocol::Protocol;
use crate::evaluation::recall::{PairRecall, RecallReport};
use crate::evaluation::scene::{ScenePairs, SceneTruth};
use crate::files;
use crate::geometry::voxel_means;
use crate::geometry::{Point, RigidMotion};
use crate::io;
use crate::pipeline::{self, Described, FeatureSource, PairCache, Stopwatch};
use crate::result::StageTime;
use crate::scan::{Features, Reconstruction, Scan, SimilarityMatrix};
use crate::synthetic::{self, SynthConfig};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// A scene with its truth.
pub(super) struct LoadedScene {
    pub scans: Vec<Scan>,
    pub truth: SceneTruth,
    /// True overlap of all pairs, where the poses are known.
    pub overlap: Option<SimilarityMatrix>,
    /// Moments of the scans' points.
    pub moments: Vec<Moments>,
    /// Pairs of scans, registered by whichever cell needs them first.
    pub pairs: PairCache,
    given: Option<Vec<Features>>,
    /// The scans described by the latest settings asked for.
    described: Option<(String, Described, Vec<StageTime>)>,
}

impl LoadedScene {
    /// Reads or makes the scene. Overlaps are kept in the folder `cache`.
    pub fn load(
        suite: &Suite,
        scene: &PlannedScene,
        data_root: &Path,
        cache: &Path,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        let dataset = &suite.datasets[scene.dataset];
        let (scans, truth) = match &scene.source {
            SceneSource::Folder(folder) => {
                let truth = SceneTruth::read(folder, &benchmarks(dataset, data_root))?;
                (io::read_scans(&io::scan_files(folder)?, monitor)?, truth)
            }
            SceneSource::Synthetic(seed) => made(dataset, *seed, &scene.name, monitor)?,
        };
        let given = match features_folder(dataset, data_root, &scene.name) {
            Some(folder) => {
                Some(pipeline::read_features(&folder, &scans, &io::ReadOptions::default(), monitor)?)
            }
            None => None,
        };
        let overlap = match &truth.world_from_scan {
            Some(poses) => {
                let name = format!("overlap-{}-{:?}.json", &scene.hash[..32], dataset.overlap_radius_m);
                Some(cached_overlap(&cache.join(name), &scans, poses, dataset.overlap_radius_m)?)
            }
            None => None,
        };
        let moments = scans.iter().map(|s| Moments::of(&s.cloud.points)).collect();
        let pairs = PairCache::in_folder(cache);
        Ok(Self { scans, truth, overlap, moments, pairs, given, described: None })
    }

    /// Surfaces and features under `config`, kept for the next cell that asks for the same, and
    /// the time that each stage took when they were made.
    pub fn described(
        &mut self,
        config: &Config,
        cache: &Path,
        monitor: &dyn Monitor,
    ) -> Result<(&Described, &[StageTime])> {
        let wanted = format!("{:?} {:?} {}", config.scale, config.descriptor, config.seed);
        let kept = self.described.take().filter(|(key, ..)| *key == wanted);
        let entry = match kept {
            Some(entry) => entry,
            None => {
                let source = match &self.given {
                    Some(features) => FeatureSource::Given(features),
                    None => FeatureSource::Cached(cache),
                };
                let mut clock = Stopwatch::default();
                let described = pipeline::describe_timed(&self.scans, config, &source, monitor, &mut clock)?;
                (wanted, described, clock.stages)
            }
        };
        let (_, described, stages) = self.described.insert(entry);
        Ok((described, stages))
    }
}

impl LoadedScene {
    /// Overlap of the counted pairs of every benchmark: as published, else as computed.
    pub fn pair_overlaps(
        &self,
        recalls: &BTreeMap<String, RecallReport>,
    ) -> BTreeMap<String, Vec<Option<f32>>> {
        let by_number = self.truth.by_number();
        let computed =
            |i: usize, j: usize| Some(self.overlap.as_ref()?.get(*by_number.get(&i)?, *by_number.get(&j)?));
        let of = |(name, report): (&String, &RecallReport)| {
            let published = self.truth.pairs.iter().find(|b| b.benchmark == *name).map(|b| &b.overlaps);
            let look_up = |p: &PairRecall| {
                let (i, j) = (p.i.0, p.j.0);
                let found = published.and_then(|o| o.get(&(i, j)).or_else(|| o.get(&(j, i))).copied());
                found.or_else(|| computed(i, j))
            };
            (name.clone(), report.pairs.iter().map(look_up).collect())
        };
        recalls.iter().map(of).collect()
    }

    /// Why pairs of a reconstruction failed; `None` without true poses.
    pub fn diagnose(
        &self,
        reconstruction: &Reconstruction,
        recalls: &BTreeMap<String, RecallReport>,
    ) -> Option<Diagnosis> {
        let case = Case {
            names: &self.truth.scans,
            numbers: &self.truth.numbers,
            reconstruction,
            truth: self.truth.world_from_scan.as_ref()?,
            moments: &self.moments,
            overlap: self.overlap.as_ref()?,
            limit_m: self.truth.wrong_beyond_m(),
        };
        Some(case.diagnose(recalls))
    }
}

/// True overlap of posed scans, thinned to half the radius as in `evaluate-retrieval`.
pub(super) fn true_overlap(scans: &[Scan], poses: &[RigidMotion], radius_m: f64) -> Result<SimilarityMatrix> {
    let radius_m = radius_m as f32;
    let thinned: Vec<Vec<Point>> =
        scans.iter().map(|s| voxel_means(&s.cloud.points, 0.5 * radius_m)).collect();
    let views: Vec<&[Point]> = thinned.iter().map(Vec::as_slice).collect();
    overlap_matrix(&views, poses, radius_m)
}

/// The overlap matrix from `path`, or computed and then kept there. A file that does not fit is
/// replaced.
fn cached_overlap(
    path: &Path,
    scans: &[Scan],
    poses: &[RigidMotion],
    radius_m: f64,
) -> Result<SimilarityMatrix> {
    let n = scans.len();
    let kept =
        crate::files::read_text(path).ok().and_then(|text| serde_json::from_str::<Vec<f32>>(&text).ok());
    if let Some(matrix) = kept.and_then(|values| SimilarityMatrix::new(n, values).ok()) {
        return Ok(matrix);
    }
    let matrix = true_overlap(scans, poses, radius_m)?;
    let values: Vec<f32> = (0..n).flat_map(|i| matrix.row(i).to_vec()).collect();
    let text = serde_json::to_string(&values).unwrap_or_default();
    files::write(path, |out| writeln!(out, "{text}"))?;
    Ok(matrix)
}

/// A synthetic scene; its benchmarks count the pairs that the published ones would.
fn made(dataset: &DataSet, seed: u64, name: &str, monitor: &dyn Monitor) -> Result<(Vec<Scan>, SceneTruth)> {
    let config = SynthConfig { seed, ..dataset.synthetic.clone().unwrap_or_default() };
    let set = synthetic::generate(&config, monitor)?;
    let overlap = true_overlap(&set.scans, &set.world_from_scan, dataset.overlap_radius_m)?;
    let views: Vec<&[Point]> = set.scans.iter().map(|s| s.cloud.points.as_slice()).collect();
    let mut pairs = Vec::new();
    for benchmark in &dataset.benchmarks {
        let overlaps = match benchmark.protocol {
            Protocol::ThreeDMatch => MATCH_OVERLAP,
            Protocol::ThreeDLoMatch => LO_MATCH_OVERLAP,
            Protocol::Eth => LO_MATCH_OVERLAP.start..MATCH_OVERLAP.end,
            Protocol::Scannet => continue,
        };
        let radius = dataset.overlap_radius_m as f32;
        let truth = truth_of_pairs(&views, &set.world_from_scan, &overlap, &overlaps, radius)?;
        let (benchmark, protocol) = (benchmark.name.clone(), benchmark.protocol);
        pairs.push(ScenePairs { benchmark, protocol, pairs: truth, overlaps: BTreeMap::new() });
    }
    let truth = SceneTruth {
        name: name.to_owned(),
        scans: set.scans.iter().map(|s| s.name.clone()).collect(),
        numbers: (0..set.scans.len()).collect(),
        world_from_scan: Some(set.world_from_scan),
        deviation: 0.0,
        pairs,
    };
    Ok((set.scans, truth))
}
