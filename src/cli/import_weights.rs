//! `scanweave import-weights`.

use super::{Status, Verbosity, terminal};
use clap::{Args, ValueEnum};
use scanweave::Error;
use scanweave::retrieval::import::{self, Publisher};
use std::path::PathBuf;

/// Turn an overlap head published by others into a checkpoint.
///
/// Reads a PyTorch file with conv.weight [K,D,1,1], conv.bias [K] and centroids [K,D], under
/// whatever prefix, and writes a checkpoint for --checkpoint of `register`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The PyTorch file (.pth).
    #[arg(value_name = "FILE")]
    input: PathBuf,
    /// Whose layout it has.
    #[arg(long, value_name = "WHOSE")]
    from: From,
    /// The checkpoint to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Local descriptor the head was trained on.
    #[arg(long, value_name = "NAME", default_value = "yoho")]
    descriptor: String,
    /// Replace the file if it is there.
    #[arg(long)]
    force: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum From {
    /// SGHR (Wang et al. 2023).
    Sghr,
    /// IMVR (Li et al. 2025).
    Imvr,
}

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    if arguments.output.exists() && !arguments.force {
        return Err(Error::OutputExists { path: arguments.output.clone() }.into());
    }
    let publisher = match arguments.from {
        From::Sghr => Publisher::Sghr,
        From::Imvr => Publisher::Imvr,
    };
    let checkpoint = import::import(&arguments.input, publisher, &arguments.descriptor)?;
    checkpoint.save(&arguments.output)?;
    if !verbosity.quiet {
        let meta = &checkpoint.meta;
        terminal::print_line(&format!(
            "{}: a head for the descriptor `{}` with {} dimensions, from {}",
            arguments.output.display(),
            meta.descriptor.name,
            meta.descriptor.dim,
            meta.name
        ))?;
    }
    Ok(Status::Success)
}
