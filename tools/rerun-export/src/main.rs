//! `scanweave-rerun RESULT -o FILE.rrd`.

use anyhow::{Context, Result, bail};
use lexopt::prelude::*;
use scanweave_rerun::export;
use std::path::PathBuf;
use std::process::ExitCode;

const HELP: &str = "\
Turn a result of `scanweave register` into a recording for the Rerun viewer

Usage: scanweave-rerun RESULT -o FILE.rrd

Arguments:
  RESULT             Output folder of `scanweave register`
Options:
  -o, --output FILE  The recording; open it with `rerun FILE`
  -h, --help         Print help
  -V, --version      Print version";

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<()> {
    let (mut result, mut output) = (None, None);
    let mut parser = lexopt::Parser::from_env();
    while let Some(argument) = parser.next()? {
        match argument {
            Short('h') | Long("help") => {
                println!("{HELP}");
                return Ok(());
            }
            Short('V') | Long("version") => {
                println!("scanweave-rerun {}", env!("CARGO_PKG_VERSION"));
                return Ok(());
            }
            Short('o') | Long("output") => output = Some(PathBuf::from(parser.value()?)),
            Value(folder) if result.is_none() => result = Some(PathBuf::from(folder)),
            other => bail!("{}; see --help", other.unexpected()),
        }
    }
    let result = result.context("name the output folder of `scanweave register`; see --help")?;
    let output = output.context("name the file to write with -o FILE.rrd")?;
    let written = export(&result, &output)?;
    println!(
        "{} scans placed, {} left out, {} points; written  {}",
        written.placed,
        written.declined,
        written.points,
        output.display()
    );
    Ok(())
}
