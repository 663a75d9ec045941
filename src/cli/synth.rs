//! `scanweave synth`.

use super::options::ThreadOption;
use super::progress::Progress;
use super::{Status, Verbosity, terminal};
use clap::Args;
use scanweave::evaluation::ground_truth::{overlap_matrix, truth_of_pairs};
use scanweave::files::FolderLock;
use scanweave::geometry::Point;
use scanweave::geometry::voxel_means;
use scanweave::io::{SceneWriter, write_benchmark, write_overlaps};
use scanweave::scan::SimilarityMatrix;
use scanweave::synthetic::{self, SynthConfig, SyntheticSet};
use scanweave::{Error, io};
use std::path::PathBuf;

/// Points within this of each other overlap, as in the 3DMatch benchmark's successors (metres).
const OVERLAP_RADIUS_M: f32 = 0.07;
/// Pairs that overlap by less are not part of the truth, as in 3DLoMatch.
const MIN_OVERLAP: f64 = 0.1;

/// Write a synthetic set of scans with its truth, in the 3DMatch layout.
///
/// Makes PointCloud/cloud_bin_<i>.ply with cloud_bin_<i>.info.txt (true world_from_scan), and
/// gt.log, gt.info and gt_overlap.log of all pairs that overlap by more than 0.1.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folder for the set.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace the set that the folder already holds.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    scene: SceneOptions,
    #[command(flatten)]
    threads: ThreadOption,
}

/// What the synthetic set is like.
#[derive(Debug, Args)]
#[command(next_help_heading = "Scene")]
pub struct SceneOptions {
    /// Seed: the same seed gives the same scans.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Scans taken in the building.
    #[arg(long, value_name = "N", default_value_t = SynthConfig::default().scans)]
    pub scans: usize,
    /// Scans of other buildings mixed in, which must be declined.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub unrelated: usize,
    /// Rooms of the building.
    #[arg(long, value_name = "N", default_value_t = SynthConfig::default().rooms)]
    pub rooms: usize,
    /// Factor on the camera's noise: 0 is exact, 1 like the first Kinect.
    #[arg(long, value_name = "X", default_value_t = SynthConfig::default().noise)]
    pub noise: f64,
}

impl SceneOptions {
    /// As settings of the generator.
    pub fn config(&self) -> SynthConfig {
        SynthConfig {
            seed: self.seed,
            scans: self.scans,
            unrelated: self.unrelated,
            rooms: self.rooms,
            noise: self.noise,
            ..SynthConfig::default()
        }
    }
}

pub fn run(arguments: Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let folder = &arguments.output;
    let _lock = FolderLock::take(folder)?;
    // Written last, so that it marks a whole set.
    let mark = folder.join("gt.log");
    if mark.exists() && !arguments.force {
        return Err(Error::OutputExists { path: folder.clone() }.into());
    }
    let writer = SceneWriter::begin(folder, arguments.force)?;
    arguments.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let config = arguments.scene.config();
    let set = synthetic::generate(&config, &progress)?;
    let overlap = overlaps(&set)?;
    let views: Vec<&[Point]> = set.scans.iter().map(|s| s.cloud.points.as_slice()).collect();
    let above = MIN_OVERLAP..f64::INFINITY;
    let mut pairs = truth_of_pairs(&views, &set.world_from_scan, &overlap, &above, OVERLAP_RADIUS_M)?;
    // Poses in different buildings have nothing to do with each other.
    pairs.retain(|p| set.building[p.i.0] == set.building[p.j.0]);
    for (scan, pose) in set.scans.iter().zip(&set.world_from_scan) {
        let colors = scan.cloud.colors.as_deref();
        let cloud = io::PlyCloud { points: &scan.cloud.points, colors, ..io::PlyCloud::default() };
        writer.add(scan.id.0, &cloud, pose, &format!("synthetic\t seed\t {0}\t {0}", scan.id))?;
    }
    if mark.exists() {
        std::fs::remove_file(&mark).map_err(|e| Error::write(&mark, e))?;
    }
    writer.finish()?;
    let numbers: Vec<usize> = (0..set.scans.len()).collect();
    write_overlaps(&folder.join("gt_overlap.log"), &overlap, &numbers, |i, j| {
        pairs.iter().any(|p| (p.i.0, p.j.0) == (i, j))
    })?;
    write_benchmark(folder, &pairs, &numbers)?;
    if !verbosity.quiet {
        let points: usize = set.scans.iter().map(|s| s.cloud.len()).sum();
        terminal::print_line(&format!(
            "{}: {} scans, {points} points, {} overlapping pairs",
            folder.display(),
            set.scans.len(),
            pairs.len()
        ))?;
    }
    Ok(Status::Success)
}

fn overlaps(set: &SyntheticSet) -> scanweave::Result<SimilarityMatrix> {
    let thinned: Vec<_> =
        set.scans.iter().map(|s| voxel_means(&s.cloud.points, 0.5 * OVERLAP_RADIUS_M)).collect();
    let views: Vec<&[Point]> = thinned.iter().map(Vec::as_slice).collect();
    overlap_matrix(&views, &set.world_from_scan, OVERLAP_RADIUS_M)
}
