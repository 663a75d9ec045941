//! A plan of a component: its scans and the pairs that hold them.

use super::network::{Network, Pair};
use super::scans::centre;
use crate::result::Component;
use std::fmt::Write;

/// Beyond so many scans the numbers in a plan can no longer be read.
const MOST_SCANS: usize = 150;
/// Beyond so many pairs of a component only parent edges are drawn.
const MOST_PAIRS: usize = 150;
const WIDTH: f64 = 700.0;
/// A long corridor still has room for the circles, and a tall one stays on a page.
const HEIGHTS: (f64, f64) = (90.0, 560.0);
const MARGIN: f64 = 24.0;
const RADIUS: f64 = 9.0;

/// Writes the component as it is seen along Z, X to the right and Y upwards; nothing for one scan or too many.
// Writing into a `String` cannot fail.
pub(super) fn write(number: usize, component: &Component, network: &Network<'_>, out: &mut String) {
    let place = |&scan: &usize| {
        let (centre, _) = centre(network.poses.get(scan).copied().flatten()?);
        Some((scan, [centre.x, centre.y])).filter(|(_, at)| at.iter().all(|v| v.is_finite()))
    };
    let mut places: Vec<(usize, [f64; 2])> = component.scans.iter().filter_map(place).collect();
    places.sort_by_key(|p| p.0);
    if places.len() < 2 || places.len() > MOST_SCANS {
        return;
    }
    let range = |axis: usize| {
        let values = places.iter().map(|p| p.1[axis]);
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
    };
    let ((left, right), (bottom, top)) = (range(0), range(1));
    let room = [WIDTH - 2.0 * MARGIN, HEIGHTS.1 - 3.0 * MARGIN];
    let scale = (room[0] / (right - left).max(1e-9)).min(room[1] / (top - bottom).max(1e-9));
    let height = ((top - bottom) * scale + 3.0 * MARGIN).max(HEIGHTS.0);
    let inset = 0.5 * (WIDTH - (right - left) * scale);
    let on_paper = |at: [f64; 2]| (inset + (at[0] - left) * scale, MARGIN + (top - at[1]) * scale);
    writeln!(
        out,
        "<figure><svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height:.0}\" role=\"img\" \
         aria-label=\"Plan of component {}\" font-family=\"sans-serif\" font-size=\"10\" stroke=\"#000\">",
        number + 1
    )
    .ok();
    let find =
        |scan: usize| places.binary_search_by_key(&scan, |p| p.0).ok().map(|at| on_paper(places[at].1));
    let pairs: Vec<&Pair> = network.pairs.iter().filter(|p| p.component == number).collect();
    let all = pairs.len() <= MOST_PAIRS;
    for pair in pairs.iter().filter(|p| all || p.parent) {
        if let (Some((x, y)), Some((u, v))) = (find(pair.scans.0), find(pair.scans.1)) {
            let line = if pair.parent {
                "stroke-width=\"1.6\""
            } else {
                "stroke-width=\".5\" stroke-dasharray=\"2 2\""
            };
            writeln!(out, "<path {line} d=\"M{x:.1} {y:.1}L{u:.1} {v:.1}\"/>").ok();
        }
    }
    for (scan, at) in &places {
        let (x, y) = on_paper(*at);
        let (width, below) = (if Some(*scan) == component.pivot { 2.4 } else { 0.8 }, y + 3.5);
        writeln!(
            out,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{RADIUS}\" fill=\"#fff\" stroke-width=\"{width}\"/>\
             <text x=\"{x:.1}\" y=\"{below:.1}\" text-anchor=\"middle\" stroke=\"none\">{scan}</text>"
        )
        .ok();
    }
    bar(scale, height, out);
    let others = if all { "dotted: other touching pairs" } else { "other touching pairs are not drawn" };
    writeln!(
        out,
        "</svg>\n<figcaption>Centres of the scans of component {} seen along Z: X to the right, Y up. Full lines: \
         parent edges; {others}. Bold circle: pivot.</figcaption></figure>",
        number + 1
    )
    .ok();
}

/// A bar of a round length, in pixels a metre.
fn bar(scale: f64, height: f64, out: &mut String) {
    let length_m = 10f64.powf((0.3 * WIDTH / scale).log10().floor());
    let (x, y) = (MARGIN + length_m * scale, height - 0.5 * MARGIN);
    writeln!(
        out,
        "<path stroke-width=\"1.6\" d=\"M{MARGIN} {y:.1}H{x:.1}\"/>\
         <text x=\"{:.1}\" y=\"{:.1}\" stroke=\"none\">{length_m} m</text>",
        x + 6.0,
        y + 3.5
    )
    .ok();
}
