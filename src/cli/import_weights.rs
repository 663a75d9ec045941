//! `scanweave import-weights`.

use super::{Status, Verbosity, terminal};
use clap::{Args, ValueEnum};
use scanweave::retrieval::import::{self, Publisher};
use scanweave::synchronization::LitsWeights;
use scanweave::{Error, io};
use std::io::Write;
use std::path::PathBuf;

/// Turn weights published by others into a file for `register`.
///
/// Of SGHR and IMVR it reads an overlap head, a PyTorch file with conv.weight [K,D,1,1],
/// conv.bias [K] and centroids [K,D] under whatever prefix, and writes a checkpoint for
/// --checkpoint. Of LITS it reads the graph network for SE(3) and writes a file for the setting
/// synchronization.lits_weights.
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
    /// Local descriptor the head was trained on (sghr, imvr).
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
    /// LITS (Yew & Lee 2021).
    Lits,
}

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    if arguments.output.exists() && !arguments.force {
        return Err(Error::OutputExists { path: arguments.output.clone() }.into());
    }
    let publisher = match arguments.from {
        From::Sghr => Publisher::Sghr,
        From::Imvr => Publisher::Imvr,
        From::Lits => return import_lits(arguments, verbosity),
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

fn import_lits(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    let bytes = LitsWeights::import(&arguments.input)?.to_bytes()?;
    io::atomic::write(&arguments.output, |out| out.write_all(&bytes))?;
    if !verbosity.quiet {
        terminal::print_line(&format!(
            "{}: weights of LITS for the setting synchronization.lits_weights",
            arguments.output.display()
        ))?;
    }
    Ok(Status::Success)
}
