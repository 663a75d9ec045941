//! `scanweave sample`.

use super::options::ThreadOption;
use super::options::refuse_walk;
use super::progress::Progress;
use super::{Status, Verbosity, terminal};
use clap::Args;
use scanweave::files::FolderLock;
use scanweave::preparation::sample::{SampleConfig, write_sample};
use std::path::PathBuf;

/// Take frames of a walk as unordered scans, as the ScanNet protocol does.
///
/// Writes PointCloud/cloud_bin_<i>.ply with cloud_bin_<i>.info.txt (true world_from_scan); the
/// numbers are drawn at random, so that nothing is left of the walk's order.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folder of the frames (depth PNG with camera intrinsics, or clouds) with a pose each.
    #[arg(value_name = "WALK")]
    walk: PathBuf,
    /// Folder for the scans.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace the scans that the folder already holds.
    #[arg(long)]
    force: bool,
    /// Frames taken.
    #[arg(long, value_name = "N", default_value_t = SampleConfig::default().frames)]
    frames: usize,
    /// Frames from one to the next.
    #[arg(long, value_name = "N", default_value_t = SampleConfig::default().every)]
    every: usize,
    /// The first frame taken, counted from 0 in sorted order.
    #[arg(long, value_name = "N", default_value_t = 0)]
    first: usize,
    /// Seed of the order.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    threads: ThreadOption,
}

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    refuse_walk(&arguments.walk, &arguments.output)?;
    let _lock = FolderLock::take(&arguments.output)?;
    arguments.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let config = SampleConfig {
        frames: arguments.frames,
        every: arguments.every,
        first_frame: arguments.first,
        seed: arguments.seed,
    };
    let frames = write_sample(&arguments.walk, &arguments.output, arguments.force, &config, &progress)?;
    if !verbosity.quiet {
        terminal::print_line(&format!("{}: {} scans", arguments.output.display(), frames.len()))?;
    }
    Ok(Status::Success)
}
