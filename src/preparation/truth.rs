//! Ground truth of a user's own posed scans, in the files that benchmarks publish.

use crate::Monitor;
use crate::evaluation::ground_truth::{LO_MATCH_OVERLAP, MATCH_OVERLAP, Overlaps, overlaps, truth_of_pairs};
use crate::files;
use crate::geometry::Point;
use crate::geometry::voxel_means;
use crate::io::{self, write_benchmark, write_overlaps};
use crate::preprocessing::ScaleConfig;
use crate::scan::{PairTruth, PointCloud};
use crate::{Error, Result};
use rayon::prelude::*;
use std::io::Write;
use std::ops::Range;
use std::path::Path;

/// Distance within which points of two scans are the same place, in voxels: 3.75 cm at the
/// 2.5 cm of the 3DMatch fragments, which reproduces their published overlaps.
pub const OVERLAP_RADIUS_VOXELS: f64 = 1.5;

/// The benchmarks by name, with the overlaps of their pairs.
const BENCHMARKS: [(&str, Range<f64>); 2] = [("3DMatch", MATCH_OVERLAP), ("3DLoMatch", LO_MATCH_OVERLAP)];
/// Written last, so that it marks a whole truth.
const MATRIX: &str = "overlap.csv";

/// Lengths to use instead of those read off the scans.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TruthConfig {
    /// Voxel to which scans are thinned, metres; by default the one a registration would choose.
    pub voxel_m: Option<f64>,
    /// Distance within which points count as common, metres; by default
    /// [`OVERLAP_RADIUS_VOXELS`].
    pub radius_m: Option<f64>,
}

/// Truth of a scene.
#[derive(Debug, Clone)]
pub struct GroundTruth {
    /// Names of the scans.
    pub scans: Vec<String>,
    /// What the files call them: the number at the end of each name, or, where those do not tell
    /// scans apart, the place in sorted order.
    pub numbers: Vec<usize>,
    /// Whether `numbers` come from the names.
    pub numbered_by_name: bool,
    /// How far the rotations of the true poses were from orthonormal before the repair.
    pub deviation: f64,
    /// Voxel to which scans were thinned, metres.
    pub voxel_m: f64,
    /// Distance within which points counted as common, metres.
    pub radius_m: f64,
    /// Overlap of every two scans, two-way and as published.
    pub overlaps: Overlaps,
    /// Pairs of every benchmark, by its name.
    pub benchmarks: Vec<(&'static str, Vec<PairTruth>)>,
}

impl GroundTruth {
    /// Truth of the posed scans in `folder`.
    ///
    /// # Errors
    /// Scans or poses that cannot be read, fewer than two scans, coordinates too large for single
    /// precision, a length that is not positive, or the user asked to stop.
    pub fn of_scene(folder: &Path, config: &TruthConfig, monitor: &dyn Monitor) -> Result<Self> {
        const STAGE: &str = "overlaps";
        let scene = io::read_scene(folder)?;
        let poses = scene.true_poses(folder)?;
        let scans = io::read_scans(&scene.scans, monitor)?;
        if scans.len() < 2 {
            let remedy = "name a folder with more scans";
            return Err(Error::file(folder, "one scan", "at least two, to overlap each other", remedy));
        }
        if let Some(scan) = scans.iter().find(|s| s.cloud.origin_m.norm() > 0.0) {
            return Err(Error::input(
                format!("scan {}", scan.name),
                "coordinates beyond 10 km",
                "coordinates near the scan's own origin",
                "subtract an offset from scans and poses",
            ));
        }
        let clouds: Vec<&PointCloud> = scans.iter().map(|s| &s.cloud).collect();
        let (voxel_m, radius_m) = lengths(config, &clouds)?;
        monitor.begin(STAGE, 0);
        let thinned: Vec<Vec<Point>> =
            clouds.par_iter().map(|c| voxel_means(&c.points, voxel_m as f32)).collect();
        monitor.check(STAGE)?;
        let views: Vec<&[Point]> = thinned.iter().map(Vec::as_slice).collect();
        let overlaps = overlaps(&views, &poses.value, radius_m as f32)?;
        monitor.check(STAGE)?;
        let pairs = |(name, range): &(&'static str, Range<f64>)| {
            let first = &overlaps.of_first;
            Ok((*name, truth_of_pairs(&views, &poses.value, first, range, radius_m as f32)?))
        };
        let benchmarks = BENCHMARKS.iter().map(pairs).collect::<Result<_>>()?;
        monitor.end();
        let by_name = distinct(&scene.numbers());
        Ok(Self {
            scans: scans.into_iter().map(|s| s.name).collect(),
            numbered_by_name: by_name.is_some(),
            numbers: by_name.unwrap_or_else(|| (0..views.len()).collect()),
            deviation: poses.deviation,
            voxel_m,
            radius_m,
            overlaps,
            benchmarks,
        })
    }

