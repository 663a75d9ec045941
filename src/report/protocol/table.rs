//! Headings, paragraphs and tables as HTML, and numbers as text.

use crate::report::markup::escaped;
use std::fmt::Write;

/// A table whose heads repeat on every printed page. Cells are text and are escaped here.
pub(super) struct Table {
    caption: String,
    /// Head and whether the column holds numbers.
    head: Vec<(&'static str, bool)>,
    rows: Vec<Vec<String>>,
}

impl Table {
    pub fn new(caption: impl Into<String>, head: &[(&'static str, bool)]) -> Self {
        Self { caption: caption.into(), head: head.to_vec(), rows: Vec::new() }
    }

    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }

    // Writing into a `String` cannot fail.
    pub fn write(&self, out: &mut String) {
        out.push_str("<table>");
        if !self.caption.is_empty() {
            write!(out, "<caption>{}</caption>", escaped(&self.caption)).ok();
        }
        out.push_str("\n<thead><tr>");
        let class = |number: bool| if number { " class=\"n\"" } else { "" };
        for (head, number) in &self.head {
            write!(out, "<th scope=\"col\"{}>{}</th>", class(*number), escaped(head)).ok();
        }
        out.push_str("</tr></thead>\n<tbody>\n");
        for row in &self.rows {
            out.push_str("<tr>");
            for (cell, (_, number)) in row.iter().zip(&self.head) {
                // Isolated, so that a name written from right to left does not turn what follows it.
                match number {
                    true => write!(out, "<td class=\"n\">{}</td>", escaped(cell)).ok(),
                    false => write!(out, "<td><bdi>{}</bdi></td>", escaped(cell)).ok(),
                };
            }
            out.push_str("</tr>\n");
        }
        out.push_str("</tbody></table>\n");
    }
}

/// A table of single facts.
pub(super) fn facts(facts: &[(&str, String)], out: &mut String) {
    out.push_str("<table class=\"facts\"><tbody>\n");
    for (name, value) in facts {
        let (name, value) = (escaped(name), escaped(value));
        writeln!(out, "<tr><th scope=\"row\">{name}</th><td><bdi>{value}</bdi></td></tr>").ok();
    }
    out.push_str("</tbody></table>\n");
}

pub(super) fn heading(text: &str, out: &mut String) {
    writeln!(out, "<h2>{}</h2>", escaped(text)).ok();
}

pub(super) fn subheading(text: &str, out: &mut String) {
    writeln!(out, "<h3>{}</h3>", escaped(text)).ok();
}

pub(super) fn paragraph(text: &str, out: &mut String) {
    writeln!(out, "<p>{}</p>", escaped(text)).ok();
}

/// What stands where nothing was measured.
pub(super) const NONE: &str = "\u{2013}";

/// A number that is not negative, with three digits that count, or so many as its size asks for.
pub(super) fn significant(value: f64) -> String {
    match value {
        v if !v.is_finite() => NONE.to_owned(),
        0.0 => "0".to_owned(),
        v if v >= 100.0 => format!("{v:.0}"),
        v if v >= 10.0 => format!("{v:.1}"),
        v if v >= 1.0 => format!("{v:.2}"),
        v if v >= 0.1 => format!("{v:.3}"),
        v if v >= 0.01 => format!("{v:.4}"),
        v => format!("{v:.5}"),
    }
}

/// Metres as a number of millimetres.
pub(super) fn millimetres(metres: f64) -> String {
    // What nothing holds has deviations of any size; they only have to be seen to be large.
    if metres >= 1000.0 { "over 1 km".to_owned() } else { significant(1000.0 * metres) }
}

/// Radians as a number of degrees.
pub(super) fn degrees(radians: f64) -> String {
    if radians >= std::f64::consts::PI { "over 180".to_owned() } else { significant(radians.to_degrees()) }
}

/// A coordinate in metres; the last digit is below a hundredth of τ.
pub(super) fn coordinate(value: f64, inlier_radius_m: f64) -> String {
    let decimals = (2.0 - inlier_radius_m.log10()).ceil();
    let decimals = if decimals.is_finite() { decimals.clamp(2.0, 6.0) as usize } else { 3 };
    let text = format!("{value:.decimals$}");
    // No negative zero.
    if text.chars().all(|c| "-0.".contains(c)) { text.replace('-', "") } else { text }
}

/// A share of 1 in percent.
pub(super) fn percent(share: f64) -> String {
    if share.is_finite() { format!("{:.1}", 100.0 * share) } else { NONE.to_owned() }
}

/// A probability; what is not certain is not shown as 1.
pub(super) fn probability(p: f64) -> String {
    match p {
        p if !p.is_finite() => NONE.to_owned(),
        p if p < 1.0 && p > 0.999 => "> 0.999".to_owned(),
        p => format!("{p:.3}"),
    }
}
