//! `scanweave import-weights`.

use super::{Status, Verbosity, terminal};
use clap::{Args, ValueEnum};
use scanweave::Error;
use scanweave::files;
use scanweave::weight_import::overlap_head::Publisher;
use scanweave::weight_import::{lits, mini_spin_net, overlap_head};
use std::io::Write;
use std::path::PathBuf;

/// Turn weights published by others into a file of ours.
///
/// `sghr` and `imvr` are overlap heads, with conv.weight [K,D,1,1], conv.bias [K] and centroids
/// [K,D] under whatever prefix; the checkpoint is for --checkpoint of `register`. `buffer` is the
/// local descriptor MiniSpinNet, with the tensors Desc.*; the checkpoint is for the setting
/// descriptor.checkpoint. `lits` is the graph network for
/// SE(3); the file is for the setting synchronization.lits_weights.
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
    /// Local descriptor an overlap head was trained on (sghr, imvr).
    #[arg(long, value_name = "NAME", default_value = "yoho")]
    descriptor: String,
    /// Replace the file if it is there.
    #[arg(long)]
    force: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum From {
    /// Overlap head of SGHR (Wang et al. 2023).
    Sghr,
    /// Overlap head of IMVR (Li et al. 2025).
    Imvr,
    /// LITS (Yew & Lee 2021).
    Lits,
    /// Local descriptor of BUFFER (Ao et al. 2023).
    Buffer,
}

pub fn run(arguments: &Arguments, verbosity: &Verbosity) -> anyhow::Result<Status> {
    if arguments.output.exists() && !arguments.force {
        return Err(Error::OutputExists { path: arguments.output.clone() }.into());
    }
    let said = match arguments.from {
        From::Sghr => import_head(arguments, Publisher::Sghr)?,
        From::Imvr => import_head(arguments, Publisher::Imvr)?,
        From::Lits => import_lits(arguments)?,
        From::Buffer => import_descriptor(arguments)?,
    };
    if !verbosity.quiet {
        terminal::print_line(&format!("{}: {said}", arguments.output.display()))?;
    }
    Ok(Status::Success)
}

fn import_lits(arguments: &Arguments) -> Result<String, Error> {
    let bytes = lits::lits(&arguments.input)?.to_bytes()?;
    files::write(&arguments.output, |out| out.write_all(&bytes))?;
    Ok("weights of LITS for the setting synchronization.lits_weights".to_owned())
}

fn import_head(arguments: &Arguments, publisher: Publisher) -> Result<String, Error> {
    let checkpoint = overlap_head::import(&arguments.input, publisher, &arguments.descriptor)?;
    checkpoint.save(&arguments.output)?;
    let meta = &checkpoint.meta;
    Ok(format!(
        "a head for the descriptor `{}` with {} dimensions, from {}",
        meta.descriptor.name, meta.descriptor.dim, meta.name
    ))
}

fn import_descriptor(arguments: &Arguments) -> Result<String, Error> {
    let checkpoint = mini_spin_net::buffer(&arguments.input)?;
    checkpoint.save(&arguments.output)?;
    let meta = &checkpoint.meta;
    Ok(format!(
        "the descriptor {} with {} dimensions, from {} (licence: {})",
        meta.descriptor,
        meta.architecture.dim(),
        meta.source,
        meta.licence
    ))
}
