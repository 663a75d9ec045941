//! The `scanweave` command: parse, dispatch, exit code.
#![forbid(unsafe_code)]

mod cli;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments = cli::Cli::try_parse().unwrap_or_else(|error| cli::terminal::exit_with_usage(&error));
    cli::logging::start(&arguments.verbosity);
    match cli::start().and_then(|()| cli::run(arguments)) {
        Ok(status) => status.into(),
        Err(error) => {
            cli::terminal::print_error(&error);
            cli::Status::of(&error).into()
        }
    }
}
