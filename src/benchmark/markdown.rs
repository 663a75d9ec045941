//! A table for people.

use super::table::{CauseRow, Cost, ErrorRow, RecallRow, Spread, Table, TrustRow};
use super::trust::BINS;
use crate::evaluation::diagnosis::Cause;
use crate::evaluation::pose_error::{ROTATION_THRESHOLDS_DEG, TRANSLATION_THRESHOLDS_M};
use crate::report::grid::{Grid, Part, Row, heads};
use std::fmt::Write;

/// The whole table as Markdown.
pub fn markdown(table: &Table) -> String {
    let mut text = format!("# {}\n\n", table.suite);
    if table.done < table.planned {
        writeln!(text, "Not finished: {} of {} cells.\n", table.done, table.planned).ok();
    }
    text.extend(parts(table).iter().map(Part::markdown));
    text
}

/// The whole table, part by part.
pub(super) fn parts(table: &Table) -> Vec<Part> {
    let mut parts = vec![recalls(table)];
    parts.extend(by_scene(table));
    parts.extend([errors(table), causes(table), trust(table)]);
    parts.retain(|part| part.grids.iter().any(|grid| !grid.rows.is_empty()));
    parts
}

fn percent(value: f64) -> String {
    format!("{:.1}", 100.0 * value)
}

/// Mean, and least and greatest where there are several.
fn spread(value: Option<&Spread>) -> String {
    match value {
        None => "–".to_owned(),
        Some(s) if s.values.len() < 2 => percent(s.mean),
        Some(s) => format!("{} ({}–{})", percent(s.mean), percent(s.low), percent(s.high)),
    }
}

fn cells((done, planned): (usize, usize)) -> String {
    if done == planned { done.to_string() } else { format!("{done} of {planned}") }
}

fn cost(cost: Option<&Cost>) -> [String; 3] {
    let Some(cost) = cost else { return ["–", "–", "–"].map(str::to_owned) };
    let memory = cost.peak_memory_bytes.map_or("–".to_owned(), |b| format!("{:.0}", b as f64 / 1e6));
    [format!("{:.1}", cost.seconds), format!("{:.1}", cost.seconds_most), memory]
}

fn method(row: &RecallRow) -> String {
    match &row.quoted {
        Some(source) => format!("{}: quoted, {source}", row.method),
        None => row.method.clone(),
    }
}

fn recalls(table: &Table) -> Part {
    let text = "Percent; mean of the scenes, then the mean over seeds (least–greatest). \
         Pairs with a declined scan are failures. Recall is that within all components of a scene; in its \
         largest component alone, pairs of smaller components are failures too. Seconds and memory are those of a scene from \
         features to poses. Rows in italics are quoted, not measured here.";
    let head = heads(&[
        "benchmark",
        "method",
        "keypoints",
        "recall",
        "pooled",
        "recall in largest",
        "pooled in largest",
        "scenes",
        "cells",
        "declined",
        "s a scene",
        "s at most",
        "MB at most",
    ]);
    let row = |r: &RecallRow| {
        let (ours, [seconds, most, memory]) = (r.quoted.is_none(), cost(r.cost.as_ref()));
        let own = |text: String| if ours { text } else { "–".to_owned() };
        let cells = vec![
            r.benchmark.clone(),
            method(r),
            r.keypoints.to_string(),
            spread(r.recall.as_ref()),
            spread(r.pooled.as_ref()),
            spread(r.recall_in_largest.as_ref()),
            spread(r.pooled_in_largest.as_ref()),
            r.scenes.to_string(),
            own(cells(r.cells)),
            own(format!("{:.1}", r.declined)),
            seconds,
            most,
            memory,
        ];
        Row { cells, quoted: r.quoted.is_some() }
    };
    let grid = Grid { head, left: 2, rows: table.recalls.iter().map(row).collect() };
    Part { title: "Registration recall".to_owned(), text: text.to_owned(), grids: vec![grid] }
}

fn by_scene(table: &Table) -> Vec<Part> {
    let ours = || table.recalls.iter().filter(|r| r.quoted.is_none());
    let mut datasets: Vec<&String> = ours().map(|r| &r.dataset).collect();
    datasets.dedup();
    let part = |dataset: &String| {
        let columns: Vec<usize> =
            (0..table.scenes.len()).filter(|&s| table.scenes[s].0 == *dataset).collect();
        let mut head = heads(&["benchmark", "method", "keypoints"]);
        head.extend(columns.iter().map(|&s| table.scenes[s].1.clone()));
        let row = |r: &RecallRow| {
            let mut row = vec![r.benchmark.clone(), r.method.clone(), r.keypoints.to_string()];
            let scene = |&s: &usize| r.by_scene[s].map_or("–".to_owned(), percent);
            row.extend(columns.iter().map(scene));
            row
        };
        let rows = ours().filter(|r| r.dataset == *dataset).map(row).collect();
        let title = format!("Recall by scene: {dataset}");
        let text = "Percent, within all components.".to_owned();
        Part { title, text, grids: vec![Grid::new(head, 2, rows)] }
    };
    datasets.into_iter().map(part).collect()
}

