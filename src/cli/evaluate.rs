//! `scanweave evaluate`.

use super::evaluate_page::{self, OneResult, Wanted};
use super::evaluate_text::{Judgement, Report, print};
use super::{Status, Verbosity, evaluate_set, terminal};
use anyhow::Context;
use clap::Args;
use scanweave::Error;
use scanweave::evaluation::placement::{Limits, PlacementReport};
use scanweave::evaluation::pose_error::{PoseReport, evaluate_against_truth};
use scanweave::evaluation::protocol::Protocol;
use scanweave::evaluation::recall::RecallConfig;
use scanweave::evaluation::stated_error::StatedErrorReport;
use scanweave::evaluation::truth::{Truth, benchmark_recall};
use scanweave::result::RunReport;
use scanweave::result_folder::load_poses;
use scanweave::scan::Reconstruction;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Inlier radii up to which a pair is right by default.
const RADII: f64 = 3.0;

/// Compare registrations with true poses.
///
/// One result (--truth): prints the errors of the relative poses of all pairs of placed scans, measured
/// at the source scan's centre where poses.json states it, else at the zero of its file. A pair is
/// right within --max-translation and --max-rotation; "pairs right" counts those of all pairs of the
/// truth, also pairs with declined scans or scans of different components. A scan is wrongly placed
/// when most of its judged pairs within its component are wrong. "stated error" compares the true
/// errors of the other scans relative to their pivots with the covariances of poses.json: NEES, the
/// normalized estimation error squared, is 1 on average where covariances are true.
///
/// Prints for every benchmark folder (gt.log and gt.info, as 3DMatch and 3DLoMatch have them) the
/// registration recall twice: within all components, where a pair counts when both scans are in one
/// component, and in the largest component alone, where only pairs of that one count. A pair with a
/// declined scan counts as a failure in both. Poses of other methods are one component.
///
/// A data set (--dataset): RESULT holds one result a scene, <scene>/poses.json of `register`, or
/// poses of any other method as <scene>/trajectory.log, <scene>/poses.txt or
/// <scene>/trajectory.tum (or <scene>.log, .txt, .tum). Prints the figures of every protocol for
/// each scene, their mean, and all pairs pooled.
///
/// With --report writes all that, and why pairs failed, into an HTML page.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Output folder of `register`, or a folder with one result a scene.
    #[arg(value_name = "RESULT")]
    result: PathBuf,
    /// Folder of the scans with their true poses: truth.json, <scan>.info.txt or .pose.txt beside each
    /// scan, poses/pose<i>.txt, poses.txt, or one Stanford .conf.
    #[arg(long, value_name = "SCENE", required_unless_present = "dataset")]
    truth: Option<PathBuf>,
    /// Folder of scenes, with benchmarks/<NAME>/<scene>/gt.log in it or beside it, or gt.log beside
    /// the scans.
    #[arg(long, value_name = "DIR", conflicts_with = "truth")]
    dataset: Option<PathBuf>,
    /// Scene of the data set to evaluate; may be repeated. Default: all.
    #[arg(long = "scene", value_name = "NAME", requires = "dataset")]
    scenes: Vec<String>,
    /// How to judge a data set: 3dmatch, 3dlomatch, eth, scannet; may be repeated.
    #[arg(long = "protocol", value_name = "NAME", requires = "dataset", default_value = "3dmatch",
          value_parser = |name: &str| Protocol::parse(name).map_err(|e| e.to_string()))]
    protocols: Vec<Protocol>,
    /// Folder with gt.log and gt.info; may be repeated. With --dataset: one folder with
    /// <scene>/gt.log.
    #[arg(long = "benchmark", value_name = "DIR")]
    benchmarks: Vec<PathBuf>,
    /// Largest error of a registered pair, metres: 0.2 for 3DMatch, 0.5 for ETH.
    #[arg(long, value_name = "M", default_value_t = RecallConfig::default().threshold_m, conflicts_with = "dataset")]
    threshold: f64,
    /// Largest translation error of a right pair, in the unit of the files. Default: three inlier radii
    /// of the result, from its report.json.
    #[arg(long, value_name = "M", conflicts_with = "dataset")]
    max_translation: Option<f64>,
    /// Largest rotation error of a right pair, degrees.
    #[arg(long, value_name = "DEG", default_value_t = 5.0, conflicts_with = "dataset")]
    max_rotation: f64,
    /// Judge only pairs whose true centres lie within this distance of each other. A declined scan's
    /// centre is read from its file.
    #[arg(long, value_name = "M", conflicts_with = "dataset")]
    within: Option<f64>,
    /// Leave out the first counted pair of a scene, as a published evaluator does by mistake.
    #[arg(long)]
    reference_quirks: bool,
    /// Also write an HTML page: recall, errors, and which scan went wrong first. One HTML file
    /// for any browser, without a network.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Distance within which points count as common where that page judges overlap, metres.
    #[arg(long, value_name = "M", default_value_t = 0.07, requires = "report")]
    overlap_radius: f64,
    /// Print one JSON document instead of text.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    fn wanted(&self) -> Option<Wanted<'_>> {
        let overlap_radius_m = self.overlap_radius;
        self.report.as_deref().map(|file| Wanted { file, overlap_radius_m })
    }
}

