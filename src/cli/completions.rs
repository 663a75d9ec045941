//! `scanweave completions`.

use super::{Cli, Status, terminal};
use clap::{Args, CommandFactory};
use clap_complete::Shell;

/// Print the completion script of a shell.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The shell.
    shell: Shell,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<Status> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut Cli::command(), "scanweave", &mut script);
    terminal::print_drawn(&String::from_utf8_lossy(&script))?;
    Ok(Status::Success)
}
