//! Cells of one row of a table.

use super::cell::{Cell, CellKey};
use super::plan::Plan;
use super::suite::Suite;
use super::table::{CauseRow, Cost, ErrorRow, RecallRow, Spread, TrustRow};
use super::trust::Reliability;
use crate::evaluation::diagnosis::{Cause, PairFinding};
use crate::evaluation::pose_error::ErrorDistribution;
use crate::evaluation::recall::{RecallReport, RecallSummary};
use std::collections::BTreeSet;

/// The cells of one method with one number of keypoints on one data set.
pub(super) struct Group<'a> {
    dataset: &'a str,
    method: &'a str,
    keypoints: usize,
    planned: usize,
    /// By seed, in the order of the suite.
    by_seed: Vec<Vec<&'a Cell>>,
}

impl<'a> Group<'a> {
    pub fn new(
        suite: &Suite,
        plan: &Plan,
        cells: &'a [Cell],
        dataset: &'a str,
        method: &'a str,
        keypoints: usize,
    ) -> Self {
        let fits =
            |key: &CellKey| key.dataset == dataset && key.method == method && key.keypoints == keypoints;
        let of_seed = |seed: &u64| -> Vec<&'a Cell> {
            cells.iter().filter(|c| fits(&c.key) && c.key.seed == *seed).collect()
        };
        let by_seed = suite.seeds.iter().map(of_seed).filter(|c| !c.is_empty()).collect();
        let planned = plan.cells.iter().filter(|c| fits(&c.key)).count();
        Self { dataset, method, keypoints, planned, by_seed }
    }

    pub fn cells(&self) -> impl Iterator<Item = &'a Cell> {
        self.by_seed.iter().flatten().copied()
    }

    pub fn recall(&self, benchmark: &str, scenes: &[(String, String)]) -> RecallRow {
        let reports = |cells: &[&'a Cell]| -> Vec<&'a RecallReport> {
            cells.iter().filter_map(|c| c.report.recalls.get(benchmark)).collect()
        };
        let summaries: Vec<RecallSummary> =
            self.by_seed.iter().map(|cells| RecallSummary::new(reports(cells))).collect();
        // Not of those seeds alone that tell: they would be other seeds than those of the other figures.
        let of_all_seeds = |of: fn(&RecallSummary) -> Option<f64>| {
            let counted = summaries.iter().filter(|s| s.scenes > 0);
            counted.map(of).collect::<Option<Vec<f64>>>().and_then(Spread::new)
        };
        let of_scene = |(dataset, scene): &(String, String)| {
            let here = self.cells().filter(|c| c.key.dataset == *dataset && c.key.scene == *scene);
            let values: Vec<f64> = here.filter_map(|c| c.report.recalls.get(benchmark)?.recall()).collect();
            Spread::new(values).map(|s| s.mean)
        };
        RecallRow {
            dataset: self.dataset.to_owned(),
            benchmark: benchmark.to_owned(),
            method: self.method.to_owned(),
            quoted: None,
            keypoints: self.keypoints,
            scenes: summaries.iter().map(|s| s.scenes).max().unwrap_or(0),
            cells: (self.cells().count(), self.planned),
            recall: Spread::new(summaries.iter().filter_map(|s| s.mean_of_scenes).collect()),
            pooled: Spread::new(summaries.iter().filter_map(|s| s.pooled).collect()),
            recall_in_largest: of_all_seeds(|s| s.mean_of_scenes_in_largest),
            pooled_in_largest: of_all_seeds(|s| s.pooled_in_largest),
            by_scene: scenes.iter().map(of_scene).collect(),
            declined: self.declined(),
            cost: self.cost(),
        }
    }

    pub fn errors(&self) -> ErrorRow {
        let of_seed = |cells: &Vec<&Cell>| {
            let scenes: Vec<_> = cells.iter().filter_map(|c| c.report.errors.clone()).collect();
            ErrorDistribution::over_scenes(&scenes)
        };
        let seeds: Vec<ErrorDistribution> = self.by_seed.iter().filter_map(of_seed).collect();
        ErrorRow {
            dataset: self.dataset.to_owned(),
            method: self.method.to_owned(),
            keypoints: self.keypoints,
            cells: (self.cells().count(), self.planned),
            errors: ErrorDistribution::over_scenes(&seeds),
            declined: self.declined(),
            cost: self.cost(),
        }
    }

    /// One row for every benchmark that a pair failed in.
    pub fn causes(&self) -> Vec<CauseRow> {
        let failed = || self.cells().filter_map(|c| c.diagnosis.as_ref()).flat_map(|d| &d.pairs);
        let names: BTreeSet<&String> = failed().map(|p| &p.benchmark).collect();
        let seeds = self.by_seed.len().max(1) as f64;
        let row = |name: &String| {
            let share = |counts: &dyn Fn(&PairFinding) -> bool| {
                failed().filter(|p| p.benchmark == *name && counts(p)).count() as f64 / seeds
            };
            CauseRow {
                dataset: self.dataset.to_owned(),
                benchmark: name.clone(),
                method: self.method.to_owned(),
                keypoints: self.keypoints,
                failed: share(&|_| true),
                by_cause: Cause::ALL.map(|cause| share(&|p| p.cause == cause)),
                carried: share(&|p| p.carried),
            }
        };
        names.into_iter().map(row).collect()
    }

    /// Placed scans by their stated probability; `None` where none was stated or the truth is unknown.
    pub fn trust(&self) -> Option<TrustRow> {
        let scans = self.cells().filter_map(|c| c.diagnosis.as_ref()).flat_map(|d| &d.scans);
        let judged =
            scans.filter(|s| s.component.is_some()).filter_map(|s| Some((s.probability?, s.cause.is_none())));
        Some(TrustRow {
            dataset: self.dataset.to_owned(),
            method: self.method.to_owned(),
            keypoints: self.keypoints,
            reliability: Reliability::new(judged)?,
        })
    }

    fn declined(&self) -> f64 {
        let all: usize = self.cells().map(|c| c.report.declined.len()).sum();
        all as f64 / self.by_seed.len().max(1) as f64
    }

    fn cost(&self) -> Option<Cost> {
        let seconds = Spread::new(self.cells().map(Cell::seconds).collect())?;
        Some(Cost {
            seconds: seconds.mean,
            seconds_most: seconds.high,
            peak_memory_bytes: self.cells().filter_map(|c| c.peak_memory_bytes).max(),
        })
    }
}
