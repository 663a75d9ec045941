//! `scanweave export`, and the files for other programs that `register` writes with a result.

use super::options::word;
use super::progress::Progress;
use super::report::settings;
use super::{Status, Verbosity, terminal};
use clap::Args;
use scanweave::files::{FolderLock, is_same_place};
use scanweave::result::RunReport;
use scanweave::result::{ScanFormat, export_scans};
use scanweave::result_folder::{
    CONFIG, Exports, GraphFormat, REPORT, Registration, TrajectoryFormat, load_poses,
};
use scanweave::{Error, Result};
use std::path::{Path, PathBuf};

/// Write the poses of an existing result for other programs.
///
/// Every component has files of its own: trajectory.tum of the first, trajectory_1.tum of the second, as
/// poses of different components are unrelated. Scans without a pose are left out.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Output folder of `register`.
    #[arg(value_name = "RESULT")]
    result: PathBuf,
    /// Folder for the files. Default: that of the result.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    exports: ExportOptions,
    /// Write every placed scan whole, moved into the frame of its component, with colour, intensity and
    /// normals, into this folder. The files of the scans that poses.json names are read again (regular files
    /// that end as those of scans), block by block where they are binary PLY or PCD, LAS, LAZ or E57, else
    /// one at a time.
    #[arg(long, value_name = "DIR", requires = "format")]
    export_scans: Option<PathBuf>,
    /// Format of the scans: ply, pcd, las or laz (without normals), one file a scan; or e57, one file
    /// with all scans of a component and their poses.
    #[arg(long, value_name = "FORMAT", value_parser = word::<ScanFormat>, requires = "export_scans")]
    format: Option<ScanFormat>,
    /// Replace exported scans that are already there.
    #[arg(long)]
    force: bool,
}

impl Arguments {
    /// Folder for the files.
    fn folder(&self) -> &Path {
        self.output.as_deref().unwrap_or(&self.result)
    }
}

/// What is written for other programs.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Files for other programs")]
pub struct ExportOptions {
    /// Write the poses, in one format or several with commas between: tum (trajectory.tum), kitti
    /// (trajectory_kitti.txt, and the scans' names in trajectory_kitti_names.txt), csv
    /// (trajectory.csv), colmap (images.txt).
    #[arg(long, value_name = "FORMAT", value_delimiter = ',', value_parser = word::<TrajectoryFormat>)]
    trajectory: Vec<TrajectoryFormat>,
    /// Write scans and their relative poses with information matrices: g2o (pose_graph.g2o), open3d
    /// (pose_graph.json).
    #[arg(long, value_name = "FORMAT", value_delimiter = ',', value_parser = word::<GraphFormat>)]
    pose_graph: Vec<GraphFormat>,
}

impl ExportOptions {
    /// The same without the flags.
    pub fn exports(&self) -> Exports {
        Exports { trajectory: self.trajectory.clone(), pose_graph: self.pose_graph.clone() }
    }
}

/// Locks the folders that are written into, and makes those that do not exist.
fn lock(arguments: &Arguments) -> Result<Vec<FolderLock>> {
    let mut locks = Vec::new();
    let folder = Some(arguments.folder()).filter(|_| !arguments.exports.exports().is_empty());
    if let Some(folder) = folder {
        // A result that is not there must not become an empty folder.
        if arguments.output.is_some() || folder.exists() {
            locks.push(FolderLock::take(folder)?);
        }
    }
    let scans = arguments.export_scans.as_deref();
    if let Some(scans) = scans.filter(|scans| !folder.is_some_and(|f| is_same_place(f, scans))) {
        locks.push(FolderLock::take(scans)?);
    }
    Ok(locks)
}

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let exports = arguments.exports.exports();
    if exports.is_empty() && arguments.export_scans.is_none() {
        let expected = "--trajectory tum,kitti,csv,colmap, --pose-graph g2o,open3d, or --export-scans DIR \
                        --format ply, or several of these";
        return Err(Error::setting("export", "nothing to write", expected, "add one of these flags").into());
    }
    let _locks = lock(arguments)?;
    let document = load_poses(&arguments.result)?;
    if let (Some(folder), Some(format)) = (&arguments.export_scans, arguments.format) {
        let options = settings(&arguments.result.join(CONFIG))?.input;
        let progress = Progress::start(verbosity)?;
        let exported = export_scans(&document, &options, folder, format, arguments.force, &progress)?;
        if !verbosity.quiet {
            let n = exported.files.len();
            terminal::print_line(&format!("written  {}: {n} files of scans", folder.display()))?;
            if !exported.left_out.is_empty() {
                let names = exported.left_out.join(", ");
                terminal::print_line(&format!("left out {names}: no pose"))?;
            }
        }
    }
    if exports.is_empty() {
        return Ok(Status::Success);
    }
    let inlier_radius_m = match exports.pose_graph.is_empty() {
        true => 0.0,
        false => RunReport::load(&arguments.result.join(REPORT))?.scale.inlier_radius_m,
    };
    let folder = arguments.folder();
    let registration = Registration { inlier_radius_m, pose_graph: None };
    let written = exports.write(folder, &document, &registration)?;
    if !verbosity.quiet {
        terminal::print_line(&format!("written  {}: {}", folder.display(), written.join(", ")))?;
    }
    Ok(Status::Success)
}
