//! The page of `scanweave evaluate`.

use super::{Block, Section, Sheet};
use crate::Result;
use crate::evaluation::dataset::SceneReport;
use crate::evaluation::diagnosis::Diagnosis;
use crate::evaluation::pose_error::{
    PoseError, PoseReport, ROTATION_THRESHOLDS_DEG, ScanError, TRANSLATION_THRESHOLDS_M,
};
use crate::evaluation::recall::RecallSummary;
use crate::report::chart::{Panel, Series};
use crate::report::grid::{Grid, heads};
use crate::report::growth_tree;
use std::collections::BTreeMap;

/// Points along a distribution curve.
const STEPS: usize = 200;
/// A plot goes on to the round number within which this share of the known errors lies, but not
/// beyond the greatest limit of the ScanNet protocol.
const SHOWN: f64 = 0.97;
/// Longer lists of failed pairs are folded.
const MOST_PAIRS: usize = 12;

/// One scene of an evaluation.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneSheet {
    /// Its figures.
    pub report: SceneReport,
    /// Names of the scans, in order.
    pub names: Vec<String>,
    /// Errors of the poses, where the true ones are known.
    pub poses: Option<PoseReport>,
    /// Why pairs failed; otherwise why that is not known, as a sentence.
    pub diagnosis: std::result::Result<Diagnosis, String>,
}

/// Everything that a page of an evaluation shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// Every scene.
    pub scenes: Vec<SceneSheet>,
    /// Recall over the scenes, by benchmark.
    pub recalls: BTreeMap<String, RecallSummary>,
}

/// The page of an evaluation.
///
/// # Errors
/// A plot that cannot be laid out.
pub fn evaluation(all: &Evaluation) -> Result<Sheet> {
    let mut sections = vec![summary(all), scenes(all)];
    sections.extend(errors(all)?);
    sections.extend(all.scenes.iter().map(scene));
    let unknown: Vec<&str> =
        all.scenes.iter().filter(|s| s.poses.is_none()).map(|s| s.report.scene.as_str()).collect();
    let note = match unknown.is_empty() {
        true => String::new(),
        false => format!("The true poses of {} are not known: no errors of poses.", unknown.join(", ")),
    };
    Ok(Sheet { brand: "Scanweave evaluation".to_owned(), headline: headline(all), note, sections })
}

fn percent(value: Option<f64>) -> String {
    value.map_or("\u{2013}".to_owned(), |v| format!("{:.1}", 100.0 * v))
}

fn counted(n: usize, one: &str) -> String {
    format!("{n} {one}{}", if n == 1 { "" } else { "s" })
}

fn headline(all: &Evaluation) -> String {
    let recalls: Vec<String> = all
        .recalls
        .iter()
        .filter_map(|(name, r)| Some(format!("{:.1} % on {name}", 100.0 * r.mean_of_scenes?)))
        .collect();
    let sum = |of: fn(&SceneReport) -> usize| all.scenes.iter().map(|s| of(&s.report)).sum::<usize>();
    let placed = format!("{} of {} placed", sum(|r| r.placed), counted(sum(|r| r.scans), "scan"));
    match recalls.is_empty() {
        true => format!("{placed}."),
        false => format!("Registration recall {}; {placed}.", recalls.join(", ")),
    }
}

fn summary(all: &Evaluation) -> Section {
    let mut figures = Vec::new();
    for (name, recall) in &all.recalls {
        let (scenes, pooled) = (counted(recall.scenes, "scene"), percent(recall.pooled));
        figures.push((
            format!("{} %", percent(recall.mean_of_scenes)),
            format!("{name}, within all components: mean of {scenes}; all pairs pooled {pooled} %"),
        ));
        figures.push((
            format!("{} %", percent(recall.mean_of_scenes_in_largest)),
            format!(
                "{name}, in the largest component alone: mean of {scenes}; all pairs pooled {} %",
                percent(recall.pooled_in_largest)
            ),
        ));
    }
    let judged: Vec<PoseError> = all.scenes.iter().flat_map(scan_errors).collect();
    let middle = crate::evaluation::pose_error::ErrorSummary::new(&judged);
    if !judged.is_empty() {
        figures.push((length(middle.median_translation_m), "median error of a scan's position".to_owned()));
        figures.push((format!("{:.2}°", middle.median_rotation_deg), "and of its direction".to_owned()));
    }
    let text = "A pair of scans is registered when the error of its relative pose is within the limit of \
                the benchmark. A pair with a scan that was left out counts as failed, and so does one whose \
                scans are in different components. In the largest component alone, pairs of smaller \
                components count as failed too.";
    Section { title: "Figures".to_owned(), text: text.to_owned(), blocks: vec![Block::Figures(figures)] }
}

/// A length with the unit that suits it.
fn length(m: f64) -> String {
    match m {
        m if m >= 1.0 => format!("{m:.2} m"),
        m if m >= 0.01 => format!("{:.1} cm", 100.0 * m),
        m => format!("{:.2} mm", 1000.0 * m),
    }
}

