//! The files that sum a suite up: tables, plots and the page with both.

use super::cell::Cell;
use super::markdown::markdown;
use super::page;
use super::plan::Plan;
use super::plots;
use super::suite::Suite;
use super::table::{Cost, ErrorRow, RecallRow, Spread, Table};
use crate::Result;
use crate::evaluation::pose_error::{ROTATION_THRESHOLDS_DEG, TRANSLATION_THRESHOLDS_M};
use crate::evaluation::retrieval_scores::RetrievalScores;
use crate::files;
use crate::report::chart;
use crate::report::grid::csv;
use std::io::Write;
use std::path::Path;

/// The page in an output folder.
const PAGE: &str = "report.html";

/// Writes all tables and plots, and report.html with them, into `folder` and returns the table for people.
///
/// # Errors
/// [`crate::Error::Write`].
pub fn write(folder: &Path, suite: &Suite, plan: &Plan, table: &Table, cells: &[Cell]) -> Result<String> {
    let text = markdown(table);
    let json = serde_json::to_string_pretty(table).unwrap_or_default() + "\n";
    for (name, content) in [
        ("cells.csv", &cells_csv(cells)),
        ("table.csv", &table_csv(table)),
        ("table.json", &json),
        ("table.md", &text),
    ] {
        files::write(&folder.join(name), |out| out.write_all(content.as_bytes()))?;
    }
    let plots = plots::all(suite, table, cells);
    for (name, panels) in &plots {
        files::write(&folder.join(name), |out| out.write_all(chart::svg(panels)?.as_bytes()))?;
    }
    let page = page::page(plan, table, cells, &plots)?.html();
    files::write(&folder.join(PAGE), |out| out.write_all(page.as_bytes()))?;
    Ok(text)
}

fn number(value: Option<f64>) -> String {
    value.map(|v| format!("{v:.6}")).unwrap_or_default()
}

const TABLE_COLUMNS: [&str; 18] = [
    "dataset",
    "benchmark",
    "method",
    "quoted",
    "keypoints",
    "figure",
    "mean",
    "low",
    "high",
    "deviation",
    "seeds",
    "scenes",
    "cells",
    "cells_planned",
    "declined",
    "seconds_a_scene",
    "seconds_at_most",
    "peak_memory_bytes",
];

/// One line a figure: recalls first, then errors.
fn table_csv(table: &Table) -> String {
    let recalls = table.recalls.iter().flat_map(recall_lines);
    csv(&TABLE_COLUMNS, &recalls.chain(table.errors.iter().flat_map(error_lines)).collect::<Vec<_>>())
}

fn recall_lines(row: &RecallRow) -> Vec<Vec<String>> {
    let line = |(figure, spread): (&str, &Option<Spread>)| {
        let spread = spread.as_ref()?;
        let mut values = vec![
            row.dataset.clone(),
            row.benchmark.clone(),
            row.method.clone(),
            row.quoted.clone().unwrap_or_default(),
            row.keypoints.to_string(),
            figure.to_owned(),
        ];
        values.extend([Some(spread.mean), Some(spread.low), Some(spread.high), spread.deviation].map(number));
        values.extend([spread.values.len(), row.scenes, row.cells.0, row.cells.1].map(|n| n.to_string()));
        values.push(number(Some(row.declined)));
        values.extend(cost_columns(row.cost.as_ref()));
        Some(values)
    };
    let figures = [
        ("recall", &row.recall),
        ("pooled", &row.pooled),
        ("recall in largest", &row.recall_in_largest),
        ("pooled in largest", &row.pooled_in_largest),
    ];
    figures.into_iter().filter_map(line).collect()
}

fn cost_columns(cost: Option<&Cost>) -> [String; 3] {
    let memory = cost.and_then(|c| c.peak_memory_bytes).map(|b| b.to_string()).unwrap_or_default();
    [number(cost.map(|c| c.seconds)), number(cost.map(|c| c.seconds_most)), memory]
}

