//! The summary a person reads.

use crate::files::printable;
use crate::result::{Row, RunReport};
use crate::scan::Doubt;
use comfy_table::{Attribute, Cell, CellAlignment, ContentArrangement, Table};
use comfy_table::{LineStyle, TableStyle};
use std::fmt::Write;

/// One rule under the heads, none between rows.
const STYLE: TableStyle = TableStyle::new().header_separator(LineStyle::none().fill('─').junction('─'));

/// A table with one line a scan, followed by the lines that sum the run up; `width` in
/// characters, that of the terminal where `None`.
pub fn summary(report: &RunReport, width: Option<u16>) -> String {
    let mut text = scans_table(&report.evidence, width);
    let plural = |n: usize| if n == 1 { "" } else { "s" };
    let total = report.placed + report.declined;
    write!(
        text,
        "\nplaced   {} of {total} scan{} in {} component{}",
        report.placed,
        plural(total),
        report.components,
        plural(report.components)
    )
    .ok();
    if report.declined > 0 {
        write!(text, "; {} declined for the reasons above", report.declined).ok();
    }
    if report.components > 1 {
        text.push_str(" (poses of different components are unrelated)");
    }
    for (doubt, meaning) in [
        (Doubt::Ambiguous, "ambiguous: another pose is not ruled out"),
        (Doubt::PoorlyLocalised, "poorly localised: held loosely by what touches it"),
    ] {
        let doubtful: Vec<&str> =
            report.evidence.iter().filter(|r| r.doubts.contains(&doubt)).map(|r| r.scan.as_str()).collect();
        if !doubtful.is_empty() {
            write!(text, "\ndoubtful {} {meaning} ({})", doubtful.len(), named(&doubtful)).ok();
        }
    }
    write!(
        text,
        "\nscale    {}\noverlap  {}\ntime     {:.1} s (",
        report.scale,
        printable(&report.overlap_head),
        report.total_seconds
    )
    .ok();
    let stages: Vec<String> =
        report.timings.iter().map(|t| format!("{} {:.1}", printable(&t.stage), t.seconds)).collect();
    write!(text, "{}), {} thread{}", stages.join(", "), report.threads, plural(report.threads)).ok();
    if let (Some(registered), Some(edges)) = (report.registered_pairs, report.edges) {
        write!(text, "\npairs    {registered} registered, {edges} kept for {}", printable(&report.method))
            .ok();
    }
    let reused = report.sizes.iter().filter(|s| s.features_reused).count();
    if reused > 0 {
        write!(text, "\nfeatures {reused} of {total} reused").ok();
    }
    if let Some(bytes) = report.peak_memory_bytes {
        write!(text, "\nmemory   {:.0} MB at most", bytes as f64 / 1e6).ok();
    }
    text.push('\n');
    text
}

/// The first few names, and how many more there are.
fn named(names: &[&str]) -> String {
    const FEW: usize = 5;
    let first = names[..names.len().min(FEW)].join(", ");
    let first = printable(&first);
    if names.len() > FEW { format!("{first} and {} more", names.len() - FEW) } else { first.into_owned() }
}

fn scans_table(rows: &[Row], width: Option<u16>) -> String {
    let several = rows.iter().any(|r| r.component.is_some_and(|c| c > 0));
    let explained = rows.iter().any(|r| r.reason.is_some());
    let mut columns = evidence_columns(rows);
    if several {
        columns.insert(2, ("component", rows.iter().map(|r| number(r.component)).collect()));
    }
    if explained {
        columns.push(("reason", rows.iter().map(|r| r.reason.clone().unwrap_or_default()).collect()));
    }
    drawn(&columns, width)
}

/// A table with one line a scan that sets its error against the truth: rotation (degrees)
/// and translation (metres) where it can be compared, and whether it is right.
pub fn against_truth(rows: &[Row], errors: &[(Option<(f64, f64)>, bool)], width: Option<u16>) -> String {
    let cell = |text: fn(f64, f64) -> String| {
        errors.iter().map(|(e, _)| e.map(|(deg, m)| text(deg, m)).unwrap_or_default()).collect()
    };
    let mut columns = evidence_columns(rows);
    columns.push(("angle off", cell(|deg, _| format!("{deg:.2}°"))));
    columns.push(("shift off", cell(|_, m| length(m))));
    columns.push(("truth", errors.iter().map(|e| if e.1 { "right" } else { "WRONG" }.to_owned()).collect()));
    drawn(&columns, width)
}

