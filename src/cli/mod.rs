//! The command line: arguments → typed options → library call → print.
//! One file a subcommand; `clap`, `anyhow` and printing live only here.

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
mod evaluate_truth;
mod export;
mod fuse;
mod ground_truth;
mod import_weights;
mod inspect;
mod interrupt;
pub mod logging;
mod man;
mod options;
mod outcome;
mod progress;
mod register;
mod report;
mod result_folder;
mod sample;
mod status;
mod synth;
pub mod terminal;
mod train;

pub use status::Status;

use clap::{Args, Parser, Subcommand};

/// Register an unordered collection of partially overlapping 3-D scans into one model.
///
/// Takes any number of scans in any order. Every scan is either placed, with a pose and the
/// evidence for it, or declined, with the reason why.
#[derive(Debug, Parser)]
#[command(name = "scanweave", version, max_term_width = 100, after_help = status::HELP)]
pub struct Cli {
    #[command(flatten)]
    pub verbosity: Verbosity,
    /// What to do.
    #[command(subcommand)]
    command: Command,
}

/// How much is said on the terminal.
#[derive(Debug, Args)]
pub struct Verbosity {
    /// Say more on stderr (-v stages, -vv details); progress bars are then off.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Say nothing but errors: no progress bars, no table.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    Register(register::Arguments),
    Report(report::Arguments),
    Export(export::Arguments),
    Inspect(inspect::Arguments),
    Demo(demo::Arguments),
    Describe(describe::Arguments),
    Evaluate(evaluate::Arguments),
    Diagnose(diagnose::Arguments),
    EvaluateRetrieval(evaluate_retrieval::Arguments),
    Benchmark(benchmark::Arguments),
    Train(train::Arguments),
    ImportWeights(import_weights::Arguments),
    Synth(synth::Arguments),
    Fuse(fuse::Arguments),
    Sample(sample::Arguments),
    GroundTruth(ground_truth::Arguments),
    Config(config::Arguments),
    Completions(completions::Arguments),
    Man(man::Arguments),
}

/// What is set up once, before any command.
pub fn start() -> anyhow::Result<()> {
    interrupt::outlive_file_size_limits()
}

/// Runs the chosen command.
pub fn run(cli: Cli) -> anyhow::Result<Status> {
    match cli.command {
        Command::Register(arguments) => register::run(arguments, &cli.verbosity),
        Command::Report(arguments) => report::run(&arguments, &cli.verbosity),
        Command::Export(arguments) => export::run(&arguments, &cli.verbosity),
        Command::Inspect(arguments) => inspect::run(&arguments, &cli.verbosity),
        Command::Demo(arguments) => demo::run(arguments, &cli.verbosity),
        Command::Describe(arguments) => describe::run(&arguments, &cli.verbosity),
        Command::Evaluate(arguments) => evaluate::run(arguments, &cli.verbosity),
        Command::Diagnose(arguments) => diagnose::run(&arguments, &cli.verbosity),
        Command::EvaluateRetrieval(arguments) => evaluate_retrieval::run(arguments, &cli.verbosity),
        Command::Benchmark(arguments) => benchmark::run(arguments, &cli.verbosity),
        Command::Train(arguments) => train::run(arguments, &cli.verbosity),
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
