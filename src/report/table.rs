//! The summary a person reads.

use super::run::{Row, RunReport};
use comfy_table::{Attribute, Cell, CellAlignment, ContentArrangement, Table, presets};
use std::fmt::Write;

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
    write!(
        text,
        "\nscale    {}\noverlap  {}\ntime     {:.1} s (",
        report.scale,
        report.overlap_head,
        report.total_seconds
    )
    .ok();
    let stages: Vec<String> =
        report.timings.iter().map(|t| format!("{} {:.1}", t.stage, t.seconds)).collect();
    write!(text, "{}), {} thread{}", stages.join(", "), report.threads, plural(report.threads)).ok();
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

fn scans_table(rows: &[Row], width: Option<u16>) -> String {
    let components = rows.iter().filter_map(|r| r.component).max().unwrap_or(0);
    let explained = rows.iter().any(|r| r.reason.is_some());
    let mut heads = vec!["scan", "outcome"];
    if components > 0 {
        heads.push("component");
    }
    heads.extend(["step", "parent", "matches", "inliers", "ratio", "overlap", "residual"]);
    if explained {
        heads.push("reason");
    }
    let mut table = Table::new();
    table.load_style(presets::UTF8_HORIZONTAL_ONLY).set_content_arrangement(ContentArrangement::Dynamic);
    if let Some(width) = width {
        table.set_width(width);
    }
    table.set_header(heads.iter().map(|h| Cell::new(h).add_attribute(Attribute::Bold)));
    for row in rows {
        let number = |v: Option<usize>| v.map(|v| v.to_string()).unwrap_or_default();
        let share = |v: Option<f64>| v.map(|v| format!("{v:.2}")).unwrap_or_default();
        let mut cells = vec![row.scan.clone(), row.outcome.to_owned()];
        if components > 0 {
            cells.push(number(row.component));
        }
        cells.extend([
            number(row.step),
            row.parent.clone().unwrap_or_default(),
            number(row.matches),
            number(row.inliers),
            share(row.inlier_ratio),
            share(row.overlap),
            row.residual_m.map(length).unwrap_or_default(),
        ]);
        if explained {
            cells.push(row.reason.clone().unwrap_or_default());
        }
        table.add_row(cells);
    }
    for (i, head) in heads.iter().enumerate() {
        if let Some(column) = table.column_mut(i).filter(|_| !["scan", "outcome", "parent", "reason"].contains(head))
        {
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
    fn lengths_carry_the_unit_a_person_would_use() {
        assert_eq!(length(12.345), "12.35 m");
        assert_eq!(length(0.0523), "5.2 cm");
        assert_eq!(length(0.0015), "1.50 mm");
        assert_eq!(length(0.0), "0.00 mm");
    }
}
