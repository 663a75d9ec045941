//! Signals. Ctrl-C: the first asks the running stage to stop, the second stops at once.

use super::{Status, terminal};
use anyhow::Context;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Starts watching for Ctrl-C (and termination); the flag is true once it came.
pub fn watch() -> anyhow::Result<Arc<AtomicBool>> {
    let asked = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&asked);
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::SeqCst) {
            std::process::exit(Status::Interrupted as i32);
        }
        terminal::tell("stopping after the current item; press Ctrl-C again to stop at once");
    })
    .context("cannot watch for Ctrl-C")?;
    Ok(asked)
}

/// Lets a file that grows beyond the limit of the user (`ulimit -f`) be an error like a full disk: the
/// signal would otherwise end the process without a word.
pub fn outlive_file_size_limits() -> anyhow::Result<()> {
    #[cfg(unix)]
    {
        // That it came need not be known: the write that it interrupts fails.
        let unused = Arc::new(AtomicBool::new(false));
        signal_hook::flag::register(signal_hook::consts::SIGXFSZ, unused)
            .context("cannot watch for limits of file sizes")?;
    }
    Ok(())
}
