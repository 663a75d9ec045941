//! `scanweave benchmark`.

use super::options::ThreadOption;
use super::progress::Progress;
use super::shard::ShardOption;
use super::{Status, Verbosity, terminal};
use clap::{Args, Subcommand};
use scanweave::benchmark::table::{self, Table};
use scanweave::benchmark::{self, Options, Plan, Shard, Suite, output};
use scanweave::files::FolderLock;
use scanweave::{Error, Monitor};
use std::path::{Path, PathBuf};

/// Run a whole suite of benchmarks and write its tables.
///
/// A suite (TOML, see configs/suites/) names data sets, methods, keypoint counts and seeds. Every
/// combination with a scene is a cell; its result is one file in OUTPUT/cells, features are kept
/// in OUTPUT/cache. Cells that exist and are still valid are not computed again, so that a run
/// stopped at any moment goes on when it is started again. Writes table.md, table.csv, table.json,
/// cells.csv, plots and report.html, a page with all of them for any browser.
///
/// Registration recall is told twice: within all components of a scene ("recall", "pooled"), where a
/// pair counts when both scans are in one component, and in its largest component alone ("in largest").
///
/// A cell's wall time is that of its stages with all threads, unless --jobs shares them out. Its
/// memory is the peak of the process while it worked on the cell, scans and features included.
///
/// `benchmark merge` joins the outputs of the parts that --shard made.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Arguments {
    #[command(subcommand)]
    action: Option<Action>,
    #[command(flatten)]
    run: RunArguments,
}

#[derive(Debug, Subcommand)]
enum Action {
    Merge(MergeArguments),
}

/// Join the cells of several output folders of one suite and write its tables.
#[derive(Debug, Args)]
struct MergeArguments {
    /// Output folders of the parts.
    #[arg(required = true, value_name = "DIR")]
    parts: Vec<PathBuf>,
    /// Folder for all cells and the tables; may be one of the parts.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

#[derive(Debug, Args)]
struct RunArguments {
    /// The suite.
    #[arg(long, value_name = "FILE", required = true)]
    suite: Option<PathBuf>,
    /// Folder for cells and tables.
    #[arg(short, long, value_name = "DIR", required = true)]
    output: Option<PathBuf>,
    /// Folder that the suite's paths start from.
    #[arg(long, value_name = "DIR", default_value = ".")]
    data_root: PathBuf,
    /// Cells to compute at the same time, each with its share of the threads.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    jobs: u16,
    #[command(flatten)]
    shard: ShardOption,
    /// Keep cells that another build of this program computed.
    #[arg(long)]
    any_build: bool,
    #[command(flatten)]
    threads: ThreadOption,
}

pub fn run(arguments: Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let run = &arguments.run;
    match (&arguments.action, &run.suite, &run.output) {
        (Some(Action::Merge(parts)), ..) => merge(parts, verbosity),
        (None, Some(suite), Some(output)) => compute(suite, output, run, verbosity),
        // Ruled out by the arguments' own rules.
        _ => Ok(Status::Success),
    }
}

fn compute(
    suite: &Path,
    output: &Path,
    arguments: &RunArguments,
    verbosity: &Verbosity,
) -> anyhow::Result<Status> {
    let suite = Suite::load(suite)?;
    let shard = arguments.shard.shard()?;
    // Parts of a suite never compute the same cell: they may share a folder.
    let _lock = match shard == Shard::WHOLE {
        true => FolderLock::take(output)?,
        false => FolderLock::take_shared(output)?,
    };
    arguments.threads.start()?;
    let progress = Progress::start(verbosity)?;
    let build = build();
    let options = Options {
        data_root: &arguments.data_root,
        output,
        jobs: usize::from(arguments.jobs),
        shard,
        build: &build,
        any_build: arguments.any_build,
    };
    let done = benchmark::run(&suite, &options, &progress)?;
    progress.check("writing the tables")?;
    let text = write_tables(output, &suite, &done.plan)?;
    if !verbosity.quiet {
        terminal::print(&text)?;
        let (computed, kept) = (done.computed, done.kept);
        let written = output.display();
        terminal::print_line(&format!("computed {computed} cells, {kept} were there; written  {written}"))?;
    }
    Ok(Status::Success)
}

fn merge(arguments: &MergeArguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let _lock = FolderLock::take(&arguments.output)?;
    let merged = benchmark::merge(&arguments.parts, &arguments.output)?;
    let text = write_tables(&arguments.output, &merged.suite, &merged.plan)?;
    if merged.builds.len() > 1 {
        tracing::warn!("the cells come from {} different builds of this program", merged.builds.len());
    }
    if !verbosity.quiet {
        terminal::print(&text)?;
        let (all, missing) = (merged.plan.cells.len(), merged.missing);
        let written = arguments.output.display();
        terminal::print_line(&format!("{} of {all} cells; written  {written}", all - missing))?;
    }
    Ok(Status::Success)
}

fn write_tables(output: &Path, suite: &Suite, plan: &Plan) -> Result<String, Error> {
    let cells = table::read_cells(output, plan)?;
    output::write(output, suite, plan, &Table::new(suite, plan, &cells), &cells)
}

/// Digest of this very program, so that its cells are told from those of another build.
fn build() -> String {
    let program = std::env::current_exe().and_then(std::fs::read);
    program.map_or("unknown".to_owned(), |bytes| blake3::hash(&bytes).to_hex()[..16].to_owned())
}
