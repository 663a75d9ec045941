//! Scans, features and results.

use crate::geometry::{Point, PointIndex};
use crate::result::RunReport;
use crate::result::check_report;
use crate::result::{Document, EntryOutcome};
use crate::scan::WorkingScale;
use crate::scan::{Features, PointCloud};
use crate::{Error, Result};
use nalgebra::Vector3;
use serde::Serialize;
use std::fs;
use std::path::Path;

/// Points whose distance to the nearest other point is measured.
const SAMPLE: usize = 2000;

/// What a cloud is like. Lengths are metres.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScanContent {
    /// Points with finite coordinates.
    pub points: usize,
    /// Rows without.
    pub dropped_rows: usize,
    /// Whether points have colours.
    pub colors: bool,
    /// Least and greatest coordinates, relative to `origin_m`; null without points.
    pub box_m: Option<[[f32; 3]; 2]>,
    /// File coordinates of the zero point; other than zero for georeferenced clouds.
    pub origin_m: [f64; 3],
    /// Where the sensor stood, relative to `origin_m`; null where the file does not say.
    pub viewpoint_m: Option<[f32; 3]>,
    /// Median distance of a point to the nearest other; null with fewer than two points.
    pub spacing_m: Option<f64>,
    /// How the file was read, where that is not plain.
    pub notes: Vec<String>,
}

pub(super) fn scan(cloud: &PointCloud) -> ScanContent {
    ScanContent {
        points: cloud.len(),
        dropped_rows: cloud.dropped_rows,
        colors: cloud.colors.is_some(),
        box_m: bounds(&cloud.points),
        origin_m: cloud.origin_m.into(),
        viewpoint_m: cloud.viewpoint.map(|v| v.coords.into()),
        spacing_m: spacing(&cloud.points),
        notes: Vec::new(),
    }
}

fn bounds(points: &[Point]) -> Option<[[f32; 3]; 2]> {
    let first = points.first()?.coords;
    let (low, high) =
        points.iter().fold((first, first), |(low, high), p| (low.inf(&p.coords), high.sup(&p.coords)));
    Some([low.into(), high.into()])
}

/// Of evenly picked points.
fn spacing(points: &[Point]) -> Option<f64> {
    let index = PointIndex::new(points);
    let stride = points.len().div_ceil(SAMPLE).max(1);
    let picked = points.iter().step_by(stride);
    let mut found: Vec<f32> = picked.filter_map(|p| index.nearest_n(p, 2).get(1).map(|n| n.1)).collect();
    found.sort_by(f32::total_cmp);
    found.get(found.len() / 2).map(|squared| f64::from(*squared).sqrt())
}

/// What local features are like.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FeatureContent {
    /// Number of keypoints.
    pub keypoints: usize,
    /// Dimension of a descriptor.
    pub dim: usize,
    /// Whether keypoints have normals.
    pub normals: bool,
    /// Least and greatest coordinates of the keypoints, metres; null without keypoints.
    pub box_m: Option<[[f32; 3]; 2]>,
    /// Least and greatest value of the descriptors, scaled to unit length; null without any.
    pub values: Option<[f32; 2]>,
    /// Descriptors that are all zero: nothing can match them.
    pub zero_descriptors: usize,
}

pub(super) fn features(features: &Features) -> FeatureContent {
    let d = &features.descriptors;
    FeatureContent {
        keypoints: features.len(),
        dim: d.dim(),
        normals: features.normals.is_some(),
        box_m: bounds(&features.keypoints),
        values: range(d.values()),
        zero_descriptors: (0..d.len()).filter(|&i| d.row(i).iter().all(|&v| v == 0.0)).count(),
    }
}

/// Least and greatest.
pub(super) fn range(values: &[f32]) -> Option<[f32; 2]> {
    let first = *values.first()?;
    Some(values.iter().fold([first, first], |[low, high], &v| [low.min(v), high.max(v)]))
}

