//! `scanweave evaluate --dataset`: many scenes at once.

use super::evaluate_page::{self, Wanted};
use super::{Verbosity, terminal};
use anyhow::Context;
use scanweave::Error;
use scanweave::evaluation::dataset::{SceneReport, SetReport, evaluate_scene};
use scanweave::evaluation::estimate::SceneEstimate;
use scanweave::evaluation::pose_error::{
    ErrorDistribution, ROTATION_THRESHOLDS_DEG, TRANSLATION_THRESHOLDS_M,
};
use scanweave::evaluation::protocol::Protocol;
use scanweave::evaluation::scene::{Benchmark, SceneTruth, find_scenes};
use std::path::{Path, PathBuf};

/// What is evaluated against what.
pub struct Job<'a> {
    /// Folder with one result a scene.
    pub results: &'a Path,
    /// Folder of the scenes, or the root around it.
    pub dataset: &'a Path,
    /// Scenes to evaluate; all where none is named.
    pub scenes: &'a [String],
    /// How.
    pub protocols: &'a [Protocol],
    /// Folder of `<scene>/gt.log`, in place of the one that the protocol's name finds.
    pub benchmark: Option<&'a Path>,
    /// Drop the first counted pair of a scene.
    pub reference_quirks: bool,
    /// The page to write, where one is wanted.
    pub page: Option<Wanted<'a>>,
}

pub fn run(job: &Job<'_>, json: bool, verbosity: &Verbosity) -> anyhow::Result<()> {
    if job.benchmark.is_some() && job.protocols.len() != 1 {
        let expected = "one --protocol with --benchmark";
        return Err(
            Error::setting("--protocol", job.protocols.len().to_string(), expected, "name one").into()
        );
    }
    let benchmarks: Vec<Benchmark> = job
        .protocols
        .iter()
        .map(|&protocol| {
            let found = || benchmark_folder(job.dataset, protocol);
            let folder = job.benchmark.map(Path::to_path_buf).or_else(found);
            Benchmark { name: protocol.name().to_owned(), protocol, folder }
        })
        .collect();
    let (mut scenes, mut sheets) = (Vec::new(), Vec::new());
    for folder in find_scenes(&scenes_folder(job), job.scenes)? {
        let truth = SceneTruth::read(&folder, &benchmarks)?;
        let estimate = SceneEstimate::read(job.results, &truth)?;
        let mut report = evaluate_scene(&truth, &estimate, job.reference_quirks)?;
        if let Some(wanted) = &job.page {
            let places = (folder.as_path(), job.results);
            sheets.push(evaluate_page::of_scene(wanted, places, &truth, &estimate, &report)?);
        }
        if !job.protocols.contains(&Protocol::Scannet) {
            (report.pairs, report.errors) = (Vec::new(), None);
        }
        scenes.push(report);
    }
    if let Some(wanted) = &job.page {
        evaluate_page::write(wanted, sheets)?;
    }
    let report = SetReport::new(scenes);
    if json {
        terminal::print_json(&(serde_json::to_string_pretty(&report).context("writing the report")? + "\n"))?;
    } else if !verbosity.quiet {
        print(&report)?;
    }
    Ok(())
}

/// The scenes lie in the folder itself, or in one of the protocol's name beside benchmarks/.
fn scenes_folder(job: &Job<'_>) -> PathBuf {
    let own = |protocol: &Protocol| match protocol {
        Protocol::ThreeDMatch | Protocol::ThreeDLoMatch => job.dataset.join("3dmatch"),
        other => job.dataset.join(other.name()),
    };
    let inside = job.protocols.iter().map(own).find(|folder| folder.is_dir());
    inside.unwrap_or_else(|| job.dataset.to_path_buf())
}

/// `benchmarks/<name of the protocol>`, in any case of letters, in the folder or beside it.
fn benchmark_folder(dataset: &Path, protocol: Protocol) -> Option<PathBuf> {
    let places = [dataset.join("benchmarks"), dataset.join("..").join("benchmarks")];
    places.into_iter().find_map(|place| {
        let entries = std::fs::read_dir(place).ok()?;
        let mut found: Vec<PathBuf> = entries.filter_map(|e| e.ok().map(|e| e.path())).collect();
        found.sort();
        let fits = |p: &PathBuf| {
            p.file_name().is_some_and(|n| n.to_string_lossy().eq_ignore_ascii_case(protocol.name()))
        };
        found.into_iter().find(fits)
    })
}