fn error_lines(row: &ErrorRow) -> Vec<Vec<String>> {
    let Some(errors) = &row.errors else { return Vec::new() };
    let within = |name: &str, limits: [f64; 5], unit: &str, shares: [f64; 5]| {
        let figure = |l: f64| format!("{name} within {l} {unit}");
        limits.into_iter().map(figure).zip(shares.map(Some)).collect::<Vec<_>>()
    };
    let mut figures = within("rotation", ROTATION_THRESHOLDS_DEG, "deg", errors.rotation_cdf);
    figures.extend(within("translation", TRANSLATION_THRESHOLDS_M, "m", errors.translation_cdf));
    figures.push(("rotation mean deg".to_owned(), errors.rotation_mean_deg));
    figures.push(("rotation median deg".to_owned(), errors.rotation_median_deg));
    figures.push(("translation mean m".to_owned(), errors.translation_mean_m));
    figures.push(("translation median m".to_owned(), errors.translation_median_m));
    let line = |(figure, value): (String, Option<f64>)| {
        let mut values = vec![row.dataset.clone(), "scannet".to_owned(), row.method.clone(), String::new()];
        values.extend([row.keypoints.to_string(), figure, number(value)]);
        // No spread, and no count of seeds and scenes of its own.
        values.extend(vec![String::new(); 5]);
        values.extend([row.cells.0.to_string(), row.cells.1.to_string(), number(Some(row.declined))]);
        values.extend(cost_columns(row.cost.as_ref()));
        values
    };
    figures.into_iter().map(line).collect()
}

const CELL_COLUMNS: [&str; 23] = [
    "dataset",
    "scene",
    "method",
    "keypoints",
    "seed",
    "benchmark",
    "counted",
    "succeeded",
    "succeeded_in_largest",
    "zero_information",
    "scans",
    "placed",
    "declined",
    "spearman",
    "recall_at_10_overlap_30",
    "recall_at_10_overlap_10",
    "similarity_s",
    "registration_s",
    "features_s",
    "features_reused",
    "peak_memory_bytes",
    "threads",
    "jobs",
];

/// One line a cell and benchmark; a cell without a benchmark that counts pairs has one line.
fn cells_csv(cells: &[Cell]) -> String {
    csv(&CELL_COLUMNS, &cells.iter().flat_map(cell_lines).collect::<Vec<_>>())
}

fn cell_lines(cell: &Cell) -> Vec<Vec<String>> {
    let stage = |name: &str| {
        let found = cell.timings.iter().filter(|t| t.stage == name);
        format!("{:.3}", found.map(|t| t.seconds).sum::<f64>())
    };
    let score = |of: fn(&RetrievalScores) -> f64| number(cell.retrieval.as_ref().map(of));
    let (key, report) = (&cell.key, &cell.report);
    let declined: Vec<&str> = report.declined.iter().map(|d| d.scan.as_str()).collect();
    let line = |counts: [String; 5]| {
        let mut values = vec![key.dataset.clone(), key.scene.clone(), key.method.clone()];
        values.extend([key.keypoints.to_string(), key.seed.to_string()]);
        values.extend(counts);
        values.extend([report.scans.to_string(), report.placed.to_string(), declined.join(" ")]);
        values.extend([
            score(|s| s.spearman),
            score(|s| s.recall_overlap_30),
            score(|s| s.recall_overlap_10),
        ]);
        values.extend(["similarity", "registration", "features"].map(stage));
        values.push(cell.features_reused.to_string());
        values.push(cell.peak_memory_bytes.map(|b| b.to_string()).unwrap_or_default());
        values.extend([cell.environment.threads.to_string(), cell.environment.jobs.to_string()]);
        values
    };
    if report.recalls.is_empty() {
        return vec![line([const { String::new() }; 5])];
    }
    let counted = report.recalls.iter().map(|(name, r)| {
        let in_largest = r.succeeded_in_largest.map(|n| n.to_string()).unwrap_or_default();
        let (counted, succeeded) = (r.counted.to_string(), r.succeeded.to_string());
        [name.clone(), counted, succeeded, in_largest, r.zero_information.to_string()]
    });
    counted.map(line).collect()
}