    /// Writes `<benchmark>/gt.log`, `gt.info` and `gt_overlap.log` for every benchmark that has
    /// pairs, and `overlap.csv` with the two-way overlap of every two scans, into `folder`, which is made where it
    /// does not exist.
    ///
    /// # Errors
    /// [`Error::OutputExists`] when it holds a truth and `replace` is not given, [`Error::Write`].
    pub fn write(&self, folder: &Path, replace: bool) -> Result<()> {
        let matrix = folder.join(MATRIX);
        if matrix.exists() {
            if !replace {
                return Err(Error::OutputExists { path: folder.to_path_buf() });
            }
            std::fs::remove_file(&matrix).map_err(|e| Error::write(&matrix, e))?;
        }
        for (name, pairs) in &self.benchmarks {
            let place = folder.join(name);
            remove_old(&place)?;
            if pairs.is_empty() {
                continue;
            }
            std::fs::create_dir_all(&place).map_err(|e| Error::write(&place, e))?;
            let first = &self.overlaps.of_first;
            write_overlaps(&place.join("gt_overlap.log"), first, &self.numbers, |_, _| true)?;
            write_benchmark(&place, pairs, &self.numbers)?;
        }
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        files::write(&matrix, |out| {
            let names: Vec<String> = self.scans.iter().map(|n| quoted(n)).collect();
            writeln!(out, "scan,{}", names.join(","))?;
            names.iter().enumerate().try_for_each(|(i, name)| {
                let row: Vec<String> =
                    self.overlaps.two_way.row(i).iter().map(|o| format!("{o:.4}")).collect();
                writeln!(out, "{name},{}", row.join(","))
            })
        })
    }
}

/// What an earlier truth left in the folder of a benchmark.
fn remove_old(place: &Path) -> Result<()> {
    let old = ["gt.log", "gt.info", "gt_overlap.log"].map(|name| place.join(name));
    old.iter()
        .filter(|p| p.exists())
        .try_for_each(|p| std::fs::remove_file(p).map_err(|e| Error::write(p, e)))
}

/// A name as a field of a CSV file (RFC 4180).
fn quoted(name: &str) -> String {
    if name.contains([',', '"']) { format!("\"{}\"", name.replace('"', "\"\"")) } else { name.to_owned() }
}

/// The numbers, if every scan has one and no two have the same.
fn distinct(numbers: &[Option<usize>]) -> Option<Vec<usize>> {
    let known: Vec<usize> = numbers.iter().copied().collect::<Option<_>>()?;
    let mut sorted = known.clone();
    sorted.sort_unstable();
    sorted.dedup();
    (sorted.len() == known.len()).then_some(known)
}

/// Voxel and radius, given or read off the scans.
fn lengths(config: &TruthConfig, clouds: &[&PointCloud]) -> Result<(f64, f64)> {
    let mut chosen = ScaleConfig::default();
    chosen.voxel_m = config.voxel_m;
    chosen.validate()?;
    let voxel_m = crate::preprocessing::choose_scale(&chosen, clouds)?.scale.voxel_m;
    let radius_m = config.radius_m.unwrap_or(OVERLAP_RADIUS_VOXELS * voxel_m);
    if !(radius_m.is_finite() && radius_m > 0.0) {
        let expected = "a positive length in metres";
        return Err(Error::setting("radius", radius_m.to_string(), expected, "give another one"));
    }
    Ok((voxel_m, radius_m))
}