fn errors(table: &Table) -> Part {
    let text = "Share of all pairs within each limit, percent; pairs with a declined scan \
         are beyond all of them. Mean over pairs with an estimate, median over all. Averaged over \
         scenes, then seeds.";
    let mut rotation = heads(&["data set", "method", "keypoints", "cells", "declined"]);
    let mut translation = rotation.clone();
    rotation.extend(ROTATION_THRESHOLDS_DEG.map(|t| format!("{t}°")));
    rotation.extend(heads(&["mean", "median"]));
    translation.extend(TRANSLATION_THRESHOLDS_M.map(|t| format!("{t} m")));
    translation.extend(heads(&["mean", "median"]));
    let start = |r: &ErrorRow| {
        vec![
            r.dataset.clone(),
            r.method.clone(),
            r.keypoints.to_string(),
            cells(r.cells),
            format!("{:.1}", r.declined),
        ]
    };
    let row = |r: &ErrorRow, of_rotation: bool| {
        let mut row = start(r);
        let Some(e) = &r.errors else {
            row.resize(12, "–".to_owned());
            return row;
        };
        let (cdf, mean, median, unit) = match of_rotation {
            true => (e.rotation_cdf, e.rotation_mean_deg, e.rotation_median_deg, "°"),
            false => (e.translation_cdf, e.translation_mean_m, e.translation_median_m, " m"),
        };
        row.extend(cdf.map(percent));
        row.extend([mean, median].map(|v| v.map_or("∞".to_owned(), |v| format!("{v:.3}{unit}"))));
        row
    };
    let grid =
        |(head, of_rotation)| Grid::new(head, 2, table.errors.iter().map(|r| row(r, of_rotation)).collect());
    let grids = [(rotation, true), (translation, false)].map(grid).to_vec();
    Part { title: "Relative pose errors".to_owned(), text: text.to_owned(), grids }
}

fn causes(table: &Table) -> Part {
    let text = "Failed pairs of all scenes by what went wrong first, mean over seeds; \
         carried: neither scan of the pair did (`scanweave diagnose` on a cell says more).";
    let mut head = heads(&["benchmark", "method", "keypoints", "failed"]);
    head.extend(Cause::ALL.map(|c| c.name().to_owned()));
    head.push("carried".to_owned());
    let row = |r: &CauseRow| {
        let mut row = vec![r.benchmark.clone(), r.method.clone(), r.keypoints.to_string()];
        let figures = [r.failed].into_iter().chain(r.by_cause).chain([r.carried]);
        row.extend(figures.map(|v| format!("{v:.1}")));
        row
    };
    let grid = Grid::new(head, 2, table.causes.iter().map(row).collect());
    Part { title: "Why pairs failed".to_owned(), text: text.to_owned(), grids: vec![grid] }
}

fn trust(table: &Table) -> Part {
    let text = "All scenes and seeds; a scan is wrong when it went wrong \
         itself. Calibration error: mean difference between stated probability and share of right \
         ones, over ten bins. The other columns: scans stated between these percentages, and the \
         percentage of them that is right.";
    let mut head =
        heads(&["data set", "method", "keypoints", "placed", "wrong", "wrong %", "calibration error %"]);
    let bounds = (0..BINS).map(|b| (100 * b / BINS, 100 * (b + 1) / BINS));
    head.extend(bounds.map(|(low, high)| format!("{low}–{high}")));
    let row = |r: &TrustRow| {
        let t = &r.reliability;
        let mut row = vec![r.dataset.clone(), r.method.clone(), r.keypoints.to_string()];
        row.extend([t.placed.to_string(), t.wrong.to_string()]);
        row.extend([t.wrong_share(), t.calibration_error].map(|v| format!("{:.2}", 100.0 * v)));
        row.extend(t.bins.iter().map(|b| match b.scans {
            0 => "–".to_owned(),
            n => format!("{n}: {}", percent(b.right)),
        }));
        row
    };
    let grid = Grid::new(head, 2, table.trust.iter().map(row).collect());
    let title = "Placed scans by their stated probability".to_owned();
    Part { title, text: text.to_owned(), grids: vec![grid] }
}
