//! What `scanweave evaluate --truth` says of one result.

use super::terminal;
use scanweave::evaluation::placement::{CONFIDENT, PlacementReport};
use scanweave::evaluation::pose_error::PoseReport;
use scanweave::evaluation::recall::RecallReport;
use scanweave::evaluation::stated_error::{EXPECTED_MEAN, EXPECTED_MEDIAN, StatedErrorReport};
use serde::Serialize;
use std::collections::BTreeMap;

/// What is printed where nothing says from where on a pair is wrong.
const NO_LIMIT: &str = "not judged: the result has no report.json with its inlier radius; \
                        name the limit with --max-translation";

/// What is printed under `--json`.
#[derive(Debug, Serialize)]
pub struct Report {
    /// Names of the scans without a pose.
    pub declined: Vec<String>,
    /// Errors of the poses.
    pub poses: PoseReport,
    /// Null where no limit is known.
    pub judgement: Option<Judgement>,
    /// Recall by the folder of the benchmark.
    pub benchmarks: BTreeMap<String, RecallReport>,
}

/// What is right, and how far errors are those that the result states.
#[derive(Debug, Serialize)]
pub struct Judgement {
    /// The limit of translation errors is three inlier radii that the result states.
    pub radii_stated: bool,
    /// Right and wrong pairs and scans.
    #[serde(flatten)]
    pub placement: PlacementReport,
    /// Of the scans that are not wrongly placed.
    pub stated_error: StatedErrorReport,
}

/// Prints a report for people; `truth_deviation` is how far the worst true rotation was from orthonormal.
pub fn print(report: &Report, truth_deviation: f64) -> anyhow::Result<()> {
    let p = &report.poses;
    let components = if p.components == 1 { "component" } else { "components" };
    line("placed", &format!("{} of {} scans, {} {components}", p.placed, p.total, p.components))?;
    if !report.declined.is_empty() {
        line("declined", &report.declined.join(", "))?;
    }
    if truth_deviation > 1e-5 {
        line(
            "truth",
            &format!(
                "rotations up to {truth_deviation:.1e} from orthonormal, replaced by the nearest rotations"
            ),
        )?;
    }
    let s = &p.pair_summary;
    let figures = format!(
        "{} within components: rotation median {:.2}°, largest {:.2}°; translation median {}, largest {}, {}",
        p.pairs.len(),
        s.median_rotation_deg,
        s.max_rotation_deg,
        metres(s.median_translation_m),
        metres(s.max_translation_m),
        measured_at(p)
    );
    line("pairs", &figures)?;
    match &report.judgement {
        Some(judgement) => print_judgement(judgement)?,
        None => line("pairs right", NO_LIMIT)?,
    }
    for (folder, r) in &report.benchmarks {
        let share =
            |v: Option<f64>| v.map_or("no counted pair".to_owned(), |v| format!("{:.1} %", 100.0 * v));
        let figures = format!(
            "{} within all components ({} of {} pairs, {} without an estimate, {} without information), \
             {} in the largest component alone  {folder}",
            share(r.recall()),
            r.succeeded,
            r.counted,
            r.declined.len(),
            r.zero_information,
            share(r.recall_in_largest())
        );
        line("recall", &figures)?;
    }
    Ok(())
}

/// Where the translation errors of pairs were measured.
fn measured_at(poses: &PoseReport) -> String {
    match poses.pairs_at_centre {
        n if n == poses.pairs.len() => "at the source scan's centre".to_owned(),
        0 => "at the zero of the source scan's file".to_owned(),
        n => format!("{n} at the source scan's centre, the others at the zero of its file"),
    }
}

fn print_judgement(judgement: &Judgement) -> anyhow::Result<()> {
    let (p, stated) = (&judgement.placement, &judgement.stated_error);
    let radii = if judgement.radii_stated { " (three inlier radii)" } else { "" };
    let within = p.limits.within_m.map_or(String::new(), |limit| {
        format!("; only pairs whose true centres lie within {} are judged", metres(limit))
    });
    let (translation, rotation) = (metres(p.limits.max_translation_m), p.limits.max_rotation_deg);
    line("limits", &format!("{translation}{radii} and {rotation}°{within}"))?;
    let share = p.right_share().map_or("no judged pair".to_owned(), |v| format!("{:.1} %", 100.0 * v));
    line(
        "pairs right",
        &format!(
            "{} of {} ({share}), {} wrong within components",
            p.right_pairs, p.judged_pairs, p.wrong_pairs
        ),
    )?;
    line(
        "wrongly placed",
        &format!(
            "{} of {} placed, {} of them stated above {CONFIDENT}",
            p.wrongly_placed.len(),
            p.placed,
            p.confidently_wrong
        ),
    )?;
    let (Some(median), Some(mean), Some(below)) = (stated.median, stated.mean, stated.below_quantile_95)
    else {
        let none = "not compared: no scan that is not wrongly placed states its centre and a covariance that has \
                    an inverse";
        return line("stated error", none);
    };
    let singular = match stated.singular {
        0 => String::new(),
        n => format!("; {n} more whose covariance has no inverse"),
    };
    line(
        "stated error",
        &format!(
            "NEES median {median:.2}, mean {mean:.2} over {} scans (expected {EXPECTED_MEDIAN:.2} and \
             {EXPECTED_MEAN}), {:.1} % below the 95 % quantile; pivots and wrongly placed scans left out{singular}",
            stated.scans.len(),
            100.0 * below
        ),
    )
}

fn line(label: &str, text: &str) -> anyhow::Result<()> {
    Ok(terminal::print_line(&format!("{label:<14}  {text}"))?)
}

fn metres(value: f64) -> String {
    if value < 0.01 { format!("{:.2} mm", 1000.0 * value) } else { format!("{value:.3} m") }
}
