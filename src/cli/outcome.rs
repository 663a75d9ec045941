//! What is said about a finished registration.

use super::{Status, Verbosity, terminal};
use scanweave::io::Inputs;
use scanweave::pipeline::Run;
use scanweave::preprocessing::ScaleWarning;
use scanweave::report::table::{self, length};
use scanweave::result::RunReport;
use scanweave::scan::STRAY;
use scanweave::scan::{Reconstruction, Scan};
use std::io::IsTerminal;

/// Width where output is not a terminal (a file, a pipe).
const PIPE_WIDTH: u16 = 140;

/// Says on stderr how files were read: what is taken for what, what may be wrong, what was left out.
pub fn tell_about(read: &Inputs, verbosity: &Verbosity) {
    if verbosity.quiet {
        return;
    }
    for (note, files) in &read.notes {
        let which = match &files[..] {
            [one] => one.display().to_string(),
            [first, ..] => format!("{} and {} more", first.display(), files.len() - 1),
            [] => continue,
        };
        let kind = if note.warning { "warning" } else { "reading" };
        terminal::tell(&format!("{kind}: {which}: {}", note.text));
    }
    let (unreadable, others): (Vec<_>, Vec<_>) = read.left_out.iter().partition(|l| l.unreadable);
    for file in others {
        terminal::tell(&format!("skipped: {}: no scan: {}", file.path.display(), file.why));
    }
    for file in unreadable {
        terminal::tell(&format!("skipped: {}", file.why));
    }
}

/// Logs what the stages found odd about the scans.
pub fn warn(run: &Run, scans: &[Scan]) {
    for warning in &run.warnings {
        let (ScaleWarning::OffScale { scan, .. } | ScaleWarning::NoExtent { scan, .. }) = warning;
        tracing::warn!("{}: {warning}", scans[*scan].name);
    }
    for rough in &run.overruled {
        let name = &scans[rough.scan.0].name;
        tracing::warn!(
            "{name}: the scans contradict its rough pose, by {} and {:.1} degrees",
            length(rough.moved_m),
            rough.turned_deg
        );
    }
    for scan in scans.iter().filter(|s| s.cloud.stray_points > 0) {
        tracing::warn!(
            "{}: left out {} of {} points, which lie more than {STRAY} times as far out as half of the others",
            scan.name,
            scan.cloud.stray_points,
            scan.cloud.len() + scan.cloud.stray_points
        );
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
