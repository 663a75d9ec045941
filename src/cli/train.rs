//! `scanweave train`, `scanweave train descriptor` and `scanweave train verifier`.

use super::options::ThreadOption;
use super::progress::Progress;
use super::{Status, Verbosity, terminal};
use clap::{Args, Subcommand};
use scanweave::Error;
use scanweave::evaluation::retrieval_scores::RetrievalScores;
use scanweave::files::{self, FolderLock};
use scanweave::pipeline::FeatureSource;
use scanweave::report::chart::{self, Panel, Series};
use scanweave::training::descriptor::DescriptorRecipe;
use scanweave::training::overlap_head::{Record, TrainReport, train};
use scanweave::training::run_folder;
use scanweave::training::verifier::{VerifierRecipe, VerifierReport};
use scanweave::training::{self, Recipe, mini_spin_net};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Train an overlap head on posed scans; `train descriptor` trains a local descriptor, and `train
/// verifier` the weights of the verification.
///
/// The recipe names settings and data: folders of posed scans, walks with a depth camera, and
/// synthetic buildings. Writes best.safetensors (for --checkpoint of `register`) and
/// last.safetensors (after every epoch, for --resume), metrics.jsonl, curves.svg and recipe.toml
/// into the output folder, and keeps features in its cache/. Stopped at any moment, the last
/// complete checkpoint is intact.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Arguments {
    #[command(subcommand)]
    other: Option<Other>,
    #[command(flatten)]
    head: RunOptions,
}

#[derive(Debug, Subcommand)]
enum Other {
    Descriptor(DescriptorArguments),
    Verifier(VerifierArguments),
}

/// Train the weights that turn the evidence of a relative pose into a probability.
///
/// The recipe names kinds of scans: folders with true poses, and synthetic places. Every pose that a
/// registration considers for two scans is a candidate. Prints a table with every kind judged by
/// the given weights and by those learned from all other kinds, and how reliable the latter's
/// probabilities are. Writes verifier.json (weights, data and tables), reliability.svg and recipe.toml
/// into the output folder when all is done.
#[derive(Debug, Args)]
struct VerifierArguments {
    /// Recipe (TOML); an unknown key is an error.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Folder for the result.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Where the folders of the recipe lie. Default: the folder of the recipe.
    #[arg(long, value_name = "DIR")]
    data_root: Option<PathBuf>,
    /// Replace the result that the output folder already holds.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    threads: ThreadOption,
}

/// Train a local descriptor on posed scans.
///
/// The recipe names settings and data as for an overlap head. Writes best.safetensors (for the
/// setting descriptor.checkpoint), last.safetensors (for --resume), metrics.jsonl and recipe.toml
/// into the output folder, and at the end curves.svg and final.safetensors (the network after the last
/// step, for the same setting). Stopped at any moment, the last complete
/// checkpoint is intact.
#[derive(Debug, Args)]
struct DescriptorArguments {
    #[command(flatten)]
    run: RunOptions,
}

/// What a run needs.
#[derive(Debug, Args)]
struct RunOptions {
    /// Recipe (TOML); an unknown key is an error.
    // An option only because a subcommand takes its place.
    #[arg(long, value_name = "FILE", required = true)]
    config: Option<PathBuf>,
    /// Folder for the run.
    #[arg(short, long, value_name = "DIR", required = true)]
    output: Option<PathBuf>,
    /// Go on from the last checkpoint in the output folder; anew where the run had none yet.
    #[arg(long, conflicts_with = "force")]
    resume: bool,
    /// Replace the run that the output folder already holds.
    #[arg(long)]
    force: bool,
    /// Where relative folders of the recipe lie. Default: the folder of the recipe.
    #[arg(long, value_name = "DIR")]
    data_root: Option<PathBuf>,
    /// Where features are kept, to share them between runs. Default: cache/ in the output folder.
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    #[command(flatten)]
    threads: ThreadOption,
}

impl RunOptions {
    fn config(&self) -> &Path {
        self.config.as_deref().unwrap_or(Path::new(""))
    }

    fn output(&self) -> &Path {
        self.output.as_deref().unwrap_or(Path::new(""))
    }

    /// Where relative folders of the recipe lie.
    fn data_root(&self) -> &Path {
        self.data_root.as_deref().unwrap_or(self.config().parent().unwrap_or(Path::new("")))
    }

    /// Writes the recipe beside the run, and removes an old one where that was asked for.
    fn begin(&self, recipe: &str) -> Result<(), Error> {
        files::write(&self.output().join(run_folder::RECIPE), |out| out.write_all(recipe.as_bytes()))?;
        if self.force { remove_old_run(self.output()) } else { Ok(()) }
    }
}

pub fn run(arguments: Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    match arguments.other {
        Some(Other::Descriptor(descriptor)) => train_descriptor(&descriptor.run, verbosity),
        Some(Other::Verifier(verifier)) => train_verifier(&verifier, verbosity),
        None => train_head(&arguments.head, verbosity),
    }
}

fn train_head(options: &RunOptions, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let recipe = Recipe::load(options.config())?;
    let (_lock, resume) = open(options)?;
    options.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let cache = options.cache.clone().unwrap_or_else(|| options.output().join("cache"));
    let data = training::load(&recipe, options.data_root(), &FeatureSource::Cached(&cache), &progress)?;
    options.begin(&recipe.to_toml()?)?;
    let report = train(&data, &recipe.train, options.output(), resume, &progress)?;
    if !verbosity.quiet {
        print(&report, recipe.train.recall_k)?;
    }
    Ok(Status::Success)
}

