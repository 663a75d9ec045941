//! `scanweave ground-truth`.

use super::options::ThreadOption;
use super::progress::Progress;
use super::{Status, Verbosity, terminal};
use clap::Args;
use scanweave::files::FolderLock;
use scanweave::preparation::truth::{GroundTruth, TruthConfig};
use std::path::PathBuf;

/// Write the ground truth of posed scans: overlaps, and the pairs of 3DMatch and 3DLoMatch.
///
/// Writes overlap.csv (two-way overlap of every two scans), and 3DMatch/ (overlap above 0.3) and
/// 3DLoMatch/ (above 0.1, up to 0.3) with gt.log, gt.info and gt_overlap.log, as `evaluate
/// --benchmark` takes them. As in the published files, the overlap of a pair i < j is there the
/// share of the points of i that j has too. Scans are called by the number at the end of their
/// names.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folder of the scans with their true poses: truth.json, <scan>.info.txt or .pose.txt beside each
    /// scan, poses/pose<i>.txt, poses.txt, or one Stanford .conf.
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Folder for the files.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace the truth that the folder already holds.
    #[arg(long)]
    force: bool,
    /// Voxel to which scans are thinned, metres. Default: the one `register` would choose.
    #[arg(long, value_name = "M")]
    voxel: Option<f64>,
    /// Distance within which points of two scans are the same place, metres. Default: 1.5 voxels.
    #[arg(long, value_name = "M")]
    radius: Option<f64>,
    #[command(flatten)]
    threads: ThreadOption,
}

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let _lock = FolderLock::take(&arguments.output)?;
    arguments.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let config = TruthConfig { voxel_m: arguments.voxel, radius_m: arguments.radius };
    let truth = GroundTruth::of_scene(&arguments.scene, &config, &progress)?;
    truth.write(&arguments.output, arguments.force)?;
    if !truth.numbered_by_name {
        tracing::warn!("names without a number of their own: scans are numbered in sorted order from 0");
    }
    if !verbosity.quiet {
        print(&truth)?;
        terminal::print_line(&format!("written    {}", arguments.output.display()))?;
    }
    Ok(Status::Success)
}

fn print(truth: &GroundTruth) -> scanweave::Result<()> {
    let n = truth.scans.len();
    terminal::print_line(&format!(
        "scans      {n}, {} pairs, thinned to {:.4} m, common within {:.4} m",
        n * (n - 1) / 2,
        truth.voxel_m,
        truth.radius_m
    ))?;
    if truth.deviation > 1e-5 {
        terminal::print_line(&format!(
            "truth      rotations up to {:.1e} from orthonormal, replaced by the nearest rotations",
            truth.deviation
        ))?;
    }
    for (name, pairs) in &truth.benchmarks {
        let written = if pairs.is_empty() { ", nothing written" } else { "" };
        terminal::print_line(&format!("{name:<10} {} pairs{written}", pairs.len()))?;
    }
    Ok(())
}