/// What a registration concluded.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ResultContent {
    /// Program and version that wrote it.
    pub generator: String,
    /// Number of scans.
    pub scans: usize,
    /// Scans with a pose.
    pub placed: usize,
    /// Scans in each component, largest first.
    pub components: Vec<usize>,
    /// Extent of the scanners' positions of the first component along its axes, metres.
    pub trajectory_m: [f64; 3],
    /// Mean residual of the placed scans, metres; null where none was joined.
    pub mean_residual_m: Option<f64>,
    /// Scans without a pose.
    pub left_out: Vec<LeftOut>,
    /// Preset, method, seed, lengths and time, from report.json; null where it is not there.
    pub run: Option<RunContent>,
    /// Files of the result.
    pub files: Vec<FileSize>,
}

/// A scan without a pose.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LeftOut {
    /// Its name.
    pub scan: String,
    /// Why.
    pub reason: String,
}

/// How a result was made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunContent {
    /// Preset the settings started from.
    pub preset: String,
    /// How scans were registered.
    pub method: String,
    /// Seed of all randomness.
    pub seed: u64,
    /// Lengths the run worked at.
    pub scale: WorkingScale,
    /// Where the overlap head came from.
    pub overlap_head: String,
    /// Seconds of all stages.
    pub total_seconds: f64,
    /// Highest memory use, where it is known.
    pub peak_memory_bytes: Option<u64>,
}

/// A file and its size.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FileSize {
    /// Name in the folder.
    pub name: String,
    /// Size.
    pub bytes: u64,
}

pub(super) fn result(folder: &Path) -> Result<ResultContent> {
    let poses = Document::load(&folder.join(super::POSES))?;
    let reconstruction = poses.reconstruction()?;
    let placements: Vec<_> = reconstruction.outcomes.iter().filter_map(|o| o.placement()).collect();
    let residuals: Vec<f64> =
        placements.iter().filter(|p| p.parent.is_some()).map(|p| p.residual_m).collect();
    let places: Vec<Vector3<f64>> = placements
        .iter()
        .filter(|p| p.component == 0)
        .map(|p| p.world_from_scan.translation.vector)
        .collect();
    let first = places.first().copied().unwrap_or_default();
    let (low, high) = places.iter().fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
    let report = folder.join("report.json");
    Ok(ResultContent {
        scans: poses.scans.len(),
        placed: placements.len(),
        components: poses.components.iter().map(|c| c.scans.len()).collect(),
        trajectory_m: (high - low).into(),
        mean_residual_m: (!residuals.is_empty())
            .then(|| residuals.iter().sum::<f64>() / residuals.len() as f64),
        left_out: left_out(&poses),
        run: if report.exists() { Some(run_of(&poses, &report)?) } else { None },
        files: files(folder)?,
        generator: poses.generator,
    })
}

fn run_of(poses: &Document, path: &Path) -> Result<RunContent> {
    let report = RunReport::load(path)?;
    check_report(poses, &report, path)?;
    Ok(run(report))
}

fn left_out(poses: &Document) -> Vec<LeftOut> {
    let reason = |scan: &crate::result::Entry| match &scan.outcome {
        EntryOutcome::Declined { explanation, .. } => {
            Some(LeftOut { scan: scan.name.clone(), reason: explanation.clone() })
        }
        EntryOutcome::Placed(_) => None,
    };
    poses.scans.iter().filter_map(reason).collect()
}

fn run(report: RunReport) -> RunContent {
    RunContent {
        preset: report.preset,
        method: report.method,
        seed: report.seed,
        scale: report.scale,
        overlap_head: report.overlap_head,
        total_seconds: report.total_seconds,
        peak_memory_bytes: report.peak_memory_bytes,
    }
}

/// Files directly in a folder, by name.
fn files(folder: &Path) -> Result<Vec<FileSize>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(|e| Error::read(folder, e))? {
        let entry = entry.map_err(|e| Error::read(folder, e))?;
        let about = entry.metadata().map_err(|e| Error::read(entry.path(), e))?;
        if about.is_file() {
            let name = entry.file_name().to_string_lossy().into_owned();
            found.push(FileSize { name, bytes: about.len() });
        }
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(found)
}
