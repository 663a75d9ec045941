//! What fixes each component, how its pairs control it, and the table of pairs.

use super::network::{Figures, Network, Pair};
use super::plan;
use super::scans::name;
use super::table::{self, Table, facts, heading, millimetres, paragraph, percent, subheading};
use super::{Input, MOST_PAIRS, WEAKEST_PAIRS};
use crate::result::Component;

/// Scans that are named where there are more; the others are counted.
const FEW: usize = 8;

/// The figures of every component, and a plan of it.
pub(super) fn summary(input: &Input<'_>, network: &Network<'_>, out: &mut String) {
    heading("Summary", out);
    if input.poses.components.is_empty() {
        paragraph("No scan is placed.", out);
    }
    for (number, component) in input.poses.components.iter().enumerate() {
        subheading(&format!("Component {}", number + 1), out);
        let figures = network.figures(number);
        facts(&lines(input, component, network, &figures), out);
        plan::write(number, component, network, out);
    }
}

fn lines(
    input: &Input<'_>,
    component: &Component,
    network: &Network<'_>,
    figures: &Figures<'_>,
) -> Vec<(&'static str, String)> {
    let mm = |m: f64| format!("{} mm", millimetres(m));
    let between =
        |scans: (usize, usize)| format!("{} \u{2013} {}", name(input, scans.0), name(input, scans.1));
    let mut lines = vec![
        ("Frame", frame(input, component, network)),
        ("Scans", component.scans.len().to_string()),
        ("Touching pairs", figures.touching.len().to_string()),
        ("Independent loops", loops(figures)),
    ];
    if !figures.single.is_empty() {
        let few: Vec<String> = figures.single.iter().take(FEW).map(|&s| name(input, s)).collect();
        let more = match figures.single.len().saturating_sub(FEW) {
            0 => String::new(),
            n => format!(" and {n} more"),
        };
        lines.push(("In one pair or none, so in no loop", few.join(", ") + &more));
    }
    if let (Some(median), Some((distance, pair))) =
        (figures.median_m, figures.largest.and_then(|p| Some((p.distance_m()?, p))))
    {
        lines.push(("Cloud to cloud, median of pairs", mm(median)));
        lines.push(("Cloud to cloud, largest", format!("{} ({})", mm(distance), between(pair.scans))));
    }
    if let Some(pair) = figures.least {
        lines
            .push(("Least overlap of a parent edge", format!("{} ({})", overlap(pair), between(pair.scans))));
    }
    if let Some(edge) = figures.weakest {
        let scans = (edge.scans.0.0, edge.scans.1.0);
        let p = table::probability(edge.probability);
        lines.push(("Weakest edge", format!("{}, probability {p}", between(scans))));
    }
    lines
}

fn loops(figures: &Figures<'_>) -> String {
    match figures.loops {
        0 => "none: nothing controls the network, an error in any pair stays unseen".to_owned(),
        n => n.to_string(),
    }
}

/// An overlap with its unit.
fn overlap(pair: &Pair) -> String {
    pair.touch.map_or("below 1 %".to_owned(), |t| format!("{} %", percent(t.overlap)))
}

/// What fixes the frame of a component. The result does not say; the poses tell.
fn frame(input: &Input<'_>, component: &Component, network: &Network<'_>) -> String {
    let stays = |scan: usize| {
        let identity =
            |m: &[[f64; 4]; 4]| (0..4).all(|r| (0..4).all(|c| m[r][c] == f64::from(u8::from(r == c))));
        network.poses.get(scan).copied().flatten().is_some_and(|p| identity(&p.world_from_scan))
    };
    let reference =
        component.scans.iter().copied().find(|&s| Some(name(input, s).as_str()) == input.reference);
    if let Some(scan) = reference {
        return format!("{}, the reference that was named, stays where its file has it", name(input, scan));
    }
    let pivot = component.pivot.map_or("none".to_owned(), |p| name(input, p));
    match component.pivot.filter(|&p| stays(p)) {
        Some(_) => format!("the coordinates of the file of {pivot} (pivot)"),
        None => format!(
            "the coordinates that the files state: scans are moved as little as possible (least sum of \
             distances), or the pivot keeps the pose that its file states; pivot {pivot}"
        ),
    }
}

/// The table of pairs that touch.
pub(super) fn pairs(input: &Input<'_>, network: &Network<'_>, out: &mut String) {
    heading("Pairs that touch", out);
    if network.pairs.is_empty() {
        paragraph("None.", out);
        return;
    }
    let listed = network.listed(MOST_PAIRS, WEAKEST_PAIRS);
    if listed.len() < network.pairs.len() {
        let text = format!(
            "The {} weakest of {} pairs: parent edges first, then others, the least overlap first. {} are left \
             out; all are in poses.json.",
            listed.len(),
            network.pairs.len(),
            network.pairs.len() - listed.len()
        );
        paragraph(&text, out);
    }
    let head = [
        ("Component", true),
        ("Scan", false),
        ("Scan", false),
        ("Overlap (%)", true),
        ("Cloud to cloud, median (mm)", true),
        ("Parent edge", false),
    ];
    let mut table = Table::new("", &head);
    for pair in listed {
        let overlap = pair.touch.map_or("below 1".to_owned(), |t| percent(t.overlap));
        let distance = pair.distance_m().map_or(table::NONE.to_owned(), millimetres);
        table.row([
            (pair.component + 1).to_string(),
            format!("{} {}", pair.scans.0, name(input, pair.scans.0)),
            format!("{} {}", pair.scans.1, name(input, pair.scans.1)),
            overlap,
            distance,
            if pair.parent { "yes" } else { "" }.to_owned(),
        ]);
    }
    table.write(out);
}