fn train_descriptor(options: &RunOptions, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let recipe = DescriptorRecipe::load(options.config())?;
    let (_lock, resume) = open(options)?;
    options.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let data = training::descriptor::load(&recipe, options.data_root(), &progress)?;
    options.begin(&recipe.to_toml()?)?;
    let report = mini_spin_net::train(&data, &recipe.train, options.output(), resume, &progress)?;
    write_curves(&options.output().join(run_folder::CURVES), &report.records)?;
    if !verbosity.quiet {
        for record in report.records.iter().filter(|r| r.accuracy.is_some()) {
            terminal::print_line(&format!(
                "step {:>6}  loss {:>7.4}  accuracy {:.3}  {:.0} ms a step",
                record.step,
                record.loss,
                record.accuracy.unwrap_or_default(),
                record.step_ms
            ))?;
        }
        terminal::print_line(&format!("written  {}", report.best.display()))?;
    }
    Ok(Status::Success)
}

fn train_verifier(arguments: &VerifierArguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let recipe = VerifierRecipe::load(&arguments.config)?;
    let folder = &arguments.output;
    let _lock = FolderLock::take(folder)?;
    let [verifier, ..] = VerifierReport::FILES;
    if folder.join(verifier).exists() && !arguments.force {
        return Err(Error::OutputExists { path: folder.clone() }.into());
    }
    arguments.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let beside = arguments.config.parent().unwrap_or(Path::new(""));
    let root = arguments.data_root.as_deref().unwrap_or(beside);
    let report = training::verifier::train(&recipe, root, &progress)?;
    report.write(folder)?;
    if !verbosity.quiet {
        terminal::print(&report.table())?;
        terminal::print_line(&format!("written  {}", folder.join(verifier).display()))?;
    }
    Ok(Status::Success)
}

/// Loss, and accuracy on the validation scenes, over the steps.
fn write_curves(path: &Path, records: &[mini_spin_net::Record]) -> Result<(), Error> {
    let panel = |title: &str, y_label: &str, points: Vec<(f64, f64)>| Panel {
        title: title.to_owned(),
        x_label: "steps".to_owned(),
        y_label: y_label.to_owned(),
        x_names: Vec::new(),
        series: vec![Series { name: "this descriptor".to_owned(), points, line: true, spread: Vec::new() }],
        y_most: 0.0,
    };
    let losses = records.iter().map(|r| (r.step as f64, r.loss)).collect();
    let right = records.iter().filter_map(|r| Some((r.step as f64, r.accuracy?))).collect();
    let panels = [
        panel("training loss", "loss", losses),
        panel("validation", "patches whose counterpart is nearest", right),
    ];
    files::write(path, |out| out.write_all(chart::svg(&panels)?.as_bytes()))
}

/// Makes the folder and locks it, or refuses it before hours are spent on features; and whether there is a
/// checkpoint to go on from.
fn open(arguments: &RunOptions) -> Result<(FolderLock, bool), Error> {
    let folder = arguments.output();
    let existed = folder.is_dir();
    let lock = FolderLock::take(folder)?;
    let held = [run_folder::BEST, run_folder::LAST].iter().any(|name| folder.join(name).exists());
    if held && !arguments.resume && !arguments.force {
        return Err(Error::OutputExists { path: folder.to_path_buf() });
    }
    let last = folder.join(run_folder::LAST);
    let resume = arguments.resume && last.exists();
    if arguments.resume && !resume {
        // A folder without any checkpoint is that of a run which was stopped before its first.
        if held || !existed {
            return Err(Error::file(
                last,
                "no such file",
                "the checkpoint of a run to go on from",
                "name the folder of that run, or start one without --resume (with --force where one is held)",
            ));
        }
        tracing::warn!("{}: no checkpoint to go on from: the run starts anew", folder.display());
    }
    Ok((lock, resume))
}

fn remove_old_run(folder: &Path) -> Result<(), Error> {
    for name in run_folder::OF_A_RUN {
        let path = folder.join(name);
        match std::fs::remove_file(&path) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(Error::write(path, e)),
            _ => {}
        }
    }
    Ok(())
}

fn print(report: &TrainReport, k: usize) -> Result<(), Error> {
    let mut rows: Vec<(String, RetrievalScores)> = Vec::new();
    let mut best: Option<(usize, RetrievalScores)> = None;
    for record in &report.records {
        match record {
            Record::Baseline { name, validation } => rows.push((name.clone(), validation.mean)),
            Record::Epoch { epoch, validation: Some(v), .. }
                if best.is_none_or(|(_, b)| v.mean.spearman > b.spearman) =>
            {
                best = Some((*epoch, v.mean));
            }
            Record::Epoch { .. } => {}
        }
    }
    rows.extend(best.map(|(epoch, scores)| (format!("trained, epoch {epoch}"), scores)));
    if !rows.is_empty() {
        let head = format!("recall@{k} of overlap");
        terminal::print_line(&format!("{:<22} {:>8} {:>8}  {head}", "validation scenes", "Spearman", "MAE"))?;
        terminal::print_line(&format!("{:<22} {:>8} {:>8}  {:>8} {:>8}", "", "", "", "> 0.3", "> 0.1"))?;
        for (name, s) in &rows {
            terminal::print_line(&format!(
                "{name:<22} {:>8.3} {:>8.3}  {:>8.3} {:>8.3}",
                s.spearman, s.mae, s.recall_overlap_30, s.recall_overlap_10
            ))?;
        }
    }
    terminal::print_line(&format!(
        "steps    {} of {:.0} ms, {:.1} % of it outside the network",
        report.steps,
        report.step_ms,
        100.0 * report.outside_share
    ))?;
    terminal::print_line(&format!("written  {}", report.best.display()))
}
