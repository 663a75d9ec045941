//! `scanweave register`.

use super::export::ExportOptions;
use super::options::word;
use super::progress::Progress;
use super::registration_options::RegistrationOptions;
use super::{Status, Verbosity, outcome, terminal};
use clap::Args;
use scanweave::config::Config;
use scanweave::files::is_within;
use scanweave::pipeline::{self, PairCache, Stopwatch};
use scanweave::result_folder::ResultFolder;
use scanweave::synchronization::GraphKind;
use std::path::{Path, PathBuf};

/// Register scans: poses with evidence, and one merged cloud.
///
/// Writes report.html (open it in a browser), registration.html (print and sign it), poses.json,
/// trajectory.log, merged.ply, overlap.csv, config.toml and report.json into the output folder, and
/// keeps features and registered pairs in its cache/ so that a second run is faster.
/// Scans that cannot be placed are declined with a reason; the exit code is then still 0. It is
/// 6, after everything is written, when no scan could be joined to another.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folder for the result.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace the result that the output folder already holds.
    #[arg(long)]
    force: bool,
    /// Print one JSON document on stdout instead of the table.
    #[arg(long)]
    json: bool,
    /// Folder of the pairs that `scanweave pairs` registered, every shard of them, with the same
    /// scans and settings. The result is the same.
    #[arg(long, value_name = "DIR")]
    pairs: Option<PathBuf>,
    /// Pairs that a global method registers: full, pruned or sparse; the same as
    /// synchronization.graph.
    #[arg(long, value_name = "KIND", value_parser = word::<GraphKind>)]
    graph: Option<GraphKind>,
    /// Scan that stays where its file has it, by its name. Default: all scans are moved as little as
    /// possible where their files have coordinates in common, else the first scan of each component
    /// stays; the same as output.reference.
    #[arg(long, value_name = "SCAN")]
    reference: Option<String>,
    #[command(flatten)]
    registration: RegistrationOptions,
    #[command(flatten)]
    exports: ExportOptions,
}

pub fn run(arguments: Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let options = &arguments.registration;
    let config = effective_config(&arguments)?;
    let folder = ResultFolder::open(&arguments.output, arguments.force)?;
    options.threads.start()?;
    let progress = Progress::start(verbosity)?;

    let mut clock = Stopwatch::default();
    let is_own = |file: &Path| is_within(file, &folder.cache());
    let mut scans = clock.time("reading", || options.read(&config, &progress, verbosity, is_own))?;
    folder.refuse_inputs(&scans)?;
    options.give_poses(&mut scans)?;
    let cache = folder.cache();
    let source = clock.time("features", || options.source(&scans, &config, &cache, &progress))?;
    let pairs =
        if config.output.feature_cache { PairCache::in_folder(&cache) } else { PairCache::in_memory() };
    let (features, shards) = (source.features(), arguments.pairs.as_deref());
    let run = pipeline::run_with_shards(&scans, &config, &features, &pairs, shards, &progress)?;
    outcome::warn(&run, &scans);
    let written = folder.write(&scans, &run, &config, &arguments.exports.exports(), clock, &progress)?;

    if arguments.json {
        terminal::print_json(&written.to_json(folder.path()))?;
    } else if !verbosity.quiet {
        terminal::print_drawn(&outcome::table(&written.report))?;
        terminal::print_line(&format!("written  {}", folder.path().display()))?;
    }
    Ok(outcome::status(&run.reconstruction))
}

fn effective_config(arguments: &Arguments) -> scanweave::Result<Config> {
    let graph = arguments.graph.map(|graph| format!("synchronization.graph={graph}"));
    let mut config = arguments.registration.config(graph)?;
    if arguments.reference.is_some() {
        config.output.reference.clone_from(&arguments.reference);
    }
    Ok(config)
}
