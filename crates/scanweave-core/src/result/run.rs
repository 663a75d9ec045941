//! `report.json`: what a run worked on, with what settings, and how long each stage took.

use super::poses::{Document, Entry, EntryOutcome};
use crate::error::{Error, Result};
use crate::scan::{Doubt, WorkingScale};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Time one stage took.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageTime {
    /// Name of the stage.
    pub stage: String,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// Sizes of one scan on its way through the pipeline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScanSize {
    /// Finite points read.
    pub points: usize,
    /// Rows left out because a coordinate was not finite.
    pub dropped_rows: usize,
    /// Points left out because they lie too far from the rest.
    #[serde(default)]
    pub stray_points: usize,
    /// Points at the working resolution.
    pub surface_points: usize,
    /// Keypoints described.
    pub keypoints: usize,
    /// Whether the features came from the cache or from files instead of being computed.
    pub features_reused: bool,
}

/// The outcome on one scan, in one line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the scan.
    pub scan: String,
    /// `pivot`, `placed` or `declined`.
    pub outcome: String,
    /// Component of a placed scan.
    pub component: Option<usize>,
    /// Growth step at which it joined.
    pub step: Option<usize>,
    /// Name of the scan it joined to.
    pub parent: Option<String>,
    /// Matches with the model.
    pub matches: Option<usize>,
    /// Matches within the inlier radius.
    pub inliers: Option<usize>,
    /// Inliers over matches.
    pub inlier_ratio: Option<f64>,
    /// Overlap with its parent, else the largest with any placed scan.
    pub overlap: Option<f64>,
    /// Root mean square distance of the inliers, metres.
    pub residual_m: Option<f64>,
    /// Stated probability that its pose is right, in `[0, 1]`; none where only inliers are counted.
    #[serde(default)]
    pub probability: Option<f64>,
    /// What is doubtful about its pose.
    #[serde(default)]
    pub doubts: Vec<Doubt>,
    /// Why it was declined.
    pub reason: Option<String>,
}

/// The whole report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunReport {
    /// Program and version that wrote it.
    pub generator: String,
    /// `run.id` of the poses.json that it belongs to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run_id: Option<String>,
    /// Seed of all randomness.
    pub seed: u64,
    /// Preset the settings started from.
    pub preset: String,
    /// Threads that worked.
    pub threads: usize,
    /// Lengths the run worked at.
    pub scale: WorkingScale,
    /// Where the overlap head came from.
    pub overlap_head: String,
    /// How scans were registered.
    pub method: String,
    /// Pairs that were registered, this time or before; null for the incremental method.
    pub registered_pairs: Option<usize>,
    /// What these pairs took when they were registered, seconds; null likewise.
    pub pair_seconds: Option<f64>,
    /// Pairs that became edges of the pose graph; null likewise.
    pub edges: Option<usize>,
    /// Scans with a pose.
    pub placed: usize,
    /// Scans without.
    pub declined: usize,
    /// Components of two scans and more, and single pivots.
    pub components: usize,
    /// Evidence, one row a scan.
    pub evidence: Vec<Row>,
    /// Sizes, one entry a scan.
    pub sizes: Vec<ScanSize>,
    /// Stages in order.
    pub timings: Vec<StageTime>,
    /// Sum of the stages.
    pub total_seconds: f64,
    /// Highest memory use of the process so far, where the system tells.
    pub peak_memory_bytes: Option<u64>,
}

impl RunReport {
    /// As JSON text, ending in a line break.
    pub fn to_json(&self) -> String {
        // Serialising these types cannot fail: every map key is a string.
        serde_json::to_string_pretty(self).map(|text| text + "\n").unwrap_or_default()
    }

    /// Adds stages to the timings and their sum.
    pub fn add_times(&mut self, stages: Vec<StageTime>) {
        self.total_seconds += stages.iter().map(|t| t.seconds).sum::<f64>();
        self.timings.extend(stages);
    }

    /// Reads a `report.json`.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::File`] when the file is no such report, or its counts disagree.
    pub fn load(path: &Path) -> Result<Self> {
        let text = crate::files::read_text(path)?;
        let remedy = "name the output folder of a finished registration, or register again";
        let report: Self = serde_json::from_str(&text).map_err(|e| {
            let expected = "a report as `scanweave register` writes it";
            Error::file(path, format!("text that does not fit ({e})"), expected, remedy)
        })?;
        match report.wrong_count() {
            None => Ok(report),
            Some((found, expected)) => Err(Error::file(path, found, expected, remedy)),
        }
    }

