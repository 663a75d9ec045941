//! `scanweave report`.

use super::evaluate::against_truth;
use super::options::ThreadOption;
use super::progress::Progress;
use super::result_folder::{CONFIG, OVERLAP, PAGE, POSES, REPORT};
use super::{Status, Verbosity, terminal};
use clap::Args;
use rayon::prelude::*;
use scanweave::descriptor::surface;
use scanweave::geometry::Point;
use scanweave::report::poses::Document;
use scanweave::report::run::RunReport;
use scanweave::report::{html, overlaps};
use scanweave::scan::{PointCloud, Surface};
use scanweave::{Error, Monitor, io};
use std::io::Write;
use std::path::PathBuf;

/// Make report.html of an existing result anew: one file for any browser, without a network.
///
/// `register` and `demo --output` write it too. The points come from the scan files that
/// poses.json names; where these are gone, --scans says where they are now.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Output folder of `register`.
    #[arg(value_name = "RESULT")]
    result: PathBuf,
    /// File to write instead of report.html in that folder.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// The same scans as were registered, where they have moved: files, folders, globs or
    /// @list.txt.
    #[arg(long, value_name = "SCANS", num_args = 1..)]
    scans: Vec<String>,
    /// Folder of the scans with their true poses, as `evaluate` takes it: the page then tells every
    /// scan's error too, and colours by it.
    #[arg(long, value_name = "SCENE")]
    truth: Option<PathBuf>,
    #[command(flatten)]
    threads: ThreadOption,
}

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let folder = &arguments.result;
    let poses = Document::load(&folder.join(POSES))?;
    let report = RunReport::load(&folder.join(REPORT))?;
    let config_file = folder.join(CONFIG);
    let config = std::fs::read_to_string(&config_file).map_err(|e| Error::read(&config_file, e))?;
    let overlap_file = folder.join(OVERLAP);
    let similarity = match overlap_file.exists() {
        true => Some(overlaps::read_predicted(&overlap_file, poses.scans.len())?),
        false => None,
    };
    let truth = match &arguments.truth {
        Some(truth) => Some(against_truth(&poses, &poses.reconstruction()?, truth)?.0),
        None => None,
    };
    arguments.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let clouds = clouds(arguments, &poses, &progress)?;
    let surfaces: Vec<Surface> = clouds.iter().map(|c| surface::thin(c, &report.scale)).collect();
    let page = html::page(&html::Input {
        poses: &poses,
        run: &report,
        config: &config,
        similarity: similarity.as_ref(),
        clouds: &clouds.iter().collect::<Vec<_>>(),
        surfaces: &surfaces,
        truth: truth.as_ref(),
    })?;
    let output = arguments.output.clone().unwrap_or_else(|| folder.join(PAGE));
    io::atomic::write(&output, |out| out.write_all(page.as_bytes()))?;
    if !verbosity.quiet {
        let (size, said) = (page.len() as f64 / 1e6, html::headline(&poses));
        terminal::print_line(&format!("{said}\nwritten  {} ({size:.1} MB)", output.display()))?;
    }
    Ok(Status::Success)
}

/// Points of every scan; those that are no longer to be found are empty.
fn clouds(
    arguments: &Arguments,
    poses: &Document,
    monitor: &dyn Monitor,
) -> scanweave::Result<Vec<PointCloud>> {
    const STAGE: &str = "reading scans";
    let files: Vec<Option<PathBuf>> = match arguments.scans.is_empty() {
        true => poses.scans.iter().map(|s| s.file.as_ref().map(PathBuf::from)).collect(),
        false => {
            let found = io::discover(&arguments.scans)?;
            if found.len() != poses.scans.len() {
                return Err(Error::setting(
                    "--scans",
                    format!("{} scans", found.len()),
                    format!("the {} scans that were registered", poses.scans.len()),
                    "name the same scans as for `register`",
                ));
            }
            found.into_iter().map(Some).collect()
        }
    };
    monitor.begin(STAGE, files.len());
    let read = |file: &Option<PathBuf>| {
        monitor.check(STAGE)?;
        monitor.advance(1);
        match file.as_deref().filter(|f| f.exists()) {
            Some(file) => io::read_cloud(file),
            None => Ok(PointCloud::from_points(Vec::<Point>::new())),
        }
    };
    let clouds: Vec<scanweave::Result<PointCloud>> = files.par_iter().map(read).collect();
    monitor.end();
    let clouds = clouds.into_iter().collect::<scanweave::Result<Vec<_>>>()?;
    let missing: Vec<&str> =
        poses.scans.iter().zip(&clouds).filter(|(_, c)| c.is_empty()).map(|(s, _)| s.name.as_str()).collect();
    if let Some(first) = missing.first() {
        tracing::warn!(
            "the files of {} scans are not where they were ({first}, …): the page shows no points of \
             them; pass --scans with where they are now",
            missing.len()
        );
    }
    Ok(clouds)
}
