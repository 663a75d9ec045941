//! How long every stage took.

use crate::result::StageTime;
use std::time::Instant;

/// Times stages.
#[derive(Debug, Default)]
pub struct Stopwatch {
    /// Stages so far, in order.
    pub stages: Vec<StageTime>,
}

impl Stopwatch {
    /// Runs `work` and writes down how long it took, together with what was written down for the
    /// stage just before.
    pub fn time<T>(&mut self, stage: &str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        let seconds = start.elapsed().as_secs_f64();
        if let Some(last) = self.stages.last_mut().filter(|last| last.stage == stage) {
            last.seconds += seconds;
            return result;
        }
        self.stages.push(StageTime { stage: stage.to_owned(), seconds });
        result
    }
}
