//! What is said about a finished registration.

use super::{Status, Verbosity, terminal};
use scanweave::io::Inputs;
use scanweave::pipeline::Run;
use scanweave::report::remarks::{self, Remark, Weight};
use scanweave::report::table;
use scanweave::result::RunReport;
use scanweave::scan::{Reconstruction, Scan};
use std::io::IsTerminal;

/// Width where output is not a terminal (a file, a pipe).
const PIPE_WIDTH: u16 = 140;

/// Says on stderr how files were read: what is taken for what, what may be wrong, what was left out.
pub fn tell_about(read: &Inputs, verbosity: &Verbosity) {
    if !verbosity.quiet {
        remarks::of_inputs(read).iter().for_each(|remark| terminal::tell(&remark.text));
    }
}

/// Logs what the stages found odd about the scans.
pub fn warn(run: &Run, scans: &[Scan]) {
    for Remark { weight, text } in remarks::of_run(run, scans) {
        match weight {
            Weight::Warning => tracing::warn!("{text}"),
            Weight::Note => tracing::info!("{text}"),
        }
    }
}

/// The table and summary, as wide as the terminal.
pub fn table(report: &RunReport) -> String {
    table::summary(report, width())
}

/// Width of tables; `None` leaves it to the terminal.
pub fn width() -> Option<u16> {
    (!std::io::stdout().is_terminal()).then_some(PIPE_WIDTH)
}

/// Success when any two scans were joined.
pub fn status(reconstruction: &Reconstruction) -> Status {
    let joined = reconstruction.outcomes.iter().filter_map(|o| o.placement()).any(|p| p.parent.is_some());
    if joined { Status::Success } else { Status::NothingRegistered }
}
