//! What a user should know of how scans were read and of what the stages found odd about them.

use super::table::length;
use crate::io::Inputs;
use crate::pipeline::Run;
use crate::preprocessing::ScaleWarning;
use crate::scan::STRAY;
use crate::scan::Scan;

/// How much a remark matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Weight {
    /// What was taken for what.
    Note,
    /// Something may be wrong.
    Warning,
}

/// One sentence.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Remark {
    /// How much it matters.
    pub weight: Weight,
    /// Kind and subject, then what there is to say: `skipped: notes.csv: no scan: …`.
    pub text: String,
}

/// How files were read: what is taken for what, what may be wrong, what was left out.
pub fn of_inputs(read: &Inputs) -> Vec<Remark> {
    let mut remarks = Vec::new();
    for (note, files) in &read.notes {
        let which = match &files[..] {
            [one] => one.display().to_string(),
            [first, ..] => format!("{} and {} more", first.display(), files.len() - 1),
            [] => continue,
        };
        let (kind, weight) =
            if note.warning { ("warning", Weight::Warning) } else { ("reading", Weight::Note) };
        remarks.push(Remark { weight, text: format!("{kind}: {which}: {}", note.text) });
    }
    let (unreadable, others): (Vec<_>, Vec<_>) = read.left_out.iter().partition(|l| l.unreadable);
    remarks.extend(others.iter().map(|file| Remark {
        weight: Weight::Note,
        text: format!("skipped: {}: no scan: {}", file.path.display(), file.why),
    }));
    let skipped = |text: &String| Remark { weight: Weight::Warning, text: format!("skipped: {text}") };
    remarks.extend(unreadable.iter().map(|file| skipped(&file.why)));
    remarks
}

/// What the stages found odd about the scans.
pub fn of_run(run: &Run, scans: &[Scan]) -> Vec<Remark> {
    let mut remarks = Vec::new();
    let mut say = |weight, text| remarks.push(Remark { weight, text });
    for warning in &run.warnings {
        let (ScaleWarning::OffScale { scan, .. } | ScaleWarning::NoExtent { scan, .. }) = warning;
        say(Weight::Warning, format!("{}: {warning}", scans[*scan].name));
    }
    for rough in &run.overruled {
        let name = &scans[rough.scan.0].name;
        let (moved, turned_deg) = (length(rough.moved_m), rough.turned_deg);
        let text =
            format!("{name}: the scans contradict its rough pose, by {moved} and {turned_deg:.1} degrees");
        say(Weight::Warning, text);
    }
    for scan in scans.iter().filter(|s| s.cloud.stray_points > 0) {
        let (stray, all) = (scan.cloud.stray_points, scan.cloud.len() + scan.cloud.stray_points);
        let text = format!(
            "{}: left out {stray} of {all} points, which lie more than {STRAY} times as far out as half of the others",
            scan.name
        );
        say(Weight::Warning, text);
    }
    for scan in scans.iter().filter(|s| s.cloud.dropped_rows > 0) {
        let rows = scan.cloud.dropped_rows;
        say(Weight::Note, format!("{}: left out {rows} rows that are not finite", scan.name));
    }
    remarks
}
