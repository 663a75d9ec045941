//! `scanweave inspect`.

use super::options::FormatOptions;
use super::{Status, Verbosity, outcome, terminal};
use clap::Args;
use scanweave::io::ReadOptions;
use scanweave::report::inspect::{self, Finding};
use std::path::PathBuf;

/// Tell what is in scans, features, checkpoints and results: sizes, ranges, metadata.
///
/// Takes scan files of every format that `register` reads, features (NPZ), checkpoints
/// (safetensors, ours or others'), output folders of `register`, and folders of any of these but
/// the last. A file that cannot be read, or is damaged, is an error.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Files and folders.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    reading: FormatOptions,
    /// Print one JSON document instead of tables.
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let mut options = ReadOptions::default();
    arguments.reading.apply(&mut options)?;
    let found: Vec<Vec<Finding>> =
        arguments.paths.iter().map(|p| inspect::inspect(p, &options)).collect::<scanweave::Result<_>>()?;
    let found = found.concat();
    if arguments.json {
        terminal::print_json(&format!("{}\n", serde_json::to_string_pretty(&found)?))?;
    } else if !verbosity.quiet {
        terminal::print_drawn(&inspect::text(&found, outcome::width()))?;
    }
    Ok(Status::Success)
}
