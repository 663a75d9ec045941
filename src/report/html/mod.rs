//! `report.html`: one file that shows a registration in any browser, without a network.
//!
//! `page.html` is built from `scripts/viewer/` (scripts/build-viewer.sh) and holds three.js, the
//! viewer and their style; its content security policy lets nothing else run. Here the data of one
//! run is put into it, as JSON that no browser takes for markup.

mod agreement;
mod data;
mod points;
mod wording;

pub use points::{MOST_POINTS, PointSource};
pub use wording::headline;

use super::markup::{escaped, filled, run_mark};
use crate::evaluation::pose_error::PoseReport;
use crate::files::printable_json;
use crate::geometry::RigidMotion;
use crate::result::Document;
use crate::result::RunReport;
use crate::scan::{PointCloud, SimilarityMatrix, Surface};
use crate::{Error, Result};

const TEMPLATE: &str = include_str!("page.html");

/// What a page is made from; everything is in the order of the scans.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a> {
    /// The outcomes.
    pub poses: &'a Document,
    /// What the run took and worked with.
    pub run: &'a RunReport,
    /// The effective settings, as TOML.
    pub config: &'a str,
    /// Predicted overlap, where it is known.
    pub similarity: Option<&'a SimilarityMatrix>,
    /// Points of every scan; a scan whose points are not at hand has an empty cloud.
    pub clouds: &'a [&'a PointCloud],
    /// Where those points come from.
    pub sources: &'a [PointSource],
    /// The same scans, thinned, with normals, in frames of their own; empty for a scan that is not to
    /// be compared with others.
    pub surfaces: &'a [Surface],
    /// `scan_from_local` of every scan: from the frame of its surface to its file's coordinates.
    pub frames: &'a [RigidMotion],
    /// Errors of the placed scans, where the truth is known.
    pub truth: Option<&'a PoseReport>,
}

/// The whole page. The same input gives the same bytes on any number of threads.
///
/// # Errors
/// [`Error::Input`] when the lists are not of one length.
pub fn page(input: &Input<'_>) -> Result<String> {
    let n = input.poses.scans.len();
    let similar = input.similarity.map_or(n, SimilarityMatrix::len);
    let points = [input.clouds.len(), input.sources.len(), input.surfaces.len(), input.frames.len()];
    let lengths = [points[0], points[1], points[2], points[3], input.run.evidence.len(), similar];
    if lengths.iter().any(|&length| length != n) {
        return Err(Error::input(
            "report.html",
            format!(
                "{n} poses for {lengths:?} clouds, sources, surfaces, frames, rows of evidence and similarities"
            ),
            "one of each a scan",
            "make the report from the files of one run",
        ));
    }
    let headline = headline(input.poses);
    let json = script_text(&data::Data::new(input, &headline).to_json());
    let run = run_mark(input.run);
    Ok(filled(TEMPLATE, &[("run", &run), ("headline", &escaped(&headline)), ("data", &json)]))
}

/// JSON as the content of a `<script type="application/json">`: nothing in it can end the
/// element or begin another. These characters occur only inside strings, where escapes mean the same.
fn script_text(json: &str) -> String {
    let mut text = String::with_capacity(json.len() + json.len() / 64);
    for c in printable_json(json).chars() {
        match c {
            '<' | '>' | '&' => text.push_str(&format!("\\u{:04x}", c as u32)),
            c => text.push(c),
        }
    }
    text
}

#[cfg(test)]
mod tests;
