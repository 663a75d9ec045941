//! `scanweave pairs`.

use super::progress::Progress;
use super::registration_options::RegistrationOptions;
use super::shard::ShardOption;
use super::{Status, Verbosity, terminal};
use clap::Args;
use scanweave::files::is_within;
use scanweave::result_folder::StageFolder;
use std::path::{Path, PathBuf};

/// Register the pairs that a registration begins with, or a part of them.
///
/// The second of three stages that may run on several machines: `describe`, `pairs`, and
/// `register --described DIR --pairs DIR`, which gives the same result as `register` alone. All
/// stages take the same scans and settings. Writes pairs-I-of-N.npz; one that is there already, whole
/// and of these scans and settings, is kept. For the agglomerative method, the default.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folder for the pairs, the same for all shards.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace pairs of other scans or settings.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    shard: ShardOption,
    #[command(flatten)]
    registration: RegistrationOptions,
}

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let options = &arguments.registration;
    let config = options.config([])?;
    let shard = arguments.shard.shard()?;
    let folder = StageFolder::open(&arguments.output, shard)?;
    options.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let is_own = |file: &Path| is_within(file, folder.path());
    let mut scans = options.read(&config, &progress, verbosity, is_own)?;
    options.give_poses(&mut scans)?;
    let source = options.source(&scans, &config, &folder.cache(), &progress)?;
    let done = folder.register_pairs(&scans, &config, &source.features(), arguments.force, &progress)?;
    if !verbosity.quiet {
        let kept = if done.reused { ", which were there" } else { "" };
        terminal::print_line(&format!(
            "shard {shard}: {} of {} pairs of {} scans{kept}",
            done.pairs,
            done.planned,
            scans.len()
        ))?;
        terminal::print_line(&format!("written  {}", done.path.display()))?;
    }
    Ok(Status::Success)
}
