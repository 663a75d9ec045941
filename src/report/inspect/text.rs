//! Findings as tables for a terminal.

use super::content::{FeatureContent, ResultContent, ScanContent};
use super::tensors::CheckpointContent;
use super::{Content, Finding};
use crate::files::{printable, printable_path};
use crate::report::table::{drawn, length};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write;

/// One table of all scans, one of all features, and a section for everything else; `width` in
/// characters, that of the terminal where `None`.
pub fn text(findings: &[Finding], width: Option<u16>) -> String {
    let mut parts = Vec::new();
    let scans: Vec<(&Finding, &ScanContent)> = findings
        .iter()
        .filter_map(|f| if let Content::Scan(s) = &f.content { Some((f, s)) } else { None })
        .collect();
    if !scans.is_empty() {
        parts.push(drawn(&scan_columns(&scans), width));
        let mut said: BTreeMap<&str, Vec<&Finding>> = BTreeMap::new();
        for (finding, content) in &scans {
            content.notes.iter().for_each(|note| said.entry(note).or_default().push(finding));
        }
        for (note, findings) in said {
            let more = match findings.len() {
                1 => String::new(),
                n => format!(" and {} more", n - 1),
            };
            parts.push(format!("{}{more}: {}\n", shown(findings[0]), printable(note)));
        }
    }
    let features: Vec<(&Finding, &FeatureContent)> = findings
        .iter()
        .filter_map(|f| if let Content::Features(c) = &f.content { Some((f, c)) } else { None })
        .collect();
    if !features.is_empty() {
        parts.push(drawn(&feature_columns(&features), width));
    }
    for finding in findings {
        match &finding.content {
            Content::Checkpoint(c) => parts.push(checkpoint(finding, c, width)),
            Content::Result(r) => parts.push(result(finding, r, width)),
            Content::Scan(_) | Content::Features(_) => {}
        }
    }
    parts.join("\n")
}

fn column<T>(rows: &[T], cell: impl Fn(&T) -> String) -> Vec<String> {
    rows.iter().map(cell).collect()
}

fn scan_columns(rows: &[(&Finding, &ScanContent)]) -> Vec<(&'static str, Vec<String>)> {
    let mut columns = vec![
        ("file", column(rows, |r| shown(r.0))),
        ("size", column(rows, |r| bytes(r.0.bytes))),
        ("points", column(rows, |r| r.1.points.to_string())),
        ("dropped", column(rows, |r| r.1.dropped_rows.to_string())),
        ("colour", column(rows, |r| yes(r.1.colors))),
        ("extent", column(rows, |r| extent(r.1.box_m))),
        ("from", column(rows, |r| r.1.box_m.map(|b| triple(b[0])).unwrap_or_default())),
        ("spacing", column(rows, |r| r.1.spacing_m.map(length).unwrap_or_default())),
    ];
    if rows.iter().any(|r| r.1.viewpoint_m.is_some()) {
        columns.push(("sensor at", column(rows, |r| r.1.viewpoint_m.map(triple).unwrap_or_default())));
    }
    if rows.iter().any(|r| r.1.origin_m != [0.0; 3]) {
        columns.push(("zero at", column(rows, |r| triple(r.1.origin_m))));
    }
    columns
}

fn feature_columns(rows: &[(&Finding, &FeatureContent)]) -> Vec<(&'static str, Vec<String>)> {
    let range = |v: Option<[f32; 2]>| v.map(|[a, b]| format!("{a:.3} … {b:.3}")).unwrap_or_default();
    vec![
        ("file", column(rows, |r| shown(r.0))),
        ("size", column(rows, |r| bytes(r.0.bytes))),
        ("keypoints", column(rows, |r| r.1.keypoints.to_string())),
        ("dimension", column(rows, |r| r.1.dim.to_string())),
        ("normals", column(rows, |r| yes(r.1.normals))),
        ("extent", column(rows, |r| extent(r.1.box_m))),
        ("values", column(rows, |r| range(r.1.values))),
        ("zero", column(rows, |r| r.1.zero_descriptors.to_string())),
    ]
}