/// Head and cells of each column that every table of scans has.
fn evidence_columns(rows: &[Row]) -> Vec<(&'static str, Vec<String>)> {
    let column = |cell: fn(&Row) -> String| rows.iter().map(cell).collect();
    vec![
        ("scan", column(|r| r.scan.clone())),
        ("outcome", column(|r| r.outcome.to_owned())),
        ("step", column(|r| number(r.step))),
        ("parent", column(|r| r.parent.clone().unwrap_or_default())),
        ("matches", column(|r| number(r.matches))),
        ("inliers", column(|r| number(r.inliers))),
        ("ratio", column(|r| share(r.inlier_ratio))),
        ("overlap", column(|r| share(r.overlap))),
        ("residual", column(|r| r.residual_m.map(length).unwrap_or_default())),
        ("prob.", column(|r| share(r.probability))),
    ]
}

fn number(value: Option<usize>) -> String {
    value.map(|v| v.to_string()).unwrap_or_default()
}

fn share(value: Option<f64>) -> String {
    value.map(|v| format!("{v:.2}")).unwrap_or_default()
}

/// A table of columns, each a head and its cells, which are made printable here; all but those of text are aligned right.
pub(super) fn drawn(columns: &[(&str, Vec<String>)], width: Option<u16>) -> String {
    const TEXT: [&str; 8] = ["scan", "outcome", "parent", "reason", "truth", "file", "tensor", "type"];
    let mut table = Table::new();
    table.load_style(STYLE).set_content_arrangement(ContentArrangement::Dynamic);
    if let Some(width) = width {
        table.set_width(width);
    }
    table.set_header(columns.iter().map(|(head, _)| Cell::new(head).add_attribute(Attribute::Bold)));
    for row in 0..columns.first().map_or(0, |c| c.1.len()) {
        table.add_row(columns.iter().map(|(_, cells)| printable(&cells[row])));
    }
    for (i, _) in columns.iter().enumerate().filter(|(_, c)| !TEXT.contains(&c.0)) {
        if let Some(column) = table.column_mut(i) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    format!("{table}\n")
}

/// A length with the unit that suits it.
pub fn length(metres: f64) -> String {
    match metres.abs() {
        m if m >= 1.0 => format!("{metres:.2} m"),
        m if m >= 0.01 => format!("{:.1} cm", metres * 100.0),
        _ => format!("{:.2} mm", metres * 1000.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_placed_scan_has_its_stated_probability_and_declined_scans_have_none() {
        let row = |scan: &str, outcome: &str, probability: Option<f64>| Row {
            scan: scan.to_owned(),
            outcome: outcome.to_owned(),
            component: None,
            step: None,
            parent: None,
            matches: None,
            inliers: None,
            inlier_ratio: None,
            overlap: None,
            residual_m: None,
            probability,
            doubts: Vec::new(),
            reason: None,
        };
        let rows =
            [row("a", "pivot", Some(0.996)), row("b", "placed", Some(0.874)), row("c", "declined", None)];
        let table = scans_table(&rows, Some(120));
        let lines: Vec<&str> = table.lines().map(str::trim_end).collect();
        assert!(lines[0].ends_with("prob."), "{table}");
        let ends: Vec<&str> = lines[2..].iter().map(|l| l.split_whitespace().last().unwrap()).collect();
        assert_eq!(ends, ["1.00", "0.87", "declined"]);
    }

    #[test]
    fn a_few_names_stand_for_many() {
        assert_eq!(named(&["a", "b"]), "a, b");
        assert_eq!(named(&["a", "b", "c", "d", "e", "f", "g"]), "a, b, c, d, e and 2 more");
    }

    #[test]
    fn lengths_carry_the_unit_a_person_would_use() {
        assert_eq!(length(12.345), "12.35 m");
        assert_eq!(length(0.0523), "5.2 cm");
        assert_eq!(length(0.0015), "1.50 mm");
        assert_eq!(length(0.0), "0.00 mm");
    }
}
