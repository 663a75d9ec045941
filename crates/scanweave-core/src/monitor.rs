//! Progress and cancellation, without printing.
//!
//! Long stages report to a [`Monitor`] and ask it whether to go on. The
//! command line shows progress bars and watches for Ctrl-C through it; the
//! library itself stays silent.

use crate::error::{Error, Result};

/// Receives progress and says whether the work should stop.
///
/// Stages run one after another; `advance` may be called from many threads.
pub trait Monitor: Sync {
    /// A stage of `total` items begins (0 when the number is unknown).
    fn begin(&self, _stage: &str, _total: usize) {}
    /// `items` more of the current stage are done.
    fn advance(&self, _items: usize) {}
    /// A short line about the current item (loss, scan name, …).
    fn note(&self, _text: &str) {}
    /// The current stage is over.
    fn end(&self) {}
    /// True once the user asked to stop.
    fn cancelled(&self) -> bool {
        false
    }
    /// [`Error::Interrupted`] once the user asked to stop.
    ///
    /// # Errors
    /// [`Error::Interrupted`] naming `stage`.
    fn check(&self, stage: &str) -> Result<()> {
        if self.cancelled() { Err(Error::Interrupted { stage: stage.to_owned() }) } else { Ok(()) }
    }
}

/// A monitor that ignores progress and never stops the work.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Monitor for Silent {}