fn checkpoint(finding: &Finding, content: &CheckpointContent, width: Option<u16>) -> String {
    let whose = if content.ours { "checkpoint, checksum right" } else { "checkpoint of another program" };
    let mut out = format!("{}: {whose}, {}\n", shown(finding), bytes(finding.bytes));
    for (key, value) in flat(&content.metadata) {
        writeln!(out, "  {key}  {value}").ok();
    }
    writeln!(out, "  {} parameters in {} tensors", content.parameters, content.tensors.len()).ok();
    let number = |v: Option<f64>| v.map(|v| format!("{v:.4}")).unwrap_or_default();
    let t = &content.tensors;
    let mut columns = vec![
        ("tensor", column(t, |t| t.name.clone())),
        ("type", column(t, |t| t.dtype.clone())),
        ("shape", column(t, |t| format!("{:?}", t.shape))),
        ("least", column(t, |t| number(t.range.map(|r| r[0].into())))),
        ("greatest", column(t, |t| number(t.range.map(|r| r[1].into())))),
        ("mean", column(t, |t| number(t.mean))),
    ];
    if t.iter().any(|t| t.not_finite > 0) {
        columns.push(("not finite", column(t, |t| t.not_finite.to_string())));
    }
    out + &drawn(&columns, width)
}

fn result(finding: &Finding, content: &ResultContent, width: Option<u16>) -> String {
    let mut out = format!("{}: result of {}\n", shown(finding), printable(&content.generator));
    let mut line = |key: &str, value: String| writeln!(out, "  {key:<10} {value}").unwrap_or_default();
    let sizes: Vec<String> = content.components.iter().map(usize::to_string).collect();
    line("placed", format!("{} of {} scans", content.placed, content.scans));
    line("components", format!("{} (scans: {})", sizes.len(), sizes.join(", ")));
    line("trajectory", content.trajectory_m.map(length).join(" × "));
    if let Some(residual) = content.mean_residual_m {
        line("residual", format!("{} on average", length(residual)));
    }
    if let Some(run) = &content.run {
        line(
            "made with",
            format!(
                "preset {}, method {}, seed {}",
                printable(&run.preset),
                printable(&run.method),
                run.seed
            ),
        );
        line("scale", run.scale.to_string());
        line("overlap", printable(&run.overlap_head).into_owned());
        line("time", format!("{:.1} s", run.total_seconds));
        if let Some(peak) = run.peak_memory_bytes {
            line("memory", format!("{} at most", bytes(peak)));
        }
    }
    for file in &content.files {
        line(&bytes(file.bytes), printable(&file.name).into_owned());
    }
    if content.left_out.is_empty() {
        return out;
    }
    let lost = &content.left_out;
    let columns =
        [("scan", column(lost, |l| l.scan.clone())), ("reason", column(lost, |l| l.reason.clone()))];
    out + "\n" + &drawn(&columns, width)
}

/// Keys with dots, and values, of nested objects.
fn flat(value: &Value) -> Vec<(String, String)> {
    match value {
        Value::Object(map) => map
            .iter()
            .flat_map(|(key, value)| {
                flat(value).into_iter().map(move |(rest, text)| {
                    let dot = if rest.is_empty() { "" } else { "." };
                    (format!("{}{dot}{rest}", printable(key)), text)
                })
            })
            .collect(),
        Value::String(text) => vec![(String::new(), printable(text).into_owned())],
        other => vec![(String::new(), printable(&other.to_string()).into_owned())],
    }
}

fn shown(finding: &Finding) -> String {
    let path = printable_path(&finding.path);
    finding.part.map_or(path.clone(), |part| format!("{path}#{}", part + 1))
}

fn yes(value: bool) -> String {
    if value { "yes" } else { "no" }.to_owned()
}

fn extent(bounds: Option<[[f32; 3]; 2]>) -> String {
    let side = |b: [[f32; 3]; 2], a: usize| length(f64::from(b[1][a] - b[0][a]));
    bounds.map(|b| [0, 1, 2].map(|a| side(b, a)).join(" × ")).unwrap_or_default()
}

fn triple<T: Copy + std::fmt::Display>(values: [T; 3]) -> String {
    values.map(|v| format!("{v:.3}")).join(" ")
}

fn bytes(count: u64) -> String {
    match count {
        0..1_000 => format!("{count} B"),
        1_000..1_000_000 => format!("{:.1} kB", count as f64 / 1e3),
        _ => format!("{:.1} MB", count as f64 / 1e6),
    }
}
