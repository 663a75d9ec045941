//! `scanweave report`.

use super::options::ThreadOption;
use super::progress::Progress;
use super::{Status, Verbosity, terminal};
use clap::Args;
use rayon::prelude::*;
use scanweave::config::{Config, Layers};
use scanweave::evaluation::truth::against_truth;
use scanweave::files::{self, FolderLock};
use scanweave::geometry::Point;
use scanweave::io::ReadOptions;
use scanweave::preprocessing::localize;
use scanweave::report::html::PointSource;
use scanweave::report::{html, protocol};
use scanweave::result::{self, RunReport};
use scanweave::result::{Document, Entry};
use scanweave::result_folder::{CONFIG, OVERLAP, PAGE, PROTOCOL, REPORT, load_poses_for_pages, merged_files};
use scanweave::scan::{PointCloud, Reconstruction, Scan, ScanId, Surface};
use scanweave::{Error, Monitor, io};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// Names that a message lists.
const FEW: usize = 5;

/// Make report.html and registration.html of an existing result anew: files for any browser, without
/// a network.
///
/// `register` and `demo --output` write them too. report.html shows the scans; registration.html is
/// for printing and signing. The points come from the scan files that
/// poses.json names; --scans says where they are now. Only regular files that end as those of scans are
/// read. Where a file is gone or another, the page shows what the result's own merged clouds (merged.ply,
/// merged_1.ply, ...) hold of its scan, and says so.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Output folder of `register`.
    #[arg(value_name = "RESULT")]
    result: PathBuf,
    /// File to write instead of report.html in that folder; registration.html is then left as it is.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// The same scans as were registered, where they have moved: files, folders, globs or
    /// @list.txt.
    #[arg(long, value_name = "SCANS", num_args = 1..)]
    scans: Vec<String>,
    /// Look into the folders in a folder of --scans, too.
    #[arg(long, requires = "scans")]
    recursive: bool,
    /// Folder of the scans with their true poses, as `evaluate` takes it: the page then tells every
    /// scan's error too, and colours by it.
    #[arg(long, value_name = "SCENE")]
    truth: Option<PathBuf>,
    #[command(flatten)]
    threads: ThreadOption,
}

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let folder = &arguments.result;
    // With --output, nothing is written here, and the folder may be read-only.
    let _lock = match arguments.output.is_none() && folder.exists() {
        true => Some(FolderLock::take(folder)?),
        false => None,
    };
    let poses = load_poses_for_pages(folder)?;
    let report = RunReport::load(&folder.join(REPORT))?;
    let config_file = folder.join(CONFIG);
    let config = scanweave::files::read_text(&config_file)?;
    let settings = settings(&config_file)?;
    let overlap_file = folder.join(OVERLAP);
    let similarity = match overlap_file.exists() {
        true => Some(result::read_predicted_overlaps(&overlap_file, poses.scans.len())?),
        false => None,
    };
    let reconstruction = poses.reconstruction()?;
    let truth = match &arguments.truth {
        Some(truth) => Some(against_truth(&poses, &reconstruction, truth)?),
        None => None,
    };
    arguments.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let (clouds, sources) = clouds(arguments, &poses, &reconstruction, &settings.input, &progress)?;
    let scan = |(entry, cloud): (&Entry, &PointCloud)| Scan {
        id: ScanId(entry.id),
        name: entry.name.clone(),
        cloud: cloud.clone(),
        ..Scan::default()
    };
    let (local, frames) = localize(&poses.scans.iter().zip(&clouds).map(scan).collect::<Vec<_>>());
    let mut surfaces = scanweave::pipeline::thin(&local, &frames, &report.scale, &progress)?;
    for (surface, _) in surfaces.iter_mut().zip(&sources).filter(|s| *s.1 == PointSource::Merged) {
        // A mean over scans lies closer to each of them than the scans to each other.
        *surface = Surface::default();
    }
    let page = html::page(&html::Input {
        poses: &poses,
        run: &report,
        config: &config,
        similarity: similarity.as_ref(),
        clouds: &clouds.iter().collect::<Vec<_>>(),
        sources: &sources,
        surfaces: &surfaces,
        frames: &frames,
        truth: truth.as_ref(),
    })?;
    let output = arguments.output.clone().unwrap_or_else(|| folder.join(PAGE));
    files::write(&output, |out| out.write_all(page.as_bytes()))?;
    if arguments.output.is_none() {
        let reference = settings.output.reference.as_deref();
        let protocol = protocol::page(&protocol::Input { poses: &poses, run: &report, reference });
        files::write(&folder.join(PROTOCOL), |out| out.write_all(protocol.as_bytes()))?;
    }
    if !verbosity.quiet {
        let (size, said) = (page.len() as f64 / 1e6, html::headline(&poses));
        terminal::print_line(&said)?;
        terminal::print_line(&format!("written  {} ({size:.1} MB)", output.display()))?;
    }
    Ok(Status::Success)
}

