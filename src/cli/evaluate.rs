//! `scanweave evaluate`.

use super::evaluate_page::{self, OneResult, Wanted};
use super::{Status, Verbosity, evaluate_set, terminal};
use anyhow::Context;
use clap::Args;
use scanweave::evaluation::pose_error::{PoseReport, evaluate_against_truth};
use scanweave::evaluation::protocol::Protocol;
use scanweave::evaluation::recall::{RecallConfig, RecallReport, registration_recall};
use scanweave::geometry::RigidMotion;
use scanweave::result::poses::Document;
use scanweave::scan::{Reconstruction, ScanId};
use scanweave::{Error, io};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Compare registrations with true poses.
///
/// One result (--truth): prints the errors of the relative poses of all pairs of placed scans, and
/// for every benchmark folder (gt.log and gt.info, as 3DMatch and 3DLoMatch have them) the
/// registration recall. A pair with a declined scan counts as a failure.
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

/// What is printed under `--json`.
#[derive(Debug, Serialize)]
struct Report {
    declined: Vec<String>,
    poses: PoseReport,
    benchmarks: BTreeMap<String, RecallReport>,
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
    let document = Document::load(&arguments.result.join("poses.json"))?;
    let reconstruction = document.reconstruction()?;
    let (poses, deviation) = against_truth(&document, &reconstruction, truth_folder)?;
    let config = RecallConfig {
        threshold_m: arguments.threshold,
        reference_quirks: arguments.reference_quirks,
        ..RecallConfig::default()
    };
    let mut benchmarks = BTreeMap::new();
    for folder in &arguments.benchmarks {
        let report = recall(folder, &document, &reconstruction, &config)?;
        benchmarks.insert(folder.display().to_string(), report);
    }
    let declined = document.scans.iter().zip(&reconstruction.outcomes);
    let declined = declined.filter(|d| d.1.placement().is_none()).map(|d| d.0.name.clone()).collect();
    let report = Report { declined, poses, benchmarks };
    if let Some(wanted) = arguments.wanted() {
        let result = OneResult {
            document: &document,
            poses: &report.poses,
            truth_deviation: deviation,
            recalls: &report.benchmarks,
            limit_m: arguments.threshold,
        };
        evaluate_page::write(&wanted, evaluate_page::of_result(&wanted, truth_folder, &result)?)?;
    }
    if arguments.json {
        terminal::print(&(serde_json::to_string_pretty(&report).context("writing the report")? + "\n"))?;
    } else if !verbosity.quiet {
        print(&report, deviation)?;
    }
    Ok(())
}

/// The errors of a result against the true poses in `truth_folder`, and how far the worst rotation
/// there was from orthonormal.
pub fn against_truth(
    document: &Document,
    reconstruction: &Reconstruction,
    truth_folder: &Path,
) -> Result<(PoseReport, f64), Error> {
    let scene = io::dataset::read_scene(truth_folder)?;
    let by_stem = true_poses(&scene, truth_folder)?;
    let true_pose = |name: &String| {
        let stem = name.rsplit('/').next().unwrap_or(name);
        by_stem.get(stem).copied().ok_or_else(|| {
            let remedy = "name the folder that these scans came from with --truth";
            let found = format!("no true pose for the scan {name}");
            Error::file(truth_folder, found, "the scans of the result", remedy)
        })
    };
    let truth =
        document.scans.iter().map(|s| true_pose(&s.name)).collect::<Result<Vec<RigidMotion>, Error>>()?;
    let report = evaluate_against_truth(reconstruction, &truth)?;
    Ok((report, scene.world_from_scan.map_or(0.0, |t| t.deviation)))
}

/// True poses by the name of their scan.
fn true_poses(scene: &io::dataset::Scene, folder: &Path) -> Result<BTreeMap<String, RigidMotion>, Error> {
    let Some(truth) = &scene.world_from_scan else {
        return Err(Error::file(
            folder,
            "scans without true poses",
            "truth.json, a pose file beside each scan, poses/, poses.txt or one .conf",
            "see `scanweave evaluate --help` for the layouts",
        ));
    };
    let names = io::unique_names(&scene.scans);
    let stems = names.into_iter().map(|n| n.rsplit('/').next().unwrap_or(&n).to_owned());
    Ok(stems.zip(truth.value.iter().copied()).collect())
}

/// Recall on one benchmark, whose ids are the numbers at the end of the scans' names.
fn recall(
    folder: &Path,
    document: &Document,
    reconstruction: &Reconstruction,
    config: &RecallConfig,
) -> Result<RecallReport, Error> {
    let benchmark = io::dataset::read_benchmark(folder)?;
    let numbered: BTreeMap<usize, ScanId> = document
        .scans
        .iter()
        .filter_map(|entry| Some((trailing_number(&entry.name)?, ScanId(entry.id))))
        .collect();
    if let Some(pair) =
        benchmark.pairs.iter().find(|p| !numbered.contains_key(&p.i.0) || !numbered.contains_key(&p.j.0))
    {
        return Err(Error::file(
            folder.join("gt.log"),
            format!("the pair {} {}", pair.i, pair.j),
            format!("numbers of the {} scans of the result", document.scans.len()),
            "register all scans of the scene, or name the benchmark of this scene",
        ));
    }
    let relative = |i: ScanId, j: ScanId| reconstruction.relative(numbered[&i.0], numbered[&j.0]);
    registration_recall(&benchmark.pairs, relative, config)
}

fn trailing_number(name: &str) -> Option<usize> {
    let digits = name.bytes().rev().take_while(u8::is_ascii_digit).count();
    name[name.len() - digits..].parse().ok()
}

fn print(report: &Report, deviation: f64) -> anyhow::Result<()> {
    let p = &report.poses;
    let components = if p.components == 1 { "component" } else { "components" };
    terminal::print_line(&format!(
        "placed     {} of {} scans, {} {components}",
        p.placed, p.total, p.components
    ))?;
    if !report.declined.is_empty() {
        terminal::print_line(&format!("declined   {}", report.declined.join(", ")))?;
    }
    if deviation > 1e-5 {
        terminal::print_line(&format!(
            "truth      rotations up to {deviation:.1e} from orthonormal, replaced by the nearest rotations"
        ))?;
    }
    let s = &p.pair_summary;
    terminal::print_line(&format!(
        "pairs      {} within components: rotation median {:.2}°, largest {:.2}°; translation median {}, largest {}",
        p.pairs.len(),
        s.median_rotation_deg,
        s.max_rotation_deg,
        metres(s.median_translation_m),
        metres(s.max_translation_m)
    ))?;
    for (folder, r) in &report.benchmarks {
        let recall = r.recall().map_or("no counted pair".to_owned(), |v| format!("{:.1} %", 100.0 * v));
        terminal::print_line(&format!(
            "recall     {recall} ({} of {} pairs, {} with a declined scan, {} without information)  {folder}",
            r.succeeded,
            r.counted,
            r.declined.len(),
            r.zero_information
        ))?;
    }
    Ok(())
}

fn metres(value: f64) -> String {
    if value < 0.01 { format!("{:.2} mm", 1000.0 * value) } else { format!("{value:.3} m") }
}
