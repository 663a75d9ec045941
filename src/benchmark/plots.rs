//! The pictures of a suite.

use super::cell::Cell;
use super::suite::Suite;
use super::table::{RecallRow, Table};
use crate::evaluation::pose_error::PoseError;
use crate::evaluation::protocol::Protocol;
use crate::report::chart::{Panel, Series};
use std::collections::BTreeSet;

/// Width of a bin of true overlap.
const BIN: f64 = 0.1;
/// Points along a distribution curve.
const STEPS: usize = 100;

/// File names and panels of all pictures that the cells have figures for.
pub(super) fn all(suite: &Suite, table: &Table, cells: &[Cell]) -> Vec<(String, Vec<Panel>)> {
    let mut all = vec![
        ("recall_by_keypoints.svg".to_owned(), by_keypoints(table)),
        ("cost.svg".to_owned(), cost(suite, cells)),
    ];
    for &keypoints in &suite.keypoints {
        let here: Vec<&Cell> = cells.iter().filter(|c| c.key.keypoints == keypoints).collect();
        all.push((format!("recall_by_overlap_{keypoints}.svg"), by_overlap(suite, &here)));
        all.push((format!("errors_{keypoints}.svg"), distributions(suite, &here)));
        all.push((format!("reliability_{keypoints}.svg"), reliability(table, keypoints)));
    }
    all.retain(|(_, panels)| panels.iter().any(|p| p.series.iter().any(|s| !s.points.is_empty())));
    all
}

/// Recall against the number of keypoints, a panel for every benchmark.
fn by_keypoints(table: &Table) -> Vec<Panel> {
    let mut counts: Vec<usize> = table.recalls.iter().map(|r| r.keypoints).collect();
    counts.sort_unstable();
    counts.dedup();
    let place = |k: usize| counts.iter().position(|&c| c == k).unwrap_or(0) as f64;
    let names: BTreeSet<(&String, &String)> =
        table.recalls.iter().map(|r| (&r.dataset, &r.benchmark)).collect();
    let panel = |(dataset, benchmark): (&String, &String)| {
        let rows: Vec<&RecallRow> =
            table.recalls.iter().filter(|r| r.dataset == *dataset && r.benchmark == *benchmark).collect();
        let mut methods: Vec<(String, &String)> = Vec::new();
        for row in &rows {
            let name =
                row.quoted.as_ref().map_or(row.method.clone(), |s| format!("{} (quoted, {s})", row.method));
            if !methods.iter().any(|m| m.0 == name) {
                methods.push((name, &row.method));
            }
        }
        let series = methods.into_iter().map(|(name, method)| {
            let quoted = name != *method;
            let mut points: Vec<(f64, f64, f64, f64)> = rows
                .iter()
                .filter(|r| r.method == *method && r.quoted.is_some() == quoted)
                .filter_map(|r| {
                    let s = r.recall.as_ref()?;
                    Some((place(r.keypoints), 100.0 * s.mean, 100.0 * s.low, 100.0 * s.high))
                })
                .collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            Series {
                name,
                points: points.iter().map(|p| (p.0, p.1)).collect(),
                line: true,
                spread: points.iter().map(|p| (p.2, p.3)).collect(),
            }
        });
        Panel {
            title: benchmark.clone(),
            x_label: "keypoints a scan".to_owned(),
            y_label: "registration recall, %".to_owned(),
            x_names: counts.iter().map(usize::to_string).collect(),
            series: series.collect(),
            y_most: 100.0,
        }
    };
    names.into_iter().map(panel).collect()
}

/// Share of right scans against their stated probability, a panel for every data set; the diagonal
/// is where both agree.
fn reliability(table: &Table, keypoints: usize) -> Vec<Panel> {
    let rows = || table.trust.iter().filter(|t| t.keypoints == keypoints);
    let names: BTreeSet<&String> = rows().map(|t| &t.dataset).collect();
    let panel = |dataset: &String| {
        let of_method = rows().filter(|t| t.dataset == *dataset).map(|t| Series {
            name: t.method.clone(),
            points: t
                .reliability
                .bins
                .iter()
                .filter(|b| b.scans > 0)
                .map(|b| (100.0 * b.stated, 100.0 * b.right))
                .collect(),
            line: true,
            spread: Vec::new(),
        });
        let agreement = Series {
            name: "as stated".to_owned(),
            points: vec![(0.0, 0.0), (100.0, 100.0)],
            line: true,
            spread: Vec::new(),
        };
        Panel {
            title: format!("placed scans: {dataset}"),
            x_label: "stated probability, %".to_owned(),
            y_label: "right, %".to_owned(),
            x_names: Vec::new(),
            series: of_method.chain([agreement]).collect(),
            y_most: 100.0,
        }
    };
    names.into_iter().map(panel).collect()
}

