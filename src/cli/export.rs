//! `scanweave export`, and the files for other programs that `register` writes with a result.

use super::options::word;
use super::progress::Progress;
use super::report::settings;
use super::result_folder::{CONFIG, REPORT, load_poses, numbered};
use super::{Status, Verbosity, terminal};
use clap::{Args, ValueEnum};
use scanweave::files::{FolderLock, is_same_place};
use scanweave::io;
use scanweave::result::{self, Document, RunReport, ScanFormat, export_scans};
use scanweave::scan::PoseGraph;
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
    #[arg(long, value_name = "FORMAT", value_delimiter = ',', hide_possible_values = true)]
    pub trajectory: Vec<TrajectoryFormat>,
    /// Write scans and their relative poses with information matrices: g2o (pose_graph.g2o), open3d
    /// (pose_graph.json).
    #[arg(long, value_name = "FORMAT", value_delimiter = ',', hide_possible_values = true)]
    pub pose_graph: Vec<GraphFormat>,
}

/// A format of trajectories.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TrajectoryFormat {
    Tum,
    Kitti,
    Csv,
    Colmap,
}

/// A format of pose graphs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GraphFormat {
    G2o,
    Open3d,
}

impl TrajectoryFormat {
    fn file(self, component: usize) -> String {
        match self {
            Self::Tum => numbered("trajectory", component, "tum"),
            Self::Kitti => numbered("trajectory_kitti", component, "txt"),
            Self::Csv => numbered("trajectory", component, "csv"),
            Self::Colmap => numbered("images", component, "txt"),
        }
    }
}

impl GraphFormat {
    fn file(self, component: usize) -> String {
        match self {
            Self::G2o => numbered("pose_graph", component, "g2o"),
            Self::Open3d => numbered("pose_graph", component, "json"),
        }
    }
}

/// Names of all files that may be written for a component.
pub fn files(component: usize) -> Vec<String> {
    let trajectories = TrajectoryFormat::value_variants().iter().map(|f| f.file(component));
    let graphs = GraphFormat::value_variants().iter().map(|f| f.file(component));
    let names = io::trajectory_names_file(Path::new(&TrajectoryFormat::Kitti.file(component)));
    trajectories.chain(graphs).chain([names.to_string_lossy().into_owned()]).collect()
}

/// What pose graphs need to know beside the poses.
pub struct Registration<'a> {
    /// τ, metres.
    pub inlier_radius_m: f64,
    /// The pairs of a global method.
    pub pose_graph: Option<&'a PoseGraph>,
}

impl ExportOptions {
    /// Whether nothing is asked for.
    pub fn is_empty(&self) -> bool {
        self.trajectory.is_empty() && self.pose_graph.is_empty()
    }

    /// Writes what is asked for into `folder`; returns the names of the files.
    pub fn write(
        &self,
        folder: &Path,
        document: &Document,
        registration: &Registration<'_>,
    ) -> Result<Vec<String>> {
        let names = result::scan_names(document);
        let reconstruction = document.reconstruction()?;
        let mut written = Vec::new();
        for component in 0..document.components.len().max(1) {
            let scans = result::placed_scans(document, component)?;
            for format in &self.trajectory {
                let file = format.file(component);
                let path = folder.join(&file);
                match format {
                    TrajectoryFormat::Tum => io::write_tum_trajectory(path, &scans, &names)?,
                    TrajectoryFormat::Kitti => io::write_kitti_trajectory(path, &scans)?,
                    TrajectoryFormat::Csv => io::write_csv_trajectory(path, &scans)?,
                    TrajectoryFormat::Colmap => io::write_images_trajectory(path, &scans)?,
                }
                written.push(file);
            }
            for format in &self.pose_graph {
                let radius_m = registration.inlier_radius_m;
                let pairs = registration.pose_graph;
                let graph =
                    result::pose_graph_of_component(&names, &reconstruction, pairs, component, radius_m);
                let file = format.file(component);
                match format {
                    GraphFormat::G2o => io::write_g2o(folder.join(&file), &graph)?,
                    GraphFormat::Open3d => io::write_open3d_pose_graph(folder.join(&file), &graph)?,
                }
                written.push(file);
            }
        }
        Ok(written)
    }
}

/// Locks the folders that are written into, and makes those that do not exist.
fn lock(arguments: &Arguments) -> Result<Vec<FolderLock>> {
    let mut locks = Vec::new();
    let folder = Some(arguments.folder()).filter(|_| !arguments.exports.is_empty());
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
    if arguments.exports.is_empty() && arguments.export_scans.is_none() {
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
    if arguments.exports.is_empty() {
        return Ok(Status::Success);
    }
    let inlier_radius_m = match arguments.exports.pose_graph.is_empty() {
        true => 0.0,
        false => RunReport::load(&arguments.result.join(REPORT))?.scale.inlier_radius_m,
    };
    let folder = arguments.folder();
    let registration = Registration { inlier_radius_m, pose_graph: None };
    let written = arguments.exports.write(folder, &document, &registration)?;
    if !verbosity.quiet {
        terminal::print_line(&format!("written  {}: {}", folder.display(), written.join(", ")))?;
    }
    Ok(Status::Success)
}
