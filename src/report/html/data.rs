//! What a page knows about a run. The viewer (scripts/viewer/src) reads these names.

use super::points::{MOST_POINTS, Packed, PointSource, choose};
use super::{Input, agreement, wording};
use crate::evaluation::pose_error::PoseError;
use crate::result::poses::{Component, Entry, EntryOutcome};
use crate::result::run::{ScanSize, StageTime};
use crate::scan::WorkingScale;
use crate::scan::{Evidence, NeighbourEvidence, PoseUncertainty, SimilarityMatrix};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;

/// Everything a page shows.
#[derive(Debug, Serialize)]
pub(super) struct Data<'a> {
    generator: &'a str,
    headline: &'a str,
    components: &'a [Component],
    scans: Vec<ScanData<'a>>,
    /// `[N,N]` 8-bit predicted overlap, 255 for 1; base64.
    similarity: Option<String>,
    scale: WorkingScale,
    method: &'a str,
    preset: &'a str,
    seed: u64,
    threads: usize,
    overlap_head: &'a str,
    timings: &'a [StageTime],
    total_seconds: f64,
    peak_memory_bytes: Option<u64>,
    config: &'a str,
}

#[derive(Debug, Serialize)]
struct ScanData<'a> {
    name: &'a str,
    file: Option<&'a str>,
    /// Null for a scan that was left out.
    placed: Option<PlacedData<'a>>,
    /// Null for a placed scan.
    left_out: Option<LeftOutData<'a>>,
    size: Option<&'a ScanSize>,
    /// Error against the truth, in a frame fitted to its component; null where it is not known.
    error: Option<PoseError>,
    /// Where the sensor stood, metres in the scan's frame.
    viewpoint: [f32; 3],
    points_from: PointSource,
    points: Packed,
}

#[derive(Debug, Serialize)]
struct PlacedData<'a> {
    component: usize,
    step: usize,
    parent: Option<usize>,
    world_from_scan: [[f64; 4]; 4],
    matches: usize,
    inliers: usize,
    residual_m: f64,
    evidence: Option<&'a Evidence>,
    pose_uncertainty: Option<UncertaintyData>,
    neighbours: &'a [NeighbourEvidence],
}

/// Uncertainty of a scan's pose.
#[derive(Debug, Serialize)]
struct UncertaintyData {
    /// Largest standard deviations in any direction, of the rotation and of the scan's centre.
    deviation_deg: Option<f64>,
    deviation_m: Option<f64>,
    /// Two scans and the probability that their relative pose is right.
    weakest_edge: Option<(usize, usize, f64)>,
}

/// The same to six digits: what is computed from poses.json read back may differ in the last ones.
fn significant(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

impl UncertaintyData {
    fn new(pose_uncertainty: &PoseUncertainty) -> Self {
        let deviation = pose_uncertainty.deviation();
        Self {
            deviation_deg: deviation.map(|d| significant(d.0)),
            deviation_m: deviation.map(|d| significant(d.1)),
            weakest_edge: pose_uncertainty.weakest_edge.map(|l| (l.scans.0.0, l.scans.1.0, l.probability)),
        }
    }
}

#[derive(Debug, Serialize)]
struct LeftOutData<'a> {
    plain: String,
    exact: &'a str,
}

impl<'a> Data<'a> {
    /// Gathers what a page shows; the points are chosen here.
    pub fn new(input: &Input<'a>, headline: &'a str) -> Self {
        let run = input.run;
        let voxel_m = 0.5 * run.scale.voxel_m as f32;
        let shown = choose(input.clouds, voxel_m, MOST_POINTS, run.seed);
        let residuals =
            agreement::residuals(input.poses, input.surfaces, &shown, run.scale.inlier_radius_m as f32);
        let scans = input.poses.scans.iter().enumerate().map(|(i, entry)| ScanData {
            name: &entry.name,
            file: entry.file.as_deref(),
            placed: placed(entry),
            left_out: left_out(entry),
            size: run.sizes.get(i),
            error: input.truth.and_then(|t| t.scans.iter().find(|e| e.scan.0 == i)).map(|e| e.error),
            viewpoint: input.clouds[i].viewpoint.coords.into(),
            points_from: input.sources[i],
            points: Packed::new(&shown[i], residuals[i].as_deref()),
        });
        Self {
            generator: &input.poses.generator,
            headline,
            components: &input.poses.components,
            scans: scans.collect(),
            similarity: input.similarity.map(packed),
            scale: run.scale,
            method: &run.method,
            preset: &run.preset,
            seed: run.seed,
            threads: run.threads,
            overlap_head: &run.overlap_head,
            timings: &run.timings,
            total_seconds: run.total_seconds,
            peak_memory_bytes: run.peak_memory_bytes,
            config: input.config,
        }
    }

    /// As one line of JSON.
    pub fn to_json(&self) -> String {
        // Serialising these types cannot fail: every map key is a string.
        serde_json::to_string(self).unwrap_or_default()
    }
}

fn placed(entry: &Entry) -> Option<PlacedData<'_>> {
    let EntryOutcome::Placed(pose) = &entry.outcome else { return None };
    Some(PlacedData {
        component: pose.component,
        step: pose.step,
        parent: pose.parent,
        world_from_scan: pose.world_from_scan,
        matches: pose.matches,
        inliers: pose.inliers,
        residual_m: pose.residual_m,
        evidence: pose.evidence.as_ref(),
        pose_uncertainty: pose.pose_uncertainty.as_deref().map(UncertaintyData::new),
        neighbours: &pose.neighbours,
    })
}

fn left_out(entry: &Entry) -> Option<LeftOutData<'_>> {
    let EntryOutcome::Declined { decline, explanation } = &entry.outcome else { return None };
    Some(LeftOutData { plain: wording::plain(decline), exact: explanation })
}

fn packed(similarity: &SimilarityMatrix) -> String {
    let n = similarity.len();
    let values = (0..n).flat_map(|i| similarity.row(i));
    STANDARD.encode(values.map(|s| (255.0 * s.clamp(0.0, 1.0)).round() as u8).collect::<Vec<u8>>())
}
