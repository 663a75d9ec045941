//! What a page knows about a run. The viewer (scripts/viewer/src) reads these names.

use super::points::{MOST_POINTS, Packed, PointSource, choose};
use super::{Input, agreement, wording};
use crate::evaluation::pose_error::PoseError;
use crate::files::{printable, printable_lines};
use crate::geometry::RigidMotion;
use crate::result::ten_thousandths;
use crate::result::{Component, Entry, EntryOutcome, Pose};
use crate::result::{ScanSize, StageTime};
use crate::scan::WorkingScale;
use crate::scan::{Doubt, Evidence, NeighbourEvidence, PoseUncertainty, SimilarityMatrix};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use nalgebra::Matrix4;
use serde::Serialize;
use std::borrow::Cow;

/// Everything a page shows.
#[derive(Debug, Serialize)]
pub(super) struct Data<'a> {
    generator: Cow<'a, str>,
    headline: &'a str,
    components: &'a [Component],
    scans: Vec<ScanData<'a>>,
    /// `[N,N]` 8-bit predicted overlap, 255 for 1; base64.
    similarity: Option<String>,
    scale: WorkingScale,
    method: Cow<'a, str>,
    preset: Cow<'a, str>,
    seed: u64,
    threads: usize,
    overlap_head: Cow<'a, str>,
    timings: &'a [StageTime],
    total_seconds: f64,
    peak_memory_bytes: Option<u64>,
    config: Cow<'a, str>,
}

#[derive(Debug, Serialize)]
struct ScanData<'a> {
    name: Cow<'a, str>,
    file: Option<Cow<'a, str>>,
    /// Null for a scan that was left out.
    placed: Option<PlacedData<'a>>,
    /// Null for a placed scan.
    left_out: Option<LeftOutData<'a>>,
    size: Option<&'a ScanSize>,
    /// Error against the truth, in a frame fitted to its component; null where it is not known.
    error: Option<PoseError>,
    /// Where the sensor stood, or can have stood, metres in the frame of the points.
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
    doubts: &'a [Doubt],
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
    exact: Cow<'a, str>,
}

impl<'a> Data<'a> {
    /// Gathers what a page shows; the points are chosen here.
    pub fn new(input: &Input<'a>, headline: &'a str) -> Self {
        let run = input.run;
        let voxel_m = 0.5 * run.scale.voxel_m as f32;
        let shown = choose(input.clouds, voxel_m, MOST_POINTS, run.seed);
        let points = input.frames.iter().zip(input.clouds);
        let local_from_points: Vec<RigidMotion> =
            points.map(|(frame, cloud)| frame.inverse() * cloud.file_from_points()).collect();
        let surfaces = (input.surfaces, input.frames, local_from_points.as_slice());
        let residuals = agreement::residuals(input.poses, surfaces, &shown, run.scale.inlier_radius_m as f32);
        let scans = input.poses.scans.iter().enumerate().map(|(i, entry)| ScanData {
            name: printable(&entry.name),
            file: entry.file.as_deref().map(printable),
            placed: placed(entry, input),
            left_out: left_out(entry),
            size: run.sizes.get(i),
            error: input.truth.and_then(|t| t.scans.iter().find(|e| e.scan.0 == i)).map(|e| e.error),
            viewpoint: viewpoint(input, i),
            points_from: input.sources[i],
            points: Packed::new(&shown[i], residuals[i].as_deref()),
        });
        Self {
            generator: printable(&input.poses.generator),
            headline,
            components: &input.poses.components,
            scans: scans.collect(),
            similarity: input.similarity.map(packed),
            scale: run.scale,
            method: printable(&run.method),
            preset: printable(&run.preset),
            seed: run.seed,
            threads: run.threads,
            overlap_head: printable(&run.overlap_head),
            timings: &run.timings,
            total_seconds: run.total_seconds,
            peak_memory_bytes: run.peak_memory_bytes,
            config: printable_lines(input.config),
        }
    }

    /// As one line of JSON.
    pub fn to_json(&self) -> String {
        // Serialising these types cannot fail: every map key is a string.
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// The viewpoint of a scan's surface, relative to the origin of its cloud.
fn viewpoint(input: &Input<'_>, scan: usize) -> [f32; 3] {
    let points_from_local = input.clouds[scan].file_from_points().inverse() * input.frames[scan];
    (points_from_local * input.surfaces[scan].viewpoint.cast::<f64>()).coords.cast::<f32>().into()
}

/// Points are relative to the origins of their clouds, and the frame of a component is shown relative to
/// that of its pivot: single precision, as graphics has it, resolves no map coordinates.
fn pose_of_points(pose: &Pose, entry: &Entry, input: &Input<'_>) -> [[f64; 4]; 4] {
    let pivot = input.poses.components.get(pose.component).and_then(|c| c.pivot);
    let zero = pivot.map_or_else(RigidMotion::identity, |p| input.clouds[p].file_from_points());
    if zero == RigidMotion::identity() && input.clouds[entry.id].origin_m == nalgebra::Vector3::zeros() {
        return pose.world_from_scan;
    }
    let world_from_scan = Matrix4::from_fn(|r, c| pose.world_from_scan[r][c]);
    let shown = zero.inverse().to_homogeneous()
        * world_from_scan
        * input.clouds[entry.id].file_from_points().to_homogeneous();
    std::array::from_fn(|r| std::array::from_fn(|c| shown[(r, c)]))
}

fn placed<'a>(entry: &'a Entry, input: &Input<'_>) -> Option<PlacedData<'a>> {
    let EntryOutcome::Placed(pose) = &entry.outcome else { return None };
    Some(PlacedData {
        component: pose.component,
        step: pose.step,
        parent: pose.parent,
        world_from_scan: pose_of_points(pose, entry, input),
        matches: pose.matches,
        inliers: pose.inliers,
        residual_m: pose.residual_m,
        evidence: pose.evidence.as_ref(),
        pose_uncertainty: pose.pose_uncertainty.as_deref().map(UncertaintyData::new),
        doubts: &pose.doubts,
        neighbours: &pose.neighbours,
    })
}

fn left_out(entry: &Entry) -> Option<LeftOutData<'_>> {
    let EntryOutcome::Declined { decline, explanation } = &entry.outcome else { return None };
    Some(LeftOutData {
        plain: printable(&wording::plain(decline)).into_owned(),
        exact: printable(explanation),
    })
}

fn packed(similarity: &SimilarityMatrix) -> String {
    let n = similarity.len();
    let values = (0..n).flat_map(|i| similarity.row(i));
    // From the digits that overlap.csv has, so that a page made from files is the same.
    let written = |s: &f32| ten_thousandths(*s).map_or(*s, |digits| digits as f32 / 1e4).clamp(0.0, 1.0);
    STANDARD.encode(values.map(|s| (255.0 * written(s)).round() as u8).collect::<Vec<u8>>())
}
