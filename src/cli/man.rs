//! `scanweave man`.

use super::{Cli, Status, terminal};
use clap::{Args, CommandFactory};
use scanweave::Error;
use std::path::PathBuf;

/// Print the man page, or write one a subcommand into a folder.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folder that gets scanweave.1 and a page for every subcommand.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<Status> {
    if let Some(folder) = &arguments.output {
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        clap_mangen::generate_to(Cli::command(), folder).map_err(|e| Error::write(folder, e))?;
        return Ok(Status::Success);
    }
    let mut page = Vec::new();
    clap_mangen::Man::new(Cli::command()).render(&mut page)?;
    terminal::print_drawn(&String::from_utf8_lossy(&page))?;
    Ok(Status::Success)
}