fn print(report: &SetReport) -> Result<(), Error> {
    let width = report.scenes.iter().map(|s| s.scene.chars().count()).max().unwrap_or(0).max(14);
    let line = |text: String| terminal::print_line(&text);
    let share = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{:.1} %", 100.0 * v));
    for (name, summary) in &report.recalls {
        line(format!(
            "{name}: registration recall within all components, and in the largest component alone"
        ))?;
        for scene in &report.scenes {
            let Some(r) = scene.recalls.get(name) else { continue };
            let (all, largest) = (share(r.recall()), share(r.recall_in_largest()));
            let name = &scene.scene;
            let mut text =
                format!("  {name:<width$}  {all:>7}  {largest:>7}  {} of {} pairs", r.succeeded, r.counted);
            if let Some(in_largest) = r.succeeded_in_largest {
                text.push_str(&format!(", {in_largest} in the largest component"));
            }
            if !r.declined.is_empty() {
                text.push_str(&format!(", {} without an estimate", r.declined.len()));
            }
            if r.zero_information > 0 {
                text.push_str(&format!(
                    ", {} without information (counted as registered)",
                    r.zero_information
                ));
            }
            line(text)?;
        }
        let both = |name: &str, all: Option<f64>, largest: Option<f64>| {
            line(format!("  {name:<width$}  {:>7}  {:>7}", share(all), share(largest)))
        };
        both("mean of scenes", summary.mean_of_scenes, summary.mean_of_scenes_in_largest)?;
        both("pooled", summary.pooled, summary.pooled_in_largest)?;
    }
    if let Some(errors) = &report.errors {
        line("scannet: errors of the relative poses of all pairs".to_owned())?;
        for scene in &report.scenes {
            if let Some(errors) = &scene.errors {
                errors_of(&scene.scene, errors)?;
            }
        }
        errors_of("mean of scenes", errors)?;
    }
    report.scenes.iter().try_for_each(remarks)
}

fn errors_of(name: &str, errors: &ErrorDistribution) -> Result<(), Error> {
    let list = |limits: [f64; 5], shares: [f64; 5], unit: &str| -> String {
        let each = limits.iter().zip(shares).map(|(l, s)| format!("{l}{unit} {:.1} %", 100.0 * s));
        each.collect::<Vec<_>>().join(", ")
    };
    let known = |v: Option<f64>, unit: &str| v.map_or("infinite".to_owned(), |v| format!("{v:.3}{unit}"));
    terminal::print_line(&format!(
        "  {name}: {} pairs, {} without an estimate",
        errors.pairs, errors.missing
    ))?;
    terminal::print_line(&format!(
        "    rotation     within {}; mean {}, median {}",
        list(ROTATION_THRESHOLDS_DEG, errors.rotation_cdf, "°"),
        known(errors.rotation_mean_deg, "°"),
        known(errors.rotation_median_deg, "°")
    ))?;
    terminal::print_line(&format!(
        "    translation  within {}; mean {}, median {}",
        list(TRANSLATION_THRESHOLDS_M, errors.translation_cdf, " m"),
        known(errors.translation_mean_m, " m"),
        known(errors.translation_median_m, " m")
    ))
}

/// Scans without a pose, and repairs of the truth.
fn remarks(scene: &SceneReport) -> Result<(), Error> {
    for declined in &scene.declined {
        let text = format!("declined  {} {}: {}", scene.scene, declined.scan, declined.reason);
        terminal::print_line(&text)?;
    }
    if scene.truth_deviation > 1e-5 {
        terminal::print_line(&format!(
            "truth     {}: rotations up to {:.1e} from orthonormal, replaced by the nearest rotations",
            scene.scene, scene.truth_deviation
        ))?;
    }
    Ok(())
}
