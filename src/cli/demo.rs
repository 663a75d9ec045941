//! `scanweave demo`.

use super::options::{SettingOptions, ThreadOption};
use super::progress::Progress;
use super::synth::SceneOptions;
use super::{Status, Verbosity, outcome, terminal};
use clap::Args;
use scanweave::evaluation::pose_error::PoseError;
use scanweave::pipeline::{self, FeatureSource, Stopwatch};
use scanweave::report::top_view;
use scanweave::result;
use scanweave::result::MergedCloud;
use scanweave::result_folder::{Exports, ResultFolder};
use scanweave::scan::{Reconstruction, ScanId};
use scanweave::synthetic::{self, SyntheticSet};
use scanweave::{files, report};
use std::io::Write;
use std::path::PathBuf;

/// A scan counts as right within both of these of the truth, relative to the pivot.
const MAX_ERROR_M: f64 = 0.15;
const MAX_ERROR_DEG: f64 = 3.0;

/// Register a synthetic interior and compare with the truth; needs no input.
///
/// Takes scans in furnished rooms with a simulated depth camera, forgets their order and
/// poses, registers them, and compares every pose with the true one. Exits with 6 when a
/// scan of the building is missing or wrong, or an unrelated one was placed with others.
#[derive(Debug, Args)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneOptions,
    /// Also write the result, as `register` does, into this folder, and a picture of it.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Replace the result that the output folder already holds.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    threads: ThreadOption,
    /// Settings to start from: `default` (the best known) or `paper` (as published).
    #[arg(long, value_name = "NAME", default_value = scanweave::config::DEFAULT_PRESET)]
    preset: String,
    /// One setting laid over it; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
}

pub fn run(arguments: Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let seed = Some(arguments.scene.seed);
    let (preset, assignments) = (arguments.preset.clone(), arguments.assignments.clone());
    let settings = SettingOptions { preset, assignments, seed, ..SettingOptions::default() };
    let config = settings.config()?;
    let folder = match &arguments.output {
        Some(path) => Some(ResultFolder::open(path, arguments.force)?),
        None => None,
    };
    arguments.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let mut clock = Stopwatch::default();
    let set = clock.time("scanning", || synthetic::generate(&arguments.scene.config(), &progress))?;
    let run = pipeline::run(&set.scans, &config, &FeatureSource::Computed, &progress)?;

    let poses = result::Document::new(&set.scans, &run.reconstruction, run.scale.inlier_radius_m);
    let comparisons = compare(&set, &run.reconstruction);
    let wrong = comparisons.iter().filter(|v| !v.right).count();
    if !verbosity.quiet {
        terminal::print_drawn(&comparison_table(&result::rows(&poses), &comparisons))?;
        clock.stages.extend(run.timings.iter().cloned());
        let seconds: f64 = clock.stages.iter().map(|t| t.seconds).sum();
        let summary = if wrong == 0 {
            "the demo succeeded".to_owned()
        } else {
            format!("the demo FAILED: {wrong} wrong")
        };
        terminal::print_line("")?;
        terminal::print_line(&format!(
            "{summary}: {} scans, {} in the largest component, within {:.0} cm and {MAX_ERROR_DEG}° of the truth \
             ({seconds:.1} s)",
            set.scans.len(),
            poses.components.first().map_or(0, |c| c.scans.len()),
            MAX_ERROR_M * 100.0
        ))?;
    }
    if let Some(folder) = folder {
        let exports = Exports::default();
        folder.write(&set.scans, &run, &config, &exports, Stopwatch::default(), &progress)?;
        let cloud = MergedCloud::new(&set.scans, &run.reconstruction, 0, run.scale.voxel_m as f32);
        let picture = top_view::svg(&cloud, set.scans.len());
        files::write(&folder.path().join("top_view.svg"), |out| out.write_all(picture.as_bytes()))?;
        if !verbosity.quiet {
            terminal::print_line(&format!("written to {}", folder.path().display()))?;
        }
    }
    Ok(if wrong == 0 { outcome::status(&run.reconstruction) } else { Status::NothingRegistered })
}

/// How a scan compares with the truth.
struct TruthComparison {
    /// Rotation (degrees) and translation (metres) error relative to the largest component's pivot.
    error: Option<(f64, f64)>,
    right: bool,
}

/// Scans of the building must be in the largest component at their true relative pose, all
/// others must not.
fn compare(set: &SyntheticSet, reconstruction: &Reconstruction) -> Vec<TruthComparison> {
    let in_largest = |i: usize| reconstruction.outcomes[i].placement().filter(|p| p.component == 0);
    let pivot = (0..set.scans.len()).find(|&i| in_largest(i).is_some_and(|p| p.parent.is_none()));
    let compared = |i: usize| {
        let Some(pivot) = pivot.filter(|_| in_largest(i).is_some()) else {
            return TruthComparison { error: None, right: set.building[i] != 0 };
        };
        if set.building[i] != set.building[pivot] {
            return TruthComparison { error: None, right: false };
        }
        let truth = set.world_from_scan[pivot].inverse() * set.world_from_scan[i];
        let Some(estimate) = reconstruction.relative(ScanId(pivot), ScanId(i)) else {
            return TruthComparison { error: None, right: false };
        };
        let e = PoseError::between(&estimate, &truth);
        let right = e.rotation_deg <= MAX_ERROR_DEG && e.translation_m <= MAX_ERROR_M && set.building[i] == 0;
        TruthComparison { error: Some((e.rotation_deg, e.translation_m)), right }
    };
    (0..set.scans.len()).map(compared).collect()
}

fn comparison_table(rows: &[result::Row], comparisons: &[TruthComparison]) -> String {
    let errors: Vec<(Option<(f64, f64)>, bool)> = comparisons.iter().map(|v| (v.error, v.right)).collect();
    report::table::against_truth(rows, &errors, outcome::width())
}
