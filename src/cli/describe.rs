//! `scanweave describe`.

use super::options::{ReadingOptions, SettingOptions, ThreadOption};
use super::progress::Progress;
use super::shard::ShardOption;
use super::{Status, Verbosity, terminal};
use clap::Args;
use scanweave::Error;
use scanweave::descriptor::DescriptorKind;
use scanweave::files::{is_same_place, is_within};
use scanweave::pipeline::{self, FeatureSource, Shard};
use scanweave::result_folder::StageFolder;
use std::path::{Path, PathBuf};

/// Compute local features: keypoints, normals and descriptors of every scan.
///
/// Writes <scan>.npz for each scan, with keypoints [n,3] in metres, normals [n,3] and descriptors
/// [n,D] of unit length: what `register --features DIR` reads. The working scale is that of all
/// scans together, as in a registration. What is computed is kept in cache/ of the output folder,
/// so that a stopped run goes on where it was, and `pairs` and `register --described DIR` need not
/// compute it again.
///
/// With --shard only a contiguous part of the scans is described, to the same bytes; files of the shard
/// that are there already are kept.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Scan files, folders of them, globs, or @list.txt with one of these a line.
    #[arg(required = true, value_name = "SCANS")]
    inputs: Vec<String>,
    /// Folder for the features.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace features that the output folder already holds.
    #[arg(long)]
    force: bool,
    /// Convert features made by another program instead: one NPZ a scan, or a folder NAME_desc
    /// beside Keypoints/ as SGHR and IMVR publish them.
    #[arg(long, value_name = "DIR")]
    features: Option<PathBuf>,
    /// Where computed features are kept. Default: cache/ in the output folder.
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    #[command(flatten)]
    shard: ShardOption,
    #[command(flatten)]
    reading: ReadingOptions,
    #[command(flatten)]
    threads: ThreadOption,
    #[command(flatten)]
    settings: SettingOptions,
}

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let mut config = arguments.settings.config()?;
    arguments.reading.format.apply(&mut config.input)?;
    let shard = arguments.shard.shard()?;
    let folder = StageFolder::open(&arguments.output, shard)?;
    arguments.threads.start()?;
    let progress = Progress::start(verbosity)?;
    // Features, which could pass for clouds.
    let is_own =
        |file: &Path| file.extension().is_some_and(|e| e == "npz") && is_within(file, &arguments.output);
    let scans = arguments.reading.read(&arguments.inputs, &config.input, &progress, verbosity, is_own)?;
    refuse_given(arguments)?;
    let given = match &arguments.features {
        Some(place) => {
            config.descriptor.kind = DescriptorKind::Precomputed;
            config.descriptor.checkpoint = None;
            Some(pipeline::read_features(place, &scans, &config.input, &progress)?)
        }
        None => None,
    };
    let cache = arguments.cache.clone().unwrap_or_else(|| folder.cache());
    let source = match &given {
        Some(features) => FeatureSource::Given(features),
        None if config.output.feature_cache => FeatureSource::Cached(&cache),
        None => FeatureSource::Computed,
    };
    let described = folder.describe(&scans, &config, &source, arguments.force, &progress)?;
    let scans = &scans[described.scans.clone()];
    if !verbosity.quiet {
        let keypoints: usize = described.features.iter().map(|f| f.len()).sum();
        let dim = described.features.iter().map(|f| f.descriptors.dim()).max().unwrap_or(0);
        let reused = described.reused.iter().filter(|r| **r).count();
        if shard != Shard::WHOLE {
            terminal::print_line(&format!("shard {shard}"))?;
        }
        terminal::print_line(&format!(
            "{} of {} scans, {keypoints} keypoints with {dim} values each, {reused} not computed now",
            config.descriptor.descriptor_name(),
            scans.len()
        ))?;
        for (scan, _) in scans.iter().zip(&described.features).filter(|(_, f)| f.is_empty()) {
            terminal::print_line(&format!("{}: no keypoint: too few points near each other", scan.name))?;
        }
        terminal::print_line(&format!("written  {}", arguments.output.display()))?;
    }
    Ok(Status::Success)
}

/// Declines to write over the features that are converted.
fn refuse_given(arguments: &Arguments) -> Result<(), Error> {
    let Some(given) = arguments.features.as_ref().filter(|f| is_same_place(f, &arguments.output)) else {
        return Ok(());
    };
    let (expected, remedy) =
        ("another folder than that of the result", "choose another folder with --output");
    Err(Error::setting("--features", given.display().to_string(), expected, remedy))
}
