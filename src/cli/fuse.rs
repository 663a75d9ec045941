//! `scanweave fuse`.

use super::options::{DepthOptions, ThreadOption, refuse_walk};
use super::progress::Progress;
use super::{Status, Verbosity, terminal};
use clap::Args;
use scanweave::files::FolderLock;
use scanweave::fusion::FusionConfig;
use scanweave::io::ReadOptions;
use scanweave::preparation::fragments::{FragmentConfig, write_fragments};
use std::path::PathBuf;

/// Fuse the depth images of a walk into fragments, as the 3DMatch test set was made.
///
/// Each fragment is a surface (points with normals) from the truncated signed distances of
/// consecutive images, in the frame of its first image's camera. Writes
/// PointCloud/cloud_bin_<i>.ply with cloud_bin_<i>.info.txt (true world_from_scan).
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folder of 16-bit depth images with camera intrinsics and a pose each.
    #[arg(value_name = "WALK")]
    walk: PathBuf,
    /// Folder for the fragments.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace the fragments that the folder already holds.
    #[arg(long)]
    force: bool,
    /// Images fused into one fragment.
    #[arg(long, value_name = "N", default_value_t = FragmentConfig::default().frames_per_fragment)]
    frames_per_fragment: usize,
    /// Images between the starts of fragments. Default: as many as go into one.
    #[arg(long, value_name = "N")]
    step: Option<usize>,
    /// Width of a voxel, metres.
    #[arg(long, value_name = "M", default_value_t = FusionConfig::default().voxel_m)]
    voxel: f64,
    /// Distance to the surface beyond which only its side is kept, metres. Default: 5 voxels.
    #[arg(long, value_name = "M")]
    truncation: Option<f64>,
    /// Depth beyond which measurements are left out, metres.
    #[arg(long, value_name = "M", default_value_t = FusionConfig::default().max_depth_m)]
    max_depth: f64,
    /// Images that must have seen a place for a surface there.
    #[arg(long, value_name = "N", default_value_t = FusionConfig::default().min_observations)]
    min_observations: u32,
    /// Most memory for voxels, MiB.
    #[arg(long, value_name = "N", default_value_t = FusionConfig::default().memory_mib)]
    memory: usize,
    #[command(flatten)]
    depth: DepthOptions,
    #[command(flatten)]
    threads: ThreadOption,
}

/// Truncation in voxels where it is not given, as in 3DMatch.
const TRUNCATION_VOXELS: f64 = 5.0;

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    refuse_walk(&arguments.walk, &arguments.output)?;
    let _lock = FolderLock::take(&arguments.output)?;
    arguments.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let mut reading = ReadOptions::default();
    arguments.depth.lay_over(&mut reading);
    reading.validate()?;
    let config = FragmentConfig {
        frames_per_fragment: arguments.frames_per_fragment,
        step: arguments.step.unwrap_or(arguments.frames_per_fragment),
        reading,
        fusion: FusionConfig {
            voxel_m: arguments.voxel,
            truncation_m: arguments.truncation.unwrap_or(TRUNCATION_VOXELS * arguments.voxel),
            max_depth_m: arguments.max_depth,
            min_observations: arguments.min_observations,
            memory_mib: arguments.memory,
        },
    };
    let (fragments, notes) =
        write_fragments(&arguments.walk, &arguments.output, arguments.force, &config, &progress)?;
    for (note, images) in notes.iter().filter(|_| !verbosity.quiet) {
        let kind = if note.warning { "warning" } else { "reading" };
        terminal::tell(&format!("{kind}: {images} images: {}", note.text));
    }
    for empty in fragments.iter().filter(|f| f.points == 0) {
        tracing::warn!("frames {} to {} show no surface: left out", empty.frames.start, empty.frames.end - 1);
    }
    if !verbosity.quiet {
        terminal::print_line(&format!(
            "{}: {} fragments, {} points",
            arguments.output.display(),
            fragments.iter().filter(|f| f.points > 0).count(),
            fragments.iter().map(|f| f.points).sum::<usize>()
        ))?;
    }
    Ok(Status::Success)
}
