//! Long work beside Python: the interpreter's lock is released, Ctrl-C asks the work to stop, and progress
//! is told to a Python object by the thread that called.

use crate::errors::OrRaise;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use scanweave::{Error, Monitor, Result};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

/// How often signals and progress are looked at.
const INTERVAL: Duration = Duration::from_millis(50);
/// Stack of the thread that works, bytes: that of a main thread.
const STACK: usize = 8 << 20;

/// What a stage reports.
enum Event {
    Begin(String, usize),
    Advance(usize),
    End,
}

#[derive(Default)]
struct State {
    events: Vec<Event>,
    finished: bool,
}

/// The monitor of the work, and what the caller waits for.
#[derive(Default)]
struct Watch {
    state: Mutex<State>,
    changed: Condvar,
    stop: AtomicBool,
    silent: bool,
}

impl Watch {
    /// A panic while it was held leaves nothing broken in it.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn tell(&self, event: Event) {
        if self.silent {
            return;
        }
        let events = &mut self.state().events;
        match (events.last_mut(), event) {
            (Some(Event::Advance(so_far)), Event::Advance(more)) => *so_far += more,
            (_, event) => events.push(event),
        }
    }

    /// What came, after the work ended or a while; and whether it ended.
    fn wait(&self) -> (Vec<Event>, bool) {
        let state = self.state();
        let waited = self.changed.wait_timeout_while(state, INTERVAL, |state| !state.finished);
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        (std::mem::take(&mut state.events), state.finished)
    }
}

impl Monitor for Watch {
    fn begin(&self, stage: &str, total: usize) {
        self.tell(Event::Begin(stage.to_owned(), total));
    }

    fn advance(&self, items: usize) {
        self.tell(Event::Advance(items));
    }

    fn end(&self) {
        self.tell(Event::End);
    }

    fn cancelled(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }
}

/// Says that the work ended, even if it panicked.
struct Ends<'a>(&'a Watch);

impl Drop for Ends<'_> {
    fn drop(&mut self) {
        self.0.state().finished = true;
        self.0.changed.notify_all();
    }
}

/// Runs `work` on a thread of its own, on so many threads of a pool of its own if they are given.
/// `progress` has the methods `begin(stage, total)`, `advance(items)` and `end()`; what it raises stops the work.
pub fn watched<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    threads: Option<usize>,
    work: impl FnOnce(&dyn Monitor) -> Result<T> + Send,
) -> PyResult<T> {
    let watch = Watch { silent: progress.is_none(), ..Watch::default() };
    let mut raised = None;
    let done = thread::scope(|scope| {
        let worker = thread::Builder::new().stack_size(STACK).spawn_scoped(scope, || {
            let _ends = Ends(&watch);
            match threads {
                Some(threads) => pool(threads)?.install(|| work(&watch)),
                None => work(&watch),
            }
        })?;
        loop {
            let (events, finished) = py.detach(|| watch.wait());
            if raised.is_none()
                && let Err(error) = forward(progress, events).and_then(|()| py.check_signals())
            {
                watch.stop.store(true, Ordering::SeqCst);
                raised = Some(error);
            }
            if finished {
                break;
            }
        }
        worker
            .join()
            .map_err(|_| PyRuntimeError::new_err("scanweave ran into an error of its own; please report it"))
    });
    match raised {
        Some(error) => Err(error),
        None => done?.or_raise(py),
    }
}

fn forward(progress: Option<&Bound<'_, PyAny>>, events: Vec<Event>) -> PyResult<()> {
    let Some(progress) = progress else { return Ok(()) };
    for event in events {
        match event {
            Event::Begin(stage, total) => progress.call_method1("begin", (stage, total))?,
            Event::Advance(items) => progress.call_method1("advance", (items,))?,
            Event::End => progress.call_method0("end")?,
        };
    }
    Ok(())
}

fn pool(threads: usize) -> Result<rayon::ThreadPool> {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(|e| {
        Error::setting("threads", e.to_string(), "a number of threads that the system gives", "ask for fewer")
    })
}