fn scan_errors(scene: &SceneSheet) -> impl Iterator<Item = PoseError> + '_ {
    scene.poses.iter().flat_map(|p| p.scans.iter().map(|s| s.error))
}

fn scenes(all: &Evaluation) -> Section {
    let mut head = heads(&["scene", "scans", "placed"]);
    for name in all.recalls.keys() {
        head.extend([format!("{name} %"), format!("{name} largest %")]);
        head.extend(heads(&["registered", "in largest", "counted"]));
    }
    head.extend(heads(&["models", "median °", "median m", "most °", "most m"]));
    let row = |s: &SceneSheet| {
        let r = &s.report;
        let mut row = vec![r.scene.clone(), r.scans.to_string(), r.placed.to_string()];
        for name in all.recalls.keys() {
            let recall = r.recalls.get(name);
            row.push(percent(recall.and_then(|r| r.recall())));
            row.push(percent(recall.and_then(|r| r.recall_in_largest())));
            let in_largest = recall.and_then(|r| r.succeeded_in_largest);
            row.extend([recall.map(|r| r.succeeded), in_largest, recall.map(|r| r.counted)].map(count));
        }
        let poses = s.poses.as_ref();
        row.push(count(poses.map(|p| p.components)));
        let of = |f: fn(&PoseReport) -> f64, digits: usize| {
            poses.filter(|p| !p.scans.is_empty()).map_or(String::new(), |p| format!("{:.digits$}", f(p)))
        };
        row.extend([
            of(|p| p.scan_summary.median_rotation_deg, 2),
            of(|p| p.scan_summary.median_translation_m, 4),
            of(|p| p.scan_summary.max_rotation_deg, 2),
            of(|p| p.scan_summary.max_translation_m, 4),
        ]);
        row
    };
    let text = "Recall is that within all components; \"largest\" is that in the largest component alone. Errors \
                are those of the scans, each in a frame fitted to its model.";
    Section {
        title: "Scenes".to_owned(),
        text: text.to_owned(),
        blocks: vec![Block::Grid(Grid::new(head, 1, all.scenes.iter().map(row).collect()))],
    }
}

fn count(value: Option<usize>) -> String {
    value.map(|v| v.to_string()).unwrap_or_default()
}

/// Distributions of the errors of scans and of pairs, where any pose is judged.
fn errors(all: &Evaluation) -> Result<Option<Section>> {
    let judged = || all.scenes.iter().filter_map(|s| s.poses.as_ref());
    let scans: Vec<PoseError> = judged().flat_map(|p| p.scans.iter().map(|s| s.error)).collect();
    let pairs: Vec<PoseError> = judged().flat_map(|p| p.pairs.iter().filter_map(|e| e.error)).collect();
    if scans.is_empty() {
        return Ok(None);
    }
    let all_scans: usize = judged().map(|p| p.total).sum();
    let all_pairs: usize = judged().map(|p| p.total * p.total.saturating_sub(1) / 2).sum();
    let panel = |title: &str, unit: &str, greatest: f64, of: fn(&PoseError) -> f64| {
        let values =
            |errors: &[PoseError]| -> Vec<f64> { errors.iter().map(of).filter(|v| v.is_finite()).collect() };
        let (scans, pairs) = (values(&scans), values(&pairs));
        let fits =
            |limit: f64| [&scans, &pairs].into_iter().all(|v| within(v, limit) >= SHOWN * v.len() as f64);
        let round = (-3..3).flat_map(|power| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(power)));
        let most = round.take_while(|&l| l < greatest).find(|&l| fits(l)).unwrap_or(greatest);
        let curve = |name: &str, values: &[f64], total: usize| Series {
            name: name.to_owned(),
            points: (0..=STEPS)
                .map(|k| most * k as f64 / STEPS as f64)
                .map(|x| (x, 100.0 * within(values, x) / total.max(1) as f64))
                .collect(),
            line: true,
            spread: Vec::new(),
        };
        Panel {
            title: title.to_owned(),
            x_label: unit.to_owned(),
            y_label: "within, %".to_owned(),
            x_names: Vec::new(),
            series: vec![curve("scans", &scans, all_scans), curve("pairs of scans", &pairs, all_pairs)],
            y_most: 100.0,
        }
    };
    let panels = [
        panel("rotation error", "degrees", ROTATION_THRESHOLDS_DEG[4], |e| e.rotation_deg),
        panel("translation error", "metres", TRANSLATION_THRESHOLDS_M[4], |e| e.translation_m),
    ];
    let caption = format!(
        "Share of {} (each in a frame fitted to its model) and of {} whose error is at most that far; those \
         without an estimate never are. Translation errors are measured at the zero of a scan's file{}.",
        counted(all_scans, "scan"),
        counted(all_pairs, "pair"),
        match judged().map(|p| p.pairs_at_centre).sum::<usize>() {
            0 => "",
            n if n == pairs.len() => ", those of pairs at the source scan's centre",
            _ => ", those of pairs at the source scan's centre where it is known",
        }
    );
    let blocks = vec![Block::chart(&panels, caption)?];
    Ok(Some(Section { title: "Errors of the poses".to_owned(), text: String::new(), blocks }))
}