    /// The first count that the lists do not bear out, and what they say.
    fn wrong_count(&self) -> Option<(String, String)> {
        let scans = self.evidence.len();
        let placed = self.evidence.iter().filter(|row| row.component.is_some()).count();
        let highest = self.evidence.iter().filter_map(|row| row.component).max();
        [
            ("sizes", self.sizes.len(), scans),
            ("placed scans", self.placed, placed),
            ("declined scans", self.declined, scans - placed),
            ("components", self.components, highest.map_or(0, |c| c.saturating_add(1))),
        ]
        .into_iter()
        .find(|(_, stated, listed)| stated != listed)
        .map(|(what, stated, listed)| {
            (format!("{stated} {what}"), format!("{listed}, as the rows of its evidence have it"))
        })
    }
}

/// One row a scan of `poses.json`.
pub fn rows(document: &Document) -> Vec<Row> {
    document.scans.iter().map(|entry| row(entry, &document.scans)).collect()
}

fn row(entry: &Entry, all: &[Entry]) -> Row {
    let mut row = Row {
        scan: entry.name.clone(),
        outcome: "declined".to_owned(),
        component: None,
        step: None,
        parent: None,
        matches: None,
        inliers: None,
        inlier_ratio: None,
        overlap: None,
        residual_m: None,
        probability: None,
        doubts: Vec::new(),
        reason: None,
    };
    match &entry.outcome {
        EntryOutcome::Declined { explanation, .. } => row.reason = Some(explanation.clone()),
        EntryOutcome::Placed(pose) => {
            let of_parent = pose.neighbours.iter().find(|n| Some(n.scan.0) == pose.parent);
            let largest = || pose.neighbours.iter().max_by(|a, b| a.overlap.total_cmp(&b.overlap));
            row.overlap = of_parent.or_else(largest).map(|n| n.overlap);
            row.component = Some(pose.component);
            row.step = Some(pose.step);
            row.doubts.clone_from(&pose.doubts);
            row.probability = pose.evidence.and_then(|e| e.probability);
            row.outcome = if pose.parent.is_some() { "placed" } else { "pivot" }.to_owned();
            if let Some(parent) = pose.parent {
                row.parent = all.get(parent).map(|e| e.name.clone());
                row.matches = Some(pose.matches);
                row.inliers = Some(pose.inliers);
                row.inlier_ratio = Some(pose.inlier_ratio);
                row.residual_m = Some(pose.residual_m);
            }
        }
    }
    row
}

/// Highest resident memory of this process so far, bytes; `None` where the system does not tell.
pub fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kb| kb * 1024)
}

/// Lets [`peak_memory_bytes`] start anew from what the process uses now; `false` where the system
/// does not offer that.
pub fn reset_peak_memory() -> bool {
    // Linux: "5" resets the peak resident set size (proc(5), /proc/pid/clear_refs).
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn counts_that_disagree_with_the_rows_are_refused() {
        let row = |component: Option<usize>| Row {
            scan: "a".to_owned(),
            outcome: "placed".to_owned(),
            component,
            step: None,
            parent: None,
            matches: None,
            inliers: None,
            inlier_ratio: None,
            overlap: None,
            residual_m: None,
            probability: None,
            doubts: Vec::new(),
            reason: None,
        };
        let size = ScanSize {
            points: 1,
            dropped_rows: 0,
            stray_points: 0,
            surface_points: 1,
            keypoints: 1,
            features_reused: false,
        };
        let report = RunReport {
            generator: String::new(),
            run_id: None,
            seed: 0,
            preset: String::new(),
            threads: 1,
            scale: WorkingScale::from_voxel(0.1),
            overlap_head: String::new(),
            method: String::new(),
            registered_pairs: None,
            pair_seconds: None,
            edges: None,
            placed: 2,
            declined: 1,
            components: 2,
            evidence: vec![row(Some(0)), row(Some(1)), row(None)],
            sizes: vec![size; 3],
            timings: Vec::new(),
            total_seconds: 0.0,
            peak_memory_bytes: None,
        };
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("report.json");
        let read = |json: &serde_json::Value| {
            std::fs::write(&path, json.to_string()).unwrap();
            RunReport::load(&path).map_err(|e| e.to_string())
        };
        let whole = serde_json::to_value(&report).unwrap();
        assert_eq!(read(&whole).unwrap(), report);
        for (key, value, said) in [
            ("placed", json!(3), "found 3 placed scans, expected 2"),
            ("declined", json!(0), "found 0 declined scans, expected 1"),
            ("components", json!(1), "found 1 components, expected 2"),
            ("sizes", json!([]), "found 0 sizes, expected 3"),
        ] {
            let mut wrong = whole.clone();
            wrong[key] = value;
            let message = read(&wrong).unwrap_err();
            assert!(message.contains(said) && message.contains("report.json"), "{message}");
        }
    }
}