pub fn run(arguments: Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    match (&arguments.dataset, &arguments.truth) {
        (Some(dataset), _) => {
            if arguments.benchmarks.len() > 1 {
                let expected = "at most one with --dataset";
                let found = arguments.benchmarks.len().to_string();
                return Err(Error::setting("--benchmark", found, expected, "name one folder").into());
            }
            let job = evaluate_set::Job {
                results: &arguments.result,
                dataset,
                scenes: &arguments.scenes,
                protocols: &arguments.protocols,
                benchmark: arguments.benchmarks.first().map(PathBuf::as_path),
                reference_quirks: arguments.reference_quirks,
                page: arguments.wanted(),
            };
            evaluate_set::run(&job, arguments.json, verbosity)?;
        }
        (None, Some(truth)) => one(&arguments, truth, verbosity)?,
        // Ruled out by the arguments' own rules.
        (None, None) => {}
    }
    if let Some(file) = arguments.report.as_ref().filter(|_| !verbosity.quiet && !arguments.json) {
        terminal::print_line(&format!("written    {}", file.display()))?;
    }
    Ok(Status::Success)
}

fn one(arguments: &Arguments, truth_folder: &Path, verbosity: &Verbosity) -> anyhow::Result<()> {
    let document = load_poses(&arguments.result)?;
    let reconstruction = document.reconstruction()?;
    let truth = Truth::read(&document, truth_folder)?;
    let poses = evaluate_against_truth(&reconstruction, &truth.world_from_scan)?;
    let judgement = judge(arguments, &reconstruction, &poses, &truth)?;
    let config = RecallConfig {
        threshold_m: arguments.threshold,
        reference_quirks: arguments.reference_quirks,
        ..RecallConfig::default()
    };
    let mut benchmarks = BTreeMap::new();
    for folder in &arguments.benchmarks {
        let report = benchmark_recall(folder, &document, &reconstruction, &config)?;
        benchmarks.insert(folder.display().to_string(), report);
    }
    let declined = document.scans.iter().zip(&reconstruction.outcomes);
    let declined = declined.filter(|d| d.1.placement().is_none()).map(|d| d.0.name.clone()).collect();
    let report = Report { declined, poses, judgement, benchmarks };
    if let Some(wanted) = arguments.wanted() {
        let result = OneResult {
            document: &document,
            poses: &report.poses,
            truth_deviation: truth.deviation,
            recalls: &report.benchmarks,
            limit_m: arguments.threshold,
        };
        evaluate_page::write(&wanted, evaluate_page::of_result(&wanted, truth_folder, &result)?)?;
    }
    if arguments.json {
        terminal::print_json(&(serde_json::to_string_pretty(&report).context("writing the report")? + "\n"))?;
    } else if !verbosity.quiet {
        print(&report, truth.deviation)?;
    }
    Ok(())
}

/// Judges pairs and scans; `None` where neither an option nor the result tells from where on a pair is wrong.
fn judge(
    arguments: &Arguments,
    reconstruction: &Reconstruction,
    poses: &PoseReport,
    truth: &Truth,
) -> Result<Option<Judgement>, Error> {
    let run = arguments.result.join("report.json");
    let options = [
        ("--max-translation", arguments.max_translation),
        ("--max-rotation", Some(arguments.max_rotation)),
        ("--within", arguments.within),
    ];
    for (option, value) in options {
        if let Some(value) = value.filter(|v| !(*v > 0.0 && v.is_finite())) {
            return Err(Error::setting(option, value.to_string(), "a positive number", "name another limit"));
        }
    }
    let max_translation_m = match arguments.max_translation {
        Some(limit) => limit,
        None if run.exists() => RADII * RunReport::load(&run)?.scale.inlier_radius_m,
        None => return Ok(None),
    };
    let limits =
        Limits { max_translation_m, max_rotation_deg: arguments.max_rotation, within_m: arguments.within };
    let centres = match limits.within_m {
        Some(_) => truth.centres(reconstruction)?,
        None => Vec::new(),
    };
    let placement = PlacementReport::new(reconstruction, poses, &centres, limits);
    let stated_error =
        StatedErrorReport::new(reconstruction, &truth.world_from_scan, |scan| placement.is_wrong(scan));
    Ok(Some(Judgement { radii_stated: arguments.max_translation.is_none(), placement, stated_error }))
}
