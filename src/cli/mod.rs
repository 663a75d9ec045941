//! The command line: arguments → typed options → library call → print.
//! One file a subcommand; `clap`, `anyhow` and printing live only here.
//! [`main`] is the whole command: `main.rs` and the Python package call it.
// Docs of arguments are the command's help, where `<scan>` stands for a name.
#![allow(rustdoc::invalid_html_tags)]

mod benchmark;
mod completions;
mod config;
mod demo;
mod describe;
mod diagnose;
mod evaluate;
mod evaluate_page;
mod evaluate_retrieval;
mod evaluate_set;
mod evaluate_text;
mod export;
mod fuse;
mod ground_truth;
#[cfg(feature = "training")]
mod import_weights;
mod inspect;
mod interrupt;
mod logging;
mod man;
mod options;
mod outcome;
mod pairs;
mod progress;
mod register;
mod registration_options;
mod report;
mod sample;
mod shard;
mod status;
mod synth;
mod terminal;
#[cfg(feature = "training")]
mod train;

use status::Status;

use clap::{Args, Parser, Subcommand};
use std::ffi::OsString;

/// Register an unordered collection of partially overlapping 3-D scans into one model.
///
/// Takes any number of scans in any order. Every scan is either placed, with a pose and the
/// evidence for it, or declined, with the reason why.
#[derive(Debug, Parser)]
#[command(name = "scanweave", version, max_term_width = 100, after_help = status::HELP)]
struct Cli {
    #[command(flatten)]
    verbosity: Verbosity,
    /// What to do.
    #[command(subcommand)]
    command: Command,
}

/// How much is said on the terminal.
#[derive(Debug, Args)]
struct Verbosity {
    /// Say more on stderr (-v stages, -vv details); progress bars are then off.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Say nothing but errors: no progress bars, no table.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    Register(register::Arguments),
    Report(report::Arguments),
    Export(export::Arguments),
    Inspect(inspect::Arguments),
    Demo(demo::Arguments),
    Describe(describe::Arguments),
    Pairs(pairs::Arguments),
    Evaluate(evaluate::Arguments),
    Diagnose(diagnose::Arguments),
    EvaluateRetrieval(evaluate_retrieval::Arguments),
    Benchmark(benchmark::Arguments),
    #[cfg(feature = "training")]
    Train(train::Arguments),
    #[cfg(feature = "training")]
    ImportWeights(import_weights::Arguments),
    Synth(synth::Arguments),
    Fuse(fuse::Arguments),
    Sample(sample::Arguments),
    GroundTruth(ground_truth::Arguments),
    Config(config::Arguments),
    Completions(completions::Arguments),
    Man(man::Arguments),
}

/// Runs the command with the arguments of a process, of which the first is the name of the program, and
/// returns its exit code.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let arguments = match Cli::try_parse_from(arguments) {
        Ok(arguments) => arguments,
        Err(error) => return terminal::show_usage(&error),
    };
    logging::start(&arguments.verbosity);
    match start().and_then(|()| run(arguments)) {
        Ok(status) => status as u8,
        Err(error) => {
            terminal::print_error(&error);
            Status::of(&error) as u8
        }
    }
}

/// What is set up once, before any command.
fn start() -> anyhow::Result<()> {
    interrupt::outlive_file_size_limits()
}

/// Runs the chosen command.
fn run(cli: Cli) -> anyhow::Result<Status> {
    match cli.command {
        Command::Register(arguments) => register::run(arguments, &cli.verbosity),
        Command::Report(arguments) => report::run(&arguments, &cli.verbosity),
        Command::Export(arguments) => export::run(&arguments, &cli.verbosity),
        Command::Inspect(arguments) => inspect::run(&arguments, &cli.verbosity),
        Command::Demo(arguments) => demo::run(arguments, &cli.verbosity),
        Command::Describe(arguments) => describe::run(&arguments, &cli.verbosity),
        Command::Pairs(arguments) => pairs::run(&arguments, &cli.verbosity),
        Command::Evaluate(arguments) => evaluate::run(arguments, &cli.verbosity),
        Command::Diagnose(arguments) => diagnose::run(&arguments, &cli.verbosity),
        Command::EvaluateRetrieval(arguments) => evaluate_retrieval::run(arguments, &cli.verbosity),
        Command::Benchmark(arguments) => benchmark::run(arguments, &cli.verbosity),
        #[cfg(feature = "training")]
        Command::Train(arguments) => train::run(arguments, &cli.verbosity),
        #[cfg(feature = "training")]
        Command::ImportWeights(arguments) => import_weights::run(&arguments, &cli.verbosity),
        Command::Synth(arguments) => synth::run(arguments, &cli.verbosity),
        Command::Fuse(arguments) => fuse::run(&arguments, &cli.verbosity),
        Command::Sample(arguments) => sample::run(&arguments, &cli.verbosity),
        Command::GroundTruth(arguments) => ground_truth::run(&arguments, &cli.verbosity),
        Command::Config(arguments) => config::run(arguments),
        Command::Completions(arguments) => completions::run(&arguments),
        Command::Man(arguments) => man::run(&arguments),
    }
}
