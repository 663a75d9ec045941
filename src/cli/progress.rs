//! Progress bars on stderr, and log lines where bars are off.

use super::{Verbosity, interrupt};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use scanweave::Monitor;
use scanweave::files::printable;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Shows one bar for the running stage and passes Ctrl-C on to it.
pub struct Progress {
    /// The running stage and its bar.
    current: Mutex<Option<(String, ProgressBar)>>,
    hidden: bool,
    asked_to_stop: Arc<AtomicBool>,
}

impl Progress {
    /// Bars unless the user asked for silence or for log lines; hidden as well
    /// where stderr is not a terminal.
    pub fn start(verbosity: &Verbosity) -> anyhow::Result<Self> {
        Ok(Self {
            current: Mutex::new(None),
            hidden: verbosity.quiet || verbosity.verbose > 0,
            asked_to_stop: interrupt::watch()?,
        })
    }

    /// A panic of another thread while it held the bar leaves nothing broken in it.
    fn current(&self) -> MutexGuard<'_, Option<(String, ProgressBar)>> {
        self.current.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Monitor for Progress {
    fn begin(&self, stage: &str, total: usize) {
        tracing::info!(total, "{stage}");
        let target = if self.hidden { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        let bar = ProgressBar::with_draw_target((total > 0).then_some(total as u64), target);
        let template = if total > 0 {
            "{prefix:<24} [{bar:30}] {pos}/{len} {elapsed}, {eta} left {msg}"
        } else {
            "{prefix:<24} {spinner} {pos} {elapsed} {msg}"
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_prefix(printable(stage).into_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        if let Some((_, old)) = self.current().replace((stage.to_owned(), bar)) {
            old.finish_and_clear();
        }
    }

    fn advance(&self, items: usize) {
        if let Some((_, bar)) = self.current().as_ref() {
            bar.inc(items as u64);
        }
    }

    fn note(&self, text: &str) {
        if let Some((stage, bar)) = self.current().as_ref() {
            tracing::debug!("{stage}: {text}");
            bar.set_message(printable(text).into_owned());
        }
    }

    fn end(&self) {
        if let Some((stage, bar)) = self.current().take() {
            tracing::debug!(seconds = bar.elapsed().as_secs_f64(), "{stage} done");
            bar.finish_and_clear();
        }
    }

    fn cancelled(&self) -> bool {
        self.asked_to_stop.load(Ordering::SeqCst)
    }
}
