//! What is printed, and where: results to stdout, everything else to stderr.

use scanweave::{Error, Result};
use std::io::{ErrorKind, Write};

/// Writes to stdout. A reader that went away (`| head`) is not an error.
pub fn print(text: &str) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(Error::write("standard output", e)),
        _ => Ok(()),
    }
}

/// Writes a line to stdout.
pub fn print_line(text: &str) -> Result<()> {
    print(&format!("{text}\n"))
}

/// Writes a line to stderr; there is nowhere to complain if that fails.
pub fn tell(text: &str) {
    writeln!(std::io::stderr().lock(), "{text}").ok();
}

/// Writes an error and its causes to stderr.
pub fn print_error(error: &anyhow::Error) {
    tell(&format!("error: {error:#}"));
}
