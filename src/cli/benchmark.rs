//! `scanweave benchmark`.

use super::options::ThreadOption;
use super::progress::Progress;
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
    /// Compute only part I of N, counted from 0. Default: the task of a SLURM job array
    /// (SLURM_ARRAY_TASK_ID, _MIN, _STEP, _COUNT), or of an indexed job
    /// (JOB_COMPLETION_INDEX with JOB_COMPLETIONS), else everything.
    #[arg(long, value_name = "I/N", value_parser = parse_shard)]
    shard: Option<Shard>,
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
    let shard = match arguments.shard {
        Some(shard) => shard,
        None => shard_of_environment(|name| std::env::var(name).ok())?,
    };
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

fn parse_shard(text: &str) -> Result<Shard, String> {
    let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    match parts {
        Some((index, count)) if index < count => Ok(Shard { index, count }),
        _ => Err("expected I/N with I from 0 to N - 1, as in 0/4".to_owned()),
    }
}

/// The shard that a cluster's scheduler asks this process for.
fn shard_of_environment(variable: impl Fn(&str) -> Option<String>) -> Result<Shard, Error> {
    let number = |name: &str| -> Result<Option<usize>, Error> {
        variable(name)
            .map(|text| {
                let remedy = "unset it, or pass --shard I/N";
                text.trim()
                    .parse()
                    .map_err(|_| Error::setting(name, format!("`{text}`"), "a whole number", remedy))
            })
            .transpose()
    };
    let (index, count, name) = if let Some(id) = number("SLURM_ARRAY_TASK_ID")? {
        let least = number("SLURM_ARRAY_TASK_MIN")?.unwrap_or(0);
        let step = number("SLURM_ARRAY_TASK_STEP")?.unwrap_or(1).max(1);
        (id.saturating_sub(least) / step, number("SLURM_ARRAY_TASK_COUNT")?, "SLURM_ARRAY_TASK_COUNT")
    } else if let Some(index) = number("JOB_COMPLETION_INDEX")? {
        (index, number("JOB_COMPLETIONS")?, "JOB_COMPLETIONS")
    } else {
        return Ok(Shard::WHOLE);
    };
    match count {
        Some(count) if index < count => Ok(Shard { index, count }),
        found => Err(Error::setting(
            name,
            found.map_or("nothing".to_owned(), |n| n.to_string()),
            format!("the number of tasks, more than this task's place {index}"),
            "set it, or pass --shard I/N",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shard(variables: &[(&str, &str)]) -> Result<Shard, Error> {
        let find = |name: &str| variables.iter().find(|v| v.0 == name).map(|v| v.1.to_owned());
        shard_of_environment(find)
    }

    #[test]
    fn schedulers_name_the_shard() {
        assert_eq!(shard(&[]).unwrap(), Shard::WHOLE);
        // An array of tasks 1, 3, 5 (--array=1-5:2): the last is number 2 of 3.
        let slurm = [
            ("SLURM_ARRAY_TASK_ID", "5"),
            ("SLURM_ARRAY_TASK_MIN", "1"),
            ("SLURM_ARRAY_TASK_STEP", "2"),
            ("SLURM_ARRAY_TASK_COUNT", "3"),
        ];
        assert_eq!(shard(&slurm).unwrap(), Shard { index: 2, count: 3 });
        let job = [("JOB_COMPLETION_INDEX", "3"), ("JOB_COMPLETIONS", "4")];
        assert_eq!(shard(&job).unwrap(), Shard { index: 3, count: 4 });
        assert!(shard(&job[..1]).unwrap_err().to_string().contains("JOB_COMPLETIONS"));
        let late = [("JOB_COMPLETION_INDEX", "4"), ("JOB_COMPLETIONS", "4")];
        assert!(shard(&late).is_err());
    }

    #[test]
    fn shards_are_counted_from_zero() {
        assert_eq!(parse_shard("0/4").unwrap(), Shard { index: 0, count: 4 });
        for bad in ["4/4", "1", "a/b", "-1/2", "0/0"] {
            assert!(parse_shard(bad).is_err(), "{bad}");
        }
    }
}
