//! Cells summed up: recall by method and keypoints with its spread over seeds.

use super::cell::Cell;
use super::group::Group;
use super::plan::Plan;
use super::run::cells_folder;
use super::suite::Suite;
use super::trust::Reliability;
use crate::Result;
use crate::evaluation::pose_error::ErrorDistribution;
use crate::evaluation::protocol::Protocol;
use serde::Serialize;
use std::path::Path;

/// A figure over several seeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Spread {
    /// One value a seed.
    pub values: Vec<f64>,
    /// Their mean.
    pub mean: f64,
    /// The least.
    pub low: f64,
    /// The greatest.
    pub high: f64,
    /// Standard deviation of the sample; `None` with fewer than two values.
    pub deviation: Option<f64>,
}

impl Spread {
    /// Spread of the values; `None` when there is none.
    pub fn new(values: Vec<f64>) -> Option<Self> {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let low = values.iter().copied().reduce(f64::min)?;
        let high = values.iter().copied().reduce(f64::max)?;
        let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        let deviation = (values.len() > 1).then(|| (squares / (n - 1.0)).sqrt());
        Some(Self { values, mean, low, high, deviation })
    }
}

/// What a method took.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cost {
    /// Mean seconds a scene from features to poses.
    pub seconds: f64,
    /// Seconds of the slowest scene.
    pub seconds_most: f64,
    /// Highest memory use of a scene, bytes.
    pub peak_memory_bytes: Option<u64>,
}

/// One benchmark by one method with one number of keypoints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecallRow {
    /// Data set.
    pub dataset: String,
    /// Benchmark.
    pub benchmark: String,
    /// Method.
    pub method: String,
    /// Where the figures were published, for rows that are not ours.
    pub quoted: Option<String>,
    /// Keypoints a scan.
    pub keypoints: usize,
    /// Scenes with counted pairs.
    pub scenes: usize,
    /// Cells that are there, and that there will be.
    pub cells: (usize, usize),
    /// Mean of the scenes' recalls, within all components.
    pub recall: Option<Spread>,
    /// All successes over all counted pairs, within all components.
    pub pooled: Option<Spread>,
    /// As `recall`, in the largest component of each scene alone; `None` for quoted rows and where a cell
    /// of an earlier version does not tell.
    pub recall_in_largest: Option<Spread>,
    /// As `pooled`, likewise.
    pub pooled_in_largest: Option<Spread>,
    /// Recall of each scene within all components, mean over seeds, in the order of [`Table::scenes`].
    pub by_scene: Vec<Option<f64>>,
    /// Scans without a pose, all scenes, mean over seeds.
    pub declined: f64,
    /// What it took.
    pub cost: Option<Cost>,
}

/// The errors of all relative poses, by one method with one number of keypoints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ErrorRow {
    /// Data set.
    pub dataset: String,
    /// Method.
    pub method: String,
    /// Keypoints a scan.
    pub keypoints: usize,
    /// Cells that are there, and that there will be.
    pub cells: (usize, usize),
    /// Averaged over scenes, then over seeds.
    pub errors: Option<ErrorDistribution>,
    /// Scans without a pose, all scenes, mean over seeds.
    pub declined: f64,
    /// What it took.
    pub cost: Option<Cost>,
}

/// Why pairs failed, by one method with one number of keypoints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CauseRow {
    /// Data set.
    pub dataset: String,
    /// Benchmark; for the ScanNet protocol, the pairs that overlap enough.
    pub benchmark: String,
    /// Method.
    pub method: String,
    /// Keypoints a scan.
    pub keypoints: usize,
    /// Failed pairs of all scenes, mean over seeds.
    pub failed: f64,
    /// Those by cause, in the order of [`crate::evaluation::diagnosis::Cause::ALL`].
    pub by_cause: [f64; 6],
    /// Those whose error began with neither of the two scans.
    pub carried: f64,
}

/// Reliability of the probabilities stated by one method with one number of keypoints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrustRow {
    /// Data set.
    pub dataset: String,
    /// Method.
    pub method: String,
    /// Keypoints a scan.
    pub keypoints: usize,
    /// Stated probabilities against the truth.
    pub reliability: Reliability,
}

