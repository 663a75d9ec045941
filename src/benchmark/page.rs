//! `report.html` of a suite: its tables and plots on one page.

use super::cell::Cell;
use super::markdown;
use super::plan::Plan;
use super::table::{RecallRow, Table};
use crate::Result;
use crate::evaluation::diagnosis::{Cause, Diagnosis};
use crate::report::chart::Panel;
use crate::report::grid::{Grid, heads};
use crate::report::sheet::{Block, Section, Sheet};

/// The page of a suite; `plots` are names of files and what is drawn in them.
///
/// # Errors
/// A plot that cannot be laid out.
pub(super) fn page(
    plan: &Plan,
    table: &Table,
    cells: &[Cell],
    plots: &[(String, Vec<Panel>)],
) -> Result<Sheet> {
    let mut sections: Vec<Section> = best(table).into_iter().collect();
    sections.extend(markdown::parts(table).into_iter().map(Section::from));
    if !plots.is_empty() {
        let picture = |(name, panels): &(String, Vec<Panel>)| Block::chart(panels, caption(name));
        sections.push(Section {
            title: "Plots".to_owned(),
            text: String::new(),
            blocks: plots.iter().map(picture).collect::<Result<_>>()?,
        });
    }
    sections.extend(missing(plan, cells));
    sections.extend(failures(cells));
    let all = format!("{} of {} cells are computed", table.done, table.planned);
    let note = match table.done < table.planned {
        true => format!("Not finished: {all}. Figures are those of the cells that are there."),
        false => format!("All {} cells are computed.", table.planned),
    };
    Ok(Sheet { brand: "Scanweave benchmark".to_owned(), headline: table.suite.clone(), note, sections })
}

/// What a file of plots shows.
fn caption(name: &str) -> String {
    let stem = name.trim_end_matches(".svg");
    let (stem, keypoints) = match stem.rsplit_once('_') {
        Some((kind, count)) if count.parse::<usize>().is_ok() => {
            (kind, format!(", {count} keypoints a scan"))
        }
        _ => (stem, String::new()),
    };
    let what = match stem {
        "recall_by_keypoints" => "Registration recall by keypoints, quoted figures beside ours",
        "cost" => "Time and memory of every cell",
        "recall_by_overlap" => "Registered pairs by true overlap",
        "errors" => "Distributions of the errors of relative poses",
        "reliability" => "Share of right scans against their stated probability",
        other => other,
    };
    format!("{what}{keypoints} ({name})")
}

/// The best of our own rows of every benchmark, in large figures.
fn best(table: &Table) -> Option<Section> {
    let mut figures: Vec<(&RecallRow, f64)> = Vec::new();
    for row in table.recalls.iter().filter(|r| r.quoted.is_none()) {
        let Some(recall) = row.recall.as_ref().map(|s| s.mean) else { continue };
        let same = |f: &&mut (&RecallRow, f64)| f.0.dataset == row.dataset && f.0.benchmark == row.benchmark;
        match figures.iter_mut().find(same) {
            Some(best) if recall > best.1 => *best = (row, recall),
            Some(_) => {}
            None => figures.push((row, recall)),
        }
    }
    if figures.is_empty() {
        return None;
    }
    let figure = |(row, recall): &(&RecallRow, f64)| {
        let what = format!("{}: {}, {} keypoints a scan", row.benchmark, row.method, row.keypoints);
        (format!("{:.1} %", 100.0 * recall), what)
    };
    Some(Section {
        title: "Highest registration recall".to_owned(),
        text: "The best of the methods measured here within all components, mean of the scenes and seeds."
            .to_owned(),
        blocks: vec![Block::Figures(figures.iter().map(figure).collect())],
    })
}

/// Cells that the plan asks for and that are not there.
fn missing(plan: &Plan, cells: &[Cell]) -> Option<Section> {
    let gone = plan.cells.iter().filter(|p| !cells.iter().any(|c| c.key == p.key));
    let row = |p: &super::plan::PlannedCell| {
        let k = &p.key;
        let names = [&k.dataset, &k.scene, &k.method].map(String::clone);
        names.into_iter().chain([k.keypoints.to_string(), k.seed.to_string()]).collect()
    };
    let rows: Vec<Vec<String>> = gone.map(row).collect();
    if rows.is_empty() {
        return None;
    }
    let text = format!("{} missing or out-of-date cells", rows.len());
    let grid = Grid::new(heads(&["data set", "scene", "method", "keypoints", "seed"]), 3, rows);
    Some(Section {
        title: "Cells that are not there".to_owned(),
        text: "The next start of the same command computes them.".to_owned(),
        blocks: vec![Block::Folded(text, grid)],
    })
}

/// Cells with failed pairs or scans that were left out, those with most failures first.
fn failures(cells: &[Cell]) -> Option<Section> {
    let failed = |c: &Cell| c.report.recalls.values().map(|r| r.counted - r.succeeded).sum::<usize>();
    let mut worst: Vec<(usize, &Cell)> = cells.iter().map(|c| (failed(c), c)).collect();
    worst.retain(|(failed, c)| *failed > 0 || !c.report.declined.is_empty());
    worst.sort_by_key(|&(failed, c)| std::cmp::Reverse((failed, c.report.declined.len())));
    if worst.is_empty() {
        return None;
    }
    let row = |&(failed, c): &(usize, &Cell)| {
        let counted: usize = c.report.recalls.values().map(|r| r.counted).sum();
        let (k, first) = (&c.key, c.diagnosis.as_ref().and_then(costliest));
        vec![
            k.dataset.clone(),
            k.scene.clone(),
            k.method.clone(),
            first.map(|(scan, cause)| format!("{scan}: {}", cause.name())).unwrap_or_default(),
            k.keypoints.to_string(),
            k.seed.to_string(),
            failed.to_string(),
            counted.to_string(),
            c.report.declined.len().to_string(),
        ]
    };
    let head = heads(&[
        "data set",
        "scene",
        "method",
        "costliest mistake",
        "keypoints",
        "seed",
        "failed pairs",
        "counted",
        "left out",
    ]);
    let text = format!("{} cells with failed pairs or scans that were left out", worst.len());
    Some(Section {
        title: "Where pairs failed".to_owned(),
        text: "The scan that most failed pairs of a cell began with, and how; `scanweave diagnose` on the \
               cell tells the evidence."
            .to_owned(),
        blocks: vec![Block::Folded(text, Grid::new(head, 4, worst.iter().map(row).collect()))],
    })
}

/// The scan that most failed pairs began with, the lower of equals.
fn costliest(found: &Diagnosis) -> Option<(&str, Cause)> {
    let pairs = |scan: usize| found.pairs.iter().filter(|p| p.scan == scan).count();
    let scan =
        (0..found.scans.len()).filter(|&s| pairs(s) > 0).min_by_key(|&s| std::cmp::Reverse(pairs(s)))?;
    let cause = found.pairs.iter().find(|p| p.scan == scan)?.cause;
    Some((found.scans[scan].scan.as_str(), cause))
}