/// The settings of the result: how the scans were read, which one stays.
pub fn settings(config_file: &Path) -> scanweave::Result<Config> {
    let mut layers = Layers::new::<Config>();
    layers.add_file(config_file)?;
    Config::from_layers(&layers)
}

/// Points of every scan and where they come from: its file, else the result's merged clouds; empty
/// where neither has any.
fn clouds(
    arguments: &Arguments,
    poses: &Document,
    reconstruction: &Reconstruction,
    options: &ReadOptions,
    monitor: &dyn Monitor,
) -> scanweave::Result<(Vec<PointCloud>, Vec<PointSource>)> {
    let read = scans_of(arguments, poses, options, monitor)?;
    let mut merged = match read.iter().all(Option::is_some) {
        true => Vec::new(),
        false => {
            let files = merged_files(&arguments.result, poses.components.len());
            result::points_of_scans(&files, reconstruction)?
        }
    };
    let (mut clouds, mut sources, mut gone) = (Vec::new(), Vec::new(), Vec::new());
    for (i, cloud) in read.into_iter().enumerate() {
        let kept = merged.get_mut(i).map(std::mem::take).filter(|m| !m.is_empty());
        sources.push(if cloud.is_none() && kept.is_some() { PointSource::Merged } else { PointSource::Scan });
        if cloud.is_none() {
            gone.push((poses.scans[i].name.as_str(), kept.is_some()));
        }
        clouds.push(cloud.or(kept).unwrap_or_else(|| PointCloud::from_points(Vec::<Point>::new())));
    }
    if !gone.is_empty() {
        let names: Vec<&str> = gone.iter().take(FEW).map(|g| g.0).collect();
        let more = if gone.len() > FEW { ", …" } else { "" };
        tracing::warn!(
            "the files of {} scans are not where they were ({}{more}): the page shows what the merged \
             cloud holds of {} of them, and no points of the others; pass --scans with where they are now",
            gone.len(),
            names.join(", "),
            gone.iter().filter(|g| g.1).count()
        );
    }
    Ok((clouds, sources))
}

/// The clouds of the scans, as far as their files are where they were.
fn scans_of(
    arguments: &Arguments,
    poses: &Document,
    options: &ReadOptions,
    monitor: &dyn Monitor,
) -> scanweave::Result<Vec<Option<PointCloud>>> {
    const STAGE: &str = "reading scans";
    if !arguments.scans.is_empty() {
        let found = io::discover_with(&arguments.scans, arguments.recursive)?;
        let scans = io::read_inputs(&found, options, false, monitor)?.scans;
        if scans.len() != poses.scans.len() {
            return Err(Error::setting(
                "--scans",
                format!("{} scans", scans.len()),
                format!("the {} scans that were registered", poses.scans.len()),
                "name the same scans as for `register`",
            ));
        }
        return Ok(scans.into_iter().map(|scan| Some(scan.cloud)).collect());
    }
    // A file of several scans is read once.
    let files: BTreeSet<&str> = poses.scans.iter().filter_map(|s| s.file.as_deref()).collect();
    monitor.begin(STAGE, files.len());
    let read = |file: &&str| {
        monitor.check(STAGE)?;
        monitor.advance(1);
        let path = Path::new(file);
        let scans = match io::check_named_scan(path) {
            Ok(()) => io::read_file(path, options)?.scans,
            Err(Error::Read { source, .. }) if source.kind() == ErrorKind::NotFound => Vec::new(),
            // The result may come from somebody else: what it names need not be a scan.
            Err(refusal) => {
                tracing::warn!("not read: {refusal}");
                Vec::new()
            }
        };
        let clouds: Vec<Option<PointCloud>> = scans.into_iter().map(|s| Some(s.cloud)).collect();
        Ok((file.to_string(), clouds))
    };
    let files: Vec<&str> = files.into_iter().collect();
    let read: Vec<scanweave::Result<_>> = files.par_iter().map(read).collect();
    monitor.end();
    let mut read: BTreeMap<String, Vec<Option<PointCloud>>> =
        read.into_iter().collect::<scanweave::Result<_>>()?;
    let mut take = |entry: &Entry| {
        let clouds = read.get_mut(entry.file.as_deref()?)?;
        clouds.get_mut(entry.part.unwrap_or(0))?.take()
    };
    Ok(poses.scans.iter().map(&mut take).collect())
}
