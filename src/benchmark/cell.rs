//! One cell of a table: a scene registered by one method, with one number of keypoints and one
//! seed, and everything that came of it.

use crate::evaluation::dataset::SceneReport;
use crate::evaluation::diagnosis::Diagnosis;
use crate::evaluation::protocol::Protocol;
use crate::evaluation::retrieval_scores::RetrievalScores;
use crate::files;
use crate::result::Document;
use crate::result::StageTime;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// Value of the `format` field.
const FORMAT: &str = "scanweave-benchmark-cell";
/// Version of the layout, part of every cell's hash.
pub(super) const VERSION: u32 = 1;

/// Which cell.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct CellKey {
    /// Name of the data set.
    pub dataset: String,
    /// Name of the scene.
    pub scene: String,
    /// Name of the method.
    pub method: String,
    /// Keypoints a scan.
    pub keypoints: usize,
    /// Seed.
    pub seed: u64,
}

impl CellKey {
    /// Name of the cell's file: what a person looks for, and a digest that keeps apart what looks
    /// alike once odd characters are replaced.
    pub fn file_name(&self) -> String {
        let Self { dataset, scene, method, keypoints, seed } = self;
        let text = format!("{dataset}.{scene}.{method}.{keypoints}.s{seed}");
        let exact = format!("{dataset}\0{scene}\0{method}\0{keypoints}\0{seed}");
        let plain: String = text
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '_' })
            .take(150)
            .collect();
        format!("{plain}.{}.json", &blake3::hash(exact.as_bytes()).to_hex()[..8])
    }
}

impl std::fmt::Display for CellKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { dataset, scene, method, keypoints, seed } = self;
        write!(f, "{dataset}, {scene}, {method}, {keypoints} keypoints, seed {seed}")
    }
}

/// What the timings were taken on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Environment {
    /// Program and version.
    pub generator: String,
    /// Digest of the program, where known.
    pub build: String,
    /// Threads that worked on this cell.
    pub threads: usize,
    /// Cells computed at the same time.
    pub jobs: usize,
    /// Cores that the system offers.
    pub cores: usize,
    /// Operating system and processor architecture.
    pub system: String,
}

/// What `peak_memory_bytes` is the peak of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PeakOf {
    /// The process while it worked on this cell alone.
    Cell,
    /// The process since it started: the system cannot reset the peak, or several cells were
    /// computed at the same time.
    Process,
}

/// Everything that came of a cell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Always `scanweave-benchmark-cell`.
    pub format: String,
    /// Version of the layout.
    pub version: u32,
    /// Which cell.
    pub key: CellKey,
    /// Digest of all settings and data that it depends on, the program apart.
    pub hash: String,
    /// What it was computed on.
    pub environment: Environment,
    /// Where the predicted overlap came from.
    pub overlap_head: String,
    /// Protocol of every benchmark, by name.
    pub benchmarks: BTreeMap<String, Protocol>,
    /// Figures by all protocols, with the outcome on every pair.
    pub report: SceneReport,
    /// True overlap of each pair of `report.recalls`, by benchmark, where known: as published in
    /// gt_overlap.log, else as computed from the poses.
    pub pair_overlaps: BTreeMap<String, Vec<Option<f32>>>,
    /// Why pairs failed, where the true poses are known.
    pub diagnosis: Option<Diagnosis>,
    /// How well the predicted overlap ranks the scans, where the true overlap is known.
    pub retrieval: Option<RetrievalScores>,
    /// Wall-clock time of the stages; "features" is that of computing all keypoints of the scene,
    /// 0 where they were given or cached.
    pub timings: Vec<StageTime>,
    /// Scans whose features were read instead of computed.
    pub features_reused: usize,
    /// Highest resident memory, bytes, where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// Of what.
    pub peak_memory_of: PeakOf,
    /// The outcome on every scan: step, parent, evidence and pose.
    pub poses: Document,
}

impl Cell {
    /// An empty cell's format and version.
    pub(super) fn stamp() -> (String, u32) {
        (FORMAT.to_owned(), VERSION)
    }

    /// Seconds from features to poses: the stages "similarity" and "registration".
    pub fn seconds(&self) -> f64 {
        let counted = self.timings.iter().filter(|t| t.stage == "similarity" || t.stage == "registration");
        counted.map(|t| t.seconds).sum()
    }

    /// Writes the cell.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string(self).map_err(|e| Error::write(path, e.into()))?;
        files::write(path, |out| writeln!(out, "{text}"))
    }

    /// Reads a cell.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::File`] when it is something else.
    pub fn read(path: &Path) -> Result<Self> {
        let text = crate::files::read_text(path)?;
        let expected = format!("{FORMAT} of version {VERSION}, as `scanweave benchmark` writes it");
        let remedy = "remove the file; the next start computes the cell again";
        let cell: Self = serde_json::from_str(&text)
            .map_err(|e| Error::file(path, format!("text that does not fit ({e})"), &expected, remedy))?;
        if cell.format != FORMAT || cell.version != VERSION {
            let found = format!("{} of version {}", cell.format, cell.version);
            return Err(Error::file(path, found, expected, remedy));
        }
        Ok(cell)
    }
}
