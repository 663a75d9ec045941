//! A picture of the tree of joins, and where it went wrong.

use super::markup::escaped;
use crate::evaluation::diagnosis::{Diagnosis, ScanFinding};
use std::fmt::Write;

const ROW: f64 = 22.0;
const COLUMN: f64 = 46.0;
const MARGIN: f64 = 24.0;
const LEGEND: f64 = 46.0;

/// What a node's colour means.
const MEANINGS: [(&str, &str); 5] = [
    ("#009e73", "right"),
    ("#e6c200", "right beside its neighbours, drifted from the pivot"),
    ("#d55e00", "went wrong itself"),
    ("#e69f00", "carried along"),
    ("#8c8c8c", "declined"),
];

fn color(finding: &ScanFinding, limit_m: f64) -> &'static str {
    let drifted = finding.pivot_error_m.is_some_and(|e| e > limit_m);
    let meaning = match (finding.component, finding.cause, finding.origin) {
        (None, ..) => 4,
        (_, Some(_), _) => 2,
        (_, None, Some(_)) => 3,
        (_, None, None) if drifted => 1,
        _ => 0,
    };
    MEANINGS[meaning].0
}

/// SVG of the trees of joins of all components, each scan one row below its parent or an earlier
/// child of it, indented by its depth; declined scans at the end. A thick line is a join with many
/// inliers.
pub fn svg(diagnosis: &Diagnosis) -> String {
    let rows = rows(&diagnosis.scans);
    let mut place = vec![(0.0, 0.0); diagnosis.scans.len()];
    for (at, &(scan, depth)) in rows.iter().enumerate() {
        place[scan] = (MARGIN + COLUMN * depth as f64, MARGIN + LEGEND + ROW * at as f64);
    }
    let deepest = rows.iter().map(|r| r.1).max().unwrap_or(0) as f64;
    let (width, height) =
        (2.0 * MARGIN + COLUMN * deepest + 620.0, 2.0 * MARGIN + LEGEND + ROW * rows.len() as f64);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
    );
    let mut x = MARGIN;
    for (color, meaning) in MEANINGS {
        writeln!(
            out,
            "<circle cx=\"{x:.0}\" cy=\"18\" r=\"5\" fill=\"{color}\"/><text x=\"{:.0}\" y=\"22\">{meaning}</text>",
            x + 10.0
        )
        .ok();
        x += 34.0 + 6.4 * meaning.len() as f64;
    }
    for (scan, finding) in diagnosis.scans.iter().enumerate() {
        let Some(parent) = finding.parent else { continue };
        let ((x, y), (px, py)) = (place[scan], place[parent]);
        let thickness = (0.6 + finding.inliers as f64 / 60.0).min(6.0);
        writeln!(
            out,
            "<path d=\"M{px:.0} {py:.0}V{y:.0}H{x:.0}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{thickness:.1}\"/>",
            if finding.cause.is_some() { MEANINGS[2].0 } else { "#b0b0b0" }
        )
        .ok();
    }
    for (scan, finding) in diagnosis.scans.iter().enumerate() {
        let (x, y) = place[scan];
        writeln!(
            out,
            "<circle cx=\"{x:.0}\" cy=\"{y:.0}\" r=\"5\" fill=\"{}\"/><text x=\"{:.0}\" y=\"{:.0}\">{}</text>",
            color(finding, diagnosis.limit_m),
            x + 10.0,
            y + 4.0,
            escaped(&label(finding))
        )
        .ok();
    }
    out.push_str("</svg>\n");
    out
}

/// Scans with their depth, every tree in depth-first order, children by step.
fn rows(scans: &[ScanFinding]) -> Vec<(usize, usize)> {
    let mut children: Vec<Vec<usize>> = vec![Vec::new(); scans.len()];
    let mut roots = Vec::new();
    let mut order: Vec<usize> = (0..scans.len()).collect();
    order.sort_by_key(|&s| (scans[s].component.unwrap_or(usize::MAX), scans[s].step, s));
    for scan in order {
        match scans[scan].parent.filter(|&p| p < scans.len() && p != scan) {
            Some(parent) => children[parent].push(scan),
            None => roots.push(scan),
        }
    }
    let mut stack: Vec<(usize, usize)> = roots.into_iter().rev().map(|s| (s, 0)).collect();
    let mut rows = Vec::new();
    while let Some((scan, depth)) = stack.pop() {
        rows.push((scan, depth));
        stack.extend(children[scan].iter().rev().map(|&c| (c, depth + 1)));
    }
    rows
}

fn label(f: &ScanFinding) -> String {
    let mut text = f.scan.clone();
    if let Some(reason) = &f.reason {
        write!(text, ": {reason}").ok();
        return text;
    }
    if let (Some(step), Some(_)) = (f.step, f.parent) {
        write!(text, "  step {step}, {}/{} matches", f.inliers, f.matches).ok();
    }
    if let Some(p) = f.probability {
        write!(text, ", p {p:.2}").ok();
    }
    if let Some(error) = f.join_error_m {
        write!(text, ", joined {error:.2} m off").ok();
    }
    if let Some(error) = f.final_error_m {
        write!(text, ", now {error:.2} m").ok();
    }
    if let Some(cause) = f.cause {
        write!(text, ": {}", cause.name()).ok();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::diagnosis::Cause;

    fn finding(scan: &str, parent: Option<usize>, step: usize) -> ScanFinding {
        ScanFinding {
            scan: scan.to_owned(),
            component: Some(0),
            step: Some(step),
            parent,
            cause: None,
            origin: None,
            join_error_m: None,
            final_error_m: None,
            pivot_error_m: None,
            matches: 10,
            inliers: 5,
            probability: None,
            best_before: None,
            best_after: None,
            reason: None,
        }
    }

    #[test]
    fn every_scan_has_its_row_and_its_colour() {
        let mut scans = vec![
            finding("a<b", Some(1), 1),
            finding("pivot", None, 0),
            finding("wrong", Some(1), 2),
            finding("carried", Some(2), 3),
            finding("lost", None, 0),
        ];
        (scans[2].cause, scans[2].origin) = (Some(Cause::WrongPose), Some(2));
        scans[3].origin = Some(2);
        (scans[4].component, scans[4].reason) = (None, Some("no keypoints".to_owned()));
        // The pivot, its children by step, the carried one below its parent, the declined one last.
        assert_eq!(rows(&scans), [(1, 0), (0, 1), (2, 1), (3, 2), (4, 0)]);
        let text = svg(&Diagnosis { limit_m: 0.2, scans, pairs: Vec::new() });
        assert!(
            text.contains("a&lt;b") && text.contains("wrong  step 2, 5/10 matches: wrong pose"),
            "{text}"
        );
        // One of the legend and one node for each of right (2 nodes), wrong, carried, declined.
        let circles = |color: &str| text.matches(&format!("r=\"5\" fill=\"{color}\"")).count();
        assert_eq!(MEANINGS.map(|m| circles(m.0)), [3, 1, 2, 2, 2]);
        assert_eq!(text.matches("<path").count(), 3);
    }
}
