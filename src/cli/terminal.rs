//! What is printed, and where: results to stdout, everything else to stderr.
//!
//! Names and texts of files are part of what is printed. All but [`print_drawn`] takes care that no
//! control character of theirs reaches the terminal.

use super::Status;
use scanweave::files::{printable, printable_json, printable_lines};
use scanweave::{Error, Result};
use std::io::{ErrorKind, Write};

/// Writes text of several lines to stdout.
pub fn print(text: &str) -> Result<()> {
    print_drawn(&printable_lines(text))
}

/// Writes a JSON document to stdout.
pub fn print_json(json: &str) -> Result<()> {
    print_drawn(&printable_json(json))
}

/// Writes a line to stdout.
pub fn print_line(text: &str) -> Result<()> {
    print_drawn(&format!("{}\n", printable(text)))
}

/// Writes to stdout, as it is, what holds control characters of our own: tables with bold heads, whose
/// cells are printable already, and generated scripts. A reader that went away (`| head`) is not an error.
pub fn print_drawn(text: &str) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(Error::write("standard output", e)),
        _ => Ok(()),
    }
}

/// Writes a line to stderr; there is nowhere to complain if that fails.
pub fn tell(text: &str) {
    writeln!(std::io::stderr().lock(), "{}", printable(text)).ok();
}

/// Writes an error and its causes to stderr, each once: the messages of our own errors tell the system's reason.
pub fn print_error(error: &anyhow::Error) {
    let mut message = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !message.contains(&*printable(&cause)) {
            message = format!("{message}: {cause}");
        }
    }
    tell(&format!("error: {message}"));
}

/// Shows what is wrong with the arguments, or the help that they ask for, and returns the exit code.
///
/// An argument may be the name of a file that the shell found.
pub fn show_usage(error: &clap::Error) -> u8 {
    let plain = error.to_string();
    let shown = printable_lines(&plain);
    // There is nowhere to complain if that fails.
    if !error.use_stderr() || shown == plain {
        error.print().ok();
    } else {
        write!(std::io::stderr().lock(), "{shown}").ok();
    }
    u8::try_from(error.exit_code()).unwrap_or(Status::Internal as u8)
}
