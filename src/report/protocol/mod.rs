//! `registration.html`: a registration on paper, with what its precision is, for a person to sign.
//!
//! The page is static: no script, no colour, nothing from outside. It names no time and no duration, so
//! that the same scans with the same seed give the same bytes; the date is filled in by hand.

mod components;
mod network;
mod plan;
mod precision;
mod scans;
mod table;

use super::markup::{filled, run_mark};
use crate::result::RunReport;
use crate::result::{Document, EntryOutcome};
use network::Network;
use table::{heading, paragraph};

const TEMPLATE: &str = include_str!("page.html");
/// Up to so many touching pairs are listed in full.
const MOST_PAIRS: usize = 400;
/// So many of the weakest are listed where there are more.
const WEAKEST_PAIRS: usize = 200;

/// What a page is made from.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a> {
    /// The outcomes.
    pub poses: &'a Document,
    /// What the run worked with.
    pub run: &'a RunReport,
    /// Name of the scan that the settings let stay where its file has it.
    pub reference: Option<&'a str>,
}

/// The whole page; every text in it is shown as text.
pub fn page(input: &Input<'_>) -> String {
    let network = Network::new(input.poses);
    let mut body = String::new();
    head(input, &mut body);
    components::summary(input, &network, &mut body);
    scans::placed(input, &network, &mut body);
    scans::precision(input, &network, &mut body);
    scans::declined(input, &mut body);
    components::pairs(input, &network, &mut body);
    meaning(input, &mut body);
    filled(TEMPLATE, &[("run", &run_mark(input.run)), ("body", &body)])
}

/// What was done with what, and room for a signature.
fn head(input: &Input<'_>, out: &mut String) {
    let (run, scale) = (input.run, &input.run.scale);
    let total = input.poses.scans.len();
    let placed = total - declined(input.poses);
    let facts = [
        ("Program", run.generator.clone()),
        ("Settings", format!("preset {}, method {}, seed {}", run.preset, run.method, run.seed)),
        ("Overlap prediction", run.overlap_head.clone()),
        (
            "Working lengths",
            format!(
                "voxel {} m, normal radius {} m, feature radius {} m, inlier radius \u{3c4} {} m",
                table::significant(scale.voxel_m),
                table::significant(scale.normal_radius_m),
                table::significant(scale.feature_radius_m),
                table::significant(scale.inlier_radius_m)
            ),
        ),
        ("Scans", format!("{total}, of which {placed} placed and {} declined", total - placed)),
        ("Components", input.poses.components.len().to_string()),
        ("Units", "metres and degrees; millimetres where a head says mm".to_owned()),
    ];
    table::facts(&facts, out);
    if input.poses.components.len() > 1 {
        paragraph("Poses of different components are unrelated: each component has its own frame.", out);
    }
    out.push_str("<table class=\"sign\"><tbody>\n");
    for line in ["Project", "Name", "Date", "Signature"] {
        out.push_str(&format!("<tr><th scope=\"row\">{line}</th><td></td></tr>\n"));
    }
    out.push_str("</tbody></table>\n");
}

fn declined(poses: &Document) -> usize {
    poses.scans.iter().filter(|e| matches!(e.outcome, EntryOutcome::Declined { .. })).count()
}

/// What the figures mean, and where they do not hold.
fn meaning(input: &Input<'_>, out: &mut String) {
    heading("How the figures are defined", out);
    let tau = table::significant(input.run.scale.inlier_radius_m);
    let paragraphs = [
        "Cloud to cloud, of a pair: the median distance of the points of each surface from the tangent planes \
         of the other, both ways, over points with a counterpart within the inlier radius that faces the same \
         way. It is measured at the final poses on scans thinned to the working voxel, which averages the noise \
         of the sensor. Surfaces that slide along each other show no distance."
            .to_owned(),
        format!(
            "Overlap: the share of the keypoints of both scans that have a counterpart within the inlier radius \
             \u{3c4} = {tau} m. Pairs with an overlap below 1 % do not count as touching."
        ),
        "Parent edge: the edge by which a scan hangs in the tree of joins. Independent loops: the touching \
         pairs that close a loop, which is pairs \u{2212} scans + groups of scans that touch. An error in a pair \
         shows only in loops that it is part of. Weakest edge: the least certain edge on the most certain \
         chain between a scan and the pivot."
            .to_owned(),
        "Probability: the stated probability that the pose is right. It is calibrated on other data and not a \
         result of redundant measurements."
            .to_owned(),
        "Stated standard deviation: of the pose relative to the pivot of the component, in the component's \
         frame. A scan counts as one observation of the surface that it touches, however many points it has. \
         The deviations fit scans of depth cameras, on which they were set. Terrestrial and turntable scans \
         are better than stated, and the far ends of long chains can be worse (docs/uncertainty.md gives the \
         figures). They do not hold for a scan that stands in a wrong place, nor where a scan bends as a whole."
            .to_owned(),
        "All poses as 4\u{d7}4 matrices, all covariances and all pairs are in poses.json. Numbers of scans are \
         those of poses.json, from 0; components are counted from 1."
            .to_owned(),
    ];
    paragraphs.iter().for_each(|text| paragraph(text, out));
}

#[cfg(test)]
mod tests;