/// Recall of the pairs in bins of true overlap, all scenes, seeds and benchmarks together.
fn by_overlap(suite: &Suite, cells: &[&Cell]) -> Vec<Panel> {
    let series = suite.methods.iter().map(|method| {
        let mut bins = vec![(0usize, 0usize); (1.0 / BIN).round() as usize];
        for cell in cells.iter().filter(|c| c.key.method == method.name) {
            for (name, report) in &cell.report.recalls {
                let overlaps = cell.pair_overlaps.get(name).into_iter().flatten();
                for (pair, overlap) in report.pairs.iter().zip(overlaps) {
                    let Some(overlap) = overlap else { continue };
                    let bin = ((f64::from(*overlap) / BIN) as usize).min(bins.len() - 1);
                    bins[bin].0 += 1;
                    bins[bin].1 += usize::from(pair.success);
                }
            }
        }
        let centre = |at: usize| (at as f64 + 0.5) * BIN;
        let points = bins.iter().enumerate().filter(|(_, b)| b.0 > 0);
        Series {
            name: method.name.clone(),
            points: points.map(|(at, b)| (centre(at), 100.0 * b.1 as f64 / b.0 as f64)).collect(),
            line: true,
            spread: Vec::new(),
        }
    });
    vec![Panel {
        title: "recall by true overlap of the pair".to_owned(),
        x_label: "true overlap".to_owned(),
        y_label: "registered pairs, %".to_owned(),
        x_names: Vec::new(),
        series: series.collect(),
        y_most: 100.0,
    }]
}

/// Distributions of rotation and translation errors on data sets with the ScanNet protocol:
/// averaged over cells, as the tables average over scenes.
fn distributions(suite: &Suite, cells: &[&Cell]) -> Vec<Panel> {
    let judged = |c: &&&Cell| c.benchmarks.values().any(|p| *p == Protocol::Scannet);
    let curves = |of: fn(&PoseError) -> f64, most: f64| -> Vec<Series> {
        let curve = |name: &String| {
            let own: Vec<&Cell> =
                cells.iter().filter(judged).filter(|c| c.key.method == *name).copied().collect();
            let share = |limit: f64| {
                let of_cell = |c: &&Cell| {
                    let errors = &c.report.pairs;
                    let within = errors.iter().filter(|p| p.error.is_some_and(|e| of(&e) <= limit)).count();
                    within as f64 / errors.len().max(1) as f64
                };
                own.iter().map(of_cell).sum::<f64>() / own.len() as f64
            };
            let points = (0..=STEPS).map(|k| k as f64 / STEPS as f64 * most);
            let points = points.map(|x| (x, 100.0 * share(x)));
            Series {
                name: name.clone(),
                points: if own.is_empty() { Vec::new() } else { points.collect() },
                line: true,
                spread: Vec::new(),
            }
        };
        suite.methods.iter().map(|m| curve(&m.name)).collect()
    };
    let panel = |title: &str, x_label: &str, series: Vec<Series>| Panel {
        title: title.to_owned(),
        x_label: x_label.to_owned(),
        y_label: "pairs within, %".to_owned(),
        x_names: Vec::new(),
        series,
        y_most: 100.0,
    };
    vec![
        panel("rotation error", "degrees", curves(|e| e.rotation_deg, 45.0)),
        panel("translation error", "metres", curves(|e| e.translation_m, 0.75)),
    ]
}

/// Time and memory of every cell against the scans of its scene.
fn cost(suite: &Suite, cells: &[Cell]) -> Vec<Panel> {
    let panel = |title: &str, y_label: &str, of: &dyn Fn(&Cell) -> Option<f64>| {
        let series = suite.methods.iter().map(|method| {
            let own = cells.iter().filter(|c| c.key.method == method.name);
            Series {
                name: method.name.clone(),
                points: own.filter_map(|c| Some((c.report.scans as f64, of(c)?))).collect(),
                line: false,
                spread: Vec::new(),
            }
        });
        Panel {
            title: title.to_owned(),
            x_label: "scans of the scene".to_owned(),
            y_label: y_label.to_owned(),
            x_names: Vec::new(),
            series: series.collect(),
            y_most: 0.0,
        }
    };
    vec![
        panel("time from features to poses", "seconds", &|c| Some(c.seconds())),
        panel("peak memory", "MB", &|c| c.peak_memory_bytes.map(|b| b as f64 / 1e6)),
    ]
}