/// Everything that was computed of a suite.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Table {
    /// Name of the suite.
    pub suite: String,
    /// Cells that are there.
    pub done: usize,
    /// Cells of the suite.
    pub planned: usize,
    /// (data set, scene), in the order of the plan.
    pub scenes: Vec<(String, String)>,
    /// Recalls, ours and quoted.
    pub recalls: Vec<RecallRow>,
    /// Distributions of errors, of data sets with the ScanNet protocol.
    pub errors: Vec<ErrorRow>,
    /// Why pairs failed.
    pub causes: Vec<CauseRow>,
    /// Placed scans by their stated probability, of methods that state one.
    pub trust: Vec<TrustRow>,
}

/// The cells of a plan that an output folder holds.
///
/// # Errors
/// [`crate::Error::Read`] or [`crate::Error::File`] for a file that is no cell.
pub fn read_cells(output: &Path, plan: &Plan) -> Result<Vec<Cell>> {
    let folder = cells_folder(output);
    let mut cells = Vec::new();
    for planned in &plan.cells {
        let path = folder.join(planned.key.file_name());
        if path.exists() {
            let cell = Cell::read(&path)?;
            if cell.hash == planned.hash {
                cells.push(cell);
            }
        }
    }
    Ok(cells)
}

impl Table {
    /// Sums up cells.
    pub fn new(suite: &Suite, plan: &Plan, cells: &[Cell]) -> Self {
        let mut scenes: Vec<(String, String)> = Vec::new();
        for planned in &plan.cells {
            let scene = (planned.key.dataset.clone(), planned.key.scene.clone());
            if !scenes.contains(&scene) {
                scenes.push(scene);
            }
        }
        let mut table = Self {
            suite: suite.name.clone(),
            done: cells.len(),
            planned: plan.cells.len(),
            scenes,
            recalls: Vec::new(),
            errors: Vec::new(),
            causes: Vec::new(),
            trust: Vec::new(),
        };
        for dataset in &suite.datasets {
            for benchmark in &dataset.benchmarks {
                for (method, keypoints) in combinations(suite) {
                    let group = Group::new(suite, plan, cells, &dataset.name, method, keypoints);
                    if benchmark.protocol == Protocol::Scannet {
                        table.errors.push(group.errors());
                    } else {
                        table.recalls.push(group.recall(&benchmark.name, &table.scenes));
                    }
                }
                table.recalls.extend(quoted(suite, &dataset.name, &benchmark.name));
            }
            for (method, keypoints) in combinations(suite) {
                let group = Group::new(suite, plan, cells, &dataset.name, method, keypoints);
                table.causes.extend(group.causes());
                table.trust.extend(group.trust());
            }
        }
        table
    }
}

fn combinations(suite: &Suite) -> impl Iterator<Item = (&str, usize)> {
    suite.methods.iter().flat_map(|m| suite.keypoints.iter().map(|&k| (m.name.as_str(), k)))
}

fn quoted<'a>(
    suite: &'a Suite,
    dataset: &'a str,
    benchmark: &'a str,
) -> impl Iterator<Item = RecallRow> + 'a {
    let for_it = suite.quoted.iter().filter(move |q| q.benchmark == benchmark);
    for_it.flat_map(move |q| {
        let figures = q.keypoints.iter().zip(&q.recall_percent);
        let asked = figures.filter(move |f| suite.keypoints.contains(f.0));
        asked.map(move |(&keypoints, percent)| RecallRow {
            dataset: dataset.to_owned(),
            benchmark: benchmark.to_owned(),
            method: q.method.clone(),
            quoted: Some(q.source.clone()),
            keypoints,
            scenes: q.scenes,
            cells: (0, 0),
            recall: Spread::new(vec![percent / 100.0]),
            pooled: None,
            recall_in_largest: None,
            pooled_in_largest: None,
            by_scene: Vec::new(),
            declined: 0.0,
            cost: None,
        })
    })
}

#[cfg(test)]
#[path = "table_tests.rs"]
mod tests;