fn within(values: &[f64], limit: f64) -> f64 {
    values.iter().filter(|&&v| v <= limit).count() as f64
}

fn scene(scene: &SceneSheet) -> Section {
    let mut blocks = Vec::new();
    match &scene.diagnosis {
        Ok(found) if found.pairs.is_empty() => blocks.push(Block::Text("No pair failed.".to_owned())),
        Ok(found) => {
            let causes: Vec<String> = found
                .counts()
                .into_iter()
                .map(|(cause, all, carried)| match carried {
                    0 => format!("{} {all}", cause.name()),
                    _ => format!("{} {all} ({carried} carried along by a third scan)", cause.name()),
                })
                .collect();
            let (failed, limit) = (counted(found.pairs.len(), "failed pair"), found.limit_m);
            blocks.push(Block::Text(format!(
                "{failed}: {}. Errors beyond {limit} m are wrong. What went wrong first, and what speaks for it:",
                causes.join(", ")
            )));
            blocks.push(Block::Grid(found.origins()));
            blocks.push(pairs(found.failed_pairs()));
        }
        Err(why) => {
            blocks.push(Block::Text(why.clone()));
            let failed = failed_pairs(scene);
            if !failed.rows.is_empty() {
                blocks.push(pairs(failed));
            }
        }
    }
    if let Ok(found) = &scene.diagnosis {
        blocks.push(Block::Picture(
            growth_tree::svg(found),
            "How the model grew, and where it went wrong".to_owned(),
        ));
    }
    blocks.push(Block::Folded(format!("Every scan of {}", scene.report.scene), scans(scene)));
    Section { title: scene.report.scene.clone(), text: String::new(), blocks }
}

fn pairs(grid: Grid) -> Block {
    match grid.rows.len() {
        n if n > MOST_PAIRS => Block::Folded(format!("All {n} failed pairs"), grid),
        _ => Block::Grid(grid),
    }
}

/// Failed pairs where nothing is known but that they failed.
fn failed_pairs(scene: &SceneSheet) -> Grid {
    let of = |(name, recall): (&String, &crate::evaluation::recall::RecallReport)| -> Vec<Vec<String>> {
        let failed = recall.pairs.iter().filter(|p| !p.success);
        failed
            .map(|p| {
                let rmse = p.rmse_m.map_or("no estimate".to_owned(), |e| format!("{e:.3}"));
                vec![name.clone(), p.i.to_string(), p.j.to_string(), rmse]
            })
            .collect()
    };
    Grid::new(
        heads(&["benchmark", "i", "j", "rmse m"]),
        1,
        scene.report.recalls.iter().flat_map(of).collect(),
    )
}

/// Outcome, cause of failure and error of every scan.
fn scans(scene: &SceneSheet) -> Grid {
    let head = heads(&[
        "scan",
        "outcome",
        "cause",
        "step",
        "error °",
        "error m",
        "matches",
        "inliers",
        "probability",
    ]);
    let declined: BTreeMap<&str, &str> =
        scene.report.declined.iter().map(|d| (d.scan.as_str(), d.reason.as_str())).collect();
    let errors: BTreeMap<usize, &ScanError> =
        scene.poses.iter().flat_map(|p| p.scans.iter().map(|s| (s.scan.0, s))).collect();
    let row = |(i, name): (usize, &String)| {
        let found = scene.diagnosis.as_ref().ok().and_then(|d| d.scans.get(i));
        let error = errors.get(&i);
        let outcome = match (declined.get(name.as_str()), error) {
            (Some(reason), _) => format!("left out: {reason}"),
            (None, Some(e)) if e.component > 0 => format!("placed in model {}", e.component + 1),
            _ => "placed".to_owned(),
        };
        let cause =
            found.filter(|f| f.component.is_some()).map_or(String::new(), |f| match (f.cause, f.origin) {
                (Some(cause), _) => cause.name().to_owned(),
                (None, Some(origin)) => {
                    format!("carried along by {}", scene.names.get(origin).map_or("", String::as_str))
                }
                (None, None) => "right".to_owned(),
            });
        let placed = found.filter(|f| f.component.is_some());
        vec![
            name.clone(),
            outcome,
            cause,
            count(placed.and_then(|f| f.step)),
            error.map_or(String::new(), |e| format!("{:.3}", e.error.rotation_deg)),
            error.map_or(String::new(), |e| format!("{:.4}", e.error.translation_m)),
            count(placed.filter(|f| f.parent.is_some()).map(|f| f.matches)),
            count(placed.filter(|f| f.parent.is_some()).map(|f| f.inliers)),
            placed.and_then(|f| f.probability).map_or(String::new(), |p| format!("{p:.2}")),
        ]
    };
    Grid::new(head, 3, scene.names.iter().enumerate().map(row).collect())
}
