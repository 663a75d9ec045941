//! What is said about a finished registration.

use super::Status;
use scanweave::pipeline::Run;
use scanweave::preprocessing::ScaleWarning;
use scanweave::report::table;
use scanweave::result::run::RunReport;
use scanweave::scan::{Reconstruction, Scan};
use std::io::IsTerminal;

/// Width where output is not a terminal (a file, a pipe).
const PIPE_WIDTH: u16 = 140;

/// Logs what the stages found odd about the scans.
pub fn warn(run: &Run, scans: &[Scan]) {
    for warning in &run.warnings {
        let (ScaleWarning::OffScale { scan, .. } | ScaleWarning::NoExtent { scan, .. }) = warning;
        tracing::warn!("{}: {warning}", scans[*scan].name);
    }
    for scan in scans.iter().filter(|s| s.cloud.dropped_rows > 0) {
        tracing::info!("{}: left out {} rows that are not finite", scan.name, scan.cloud.dropped_rows);
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
