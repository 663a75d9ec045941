//! `scanweave register`.

use super::export::ExportOptions;
use super::options::{PriorOptions, ReadingOptions, SettingOptions, ThreadOption, word};
use super::progress::Progress;
use super::{Status, Verbosity, outcome, terminal};
use clap::Args;
use scanweave::Error;
use scanweave::config::{Config, Method};
use scanweave::descriptor::DescriptorKind;
use scanweave::files::is_within;
use scanweave::pipeline::{self, FeatureSource, PairCache, Stopwatch};
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
    /// Scan files, folders of them, globs, or @list.txt with one of these a line.
    #[arg(required = true, value_name = "SCANS")]
    inputs: Vec<String>,
    /// Folder for the result.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace the result that the output folder already holds.
    #[arg(long)]
    force: bool,
    /// Print one JSON document on stdout instead of the table.
    #[arg(long)]
    json: bool,
    /// Folder of features made by another program: one NPZ a scan, named like the scan, or a
    /// folder NAME_desc beside Keypoints/ as SGHR and IMVR publish them.
    #[arg(long, value_name = "DIR")]
    features: Option<PathBuf>,
    /// Trained overlap head; the same as retrieval.checkpoint.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// How scans are registered: agglomerative or incremental, or all pairs first and then all poses
    /// at once (eigse3, l1-irls, rotavg, lits, hara, sghr, pose-graph).
    #[arg(long, value_name = "NAME", value_parser = method)]
    method: Option<MethodChoice>,
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
    prior: PriorOptions,
    #[command(flatten)]
    reading: ReadingOptions,
    #[command(flatten)]
    threads: ThreadOption,
    #[command(flatten)]
    exports: ExportOptions,
    #[command(flatten)]
    settings: SettingOptions,
}

pub fn run(arguments: Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let config = effective_config(&arguments)?;
    let folder = ResultFolder::open(&arguments.output, arguments.force)?;
    arguments.threads.start()?;
    let progress = Progress::start(verbosity)?;

    let mut clock = Stopwatch::default();
    let is_own = |file: &Path| is_within(file, &folder.cache());
    let (reading, inputs) = (&arguments.reading, &arguments.inputs);
    let mut scans =
        clock.time("reading", || reading.read(inputs, &config.input, &progress, verbosity, is_own))?;
    folder.refuse_inputs(&scans)?;
    arguments.prior.give(&mut scans)?;
    let given = match &arguments.features {
        Some(place) => Some(
            clock.time("features", || pipeline::read_features(place, &scans, &config.input, &progress))?,
        ),
        None => None,
    };
    let cache = folder.cache();
    let source = match &given {
        Some(features) => FeatureSource::Given(features),
        None if config.output.feature_cache => FeatureSource::Cached(&cache),
        None => FeatureSource::Computed,
    };
    let pairs =
        if config.output.feature_cache { PairCache::in_folder(&cache) } else { PairCache::in_memory() };
    let run = pipeline::run_with_pairs(&scans, &config, &source, &pairs, &progress)?;
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

/// A method as the settings that choose it, key=value.
#[derive(Debug, Clone)]
struct MethodChoice(Vec<String>);

fn method(name: &str) -> Result<MethodChoice, String> {
    const NAMES: &str =
        "expected agglomerative, incremental, eigse3, l1-irls, rotavg, lits, hara, sghr or pose-graph";
    let settings = match name {
        "agglomerative" | "incremental" => {
            vec!["method=multiview".to_owned(), format!("registration.strategy.kind={name}")]
        }
        _ => vec![format!("method={}", word::<Method>(name).map_err(|_| NAMES.to_owned())?)],
    };
    Ok(MethodChoice(settings))
}

fn effective_config(arguments: &Arguments) -> scanweave::Result<Config> {
    let graph = arguments.graph.map(|graph| format!("synchronization.graph={graph}"));
    let flags: Vec<String> = arguments.method.iter().flat_map(|m| m.0.clone()).chain(graph).collect();
    let mut config = arguments.settings.config_with(&flags)?;
    arguments.reading.format.apply(&mut config.input)?;
    arguments.prior.apply(&mut config)?;
    if arguments.reference.is_some() {
        config.output.reference.clone_from(&arguments.reference);
    }
    if let Some(checkpoint) = &arguments.checkpoint {
        config.retrieval.checkpoint = Some(checkpoint.clone());
    }
    match (&arguments.features, config.descriptor.kind) {
        (Some(_), _) => config.descriptor.kind = DescriptorKind::Precomputed,
        (None, DescriptorKind::Precomputed) => {
            return Err(Error::setting(
                "descriptor.kind",
                "precomputed, without a folder to read from",
                "--features DIR with it",
                "pass --features, or set another kind",
            ));
        }
        (None, _) => {}
    }
    Ok(config)
}
