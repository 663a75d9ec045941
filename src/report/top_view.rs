//! A picture of a merged cloud, coloured by scan.

use crate::geometry::Point;
use crate::result::MergedCloud;
use crate::scan::middle_and_size;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use std::fmt::Write;

/// Points drawn at most; more only make the file larger.
const MAX_POINTS: usize = 12_000;
/// Points so many times farther from the middle than half of all are not drawn.
const DRAWN: f64 = 20.0;
const WIDTH: f64 = 900.0;
const MARGIN: f64 = 30.0;

/// SVG of the cloud seen along the direction in which it extends least (for rooms, from
/// above), each scan in a colour of its own, with a scale bar.
pub fn svg(cloud: &MergedCloud, scans: usize) -> String {
    // What floats far out must not make the rest a dot.
    let near: Vec<usize> = match middle_and_size(&cloud.points) {
        Some((middle, size_m)) => {
            let near = |p: &Point| (p.cast::<f64>() - middle).norm() <= DRAWN * size_m;
            (0..cloud.points.len()).filter(|&i| near(&cloud.points[i])).collect()
        }
        None => (0..cloud.points.len()).collect(),
    };
    let flat = projected(cloud, &near);
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for p in &flat {
        for a in 0..2 {
            low[a] = low[a].min(p[a]);
            high[a] = high[a].max(p[a]);
        }
    }
    let span = (high[0] - low[0]).max(1e-9);
    let scale = (WIDTH - 2.0 * MARGIN) / span;
    let height = if flat.is_empty() { MARGIN } else { (high[1] - low[1]) * scale } + 3.0 * MARGIN;

    let mut paths = vec![String::new(); scans];
    let stride = flat.len().div_ceil(MAX_POINTS).max(1);
    for i in (0..flat.len()).step_by(stride) {
        let (x, y) = ((flat[i][0] - low[0]) * scale + MARGIN, (high[1] - flat[i][1]) * scale + MARGIN);
        if let Some(path) = paths.get_mut(cloud.scan[near[i]] as usize) {
            write!(path, "M{x:.1} {y:.1}h0").ok();
        }
    }
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height:.0}\" \
         font-family=\"sans-serif\" font-size=\"14\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n\
         <g fill=\"none\" stroke-width=\"2.2\" stroke-linecap=\"round\" stroke-opacity=\"0.8\">\n"
    );
    for (scan, path) in paths.iter().enumerate().filter(|(_, p)| !p.is_empty()) {
        let [r, g, b] = scan_color(scan);
        writeln!(out, "<path stroke=\"#{r:02x}{g:02x}{b:02x}\" d=\"{path}\"/>").ok();
    }
    let bar_m = 10f64.powf((span * 0.4).log10().floor());
    let (x, y) = (MARGIN + bar_m * scale, height - MARGIN);
    write!(
        out,
        "</g>\n<path stroke=\"#222\" stroke-width=\"2\" d=\"M{MARGIN} {y:.0}H{x:.1}\"/>\n\
         <text x=\"{:.1}\" y=\"{:.0}\" fill=\"#222\">{bar_m} m</text>\n</svg>\n",
        x + 8.0,
        y + 5.0
    )
    .ok();
    out
}

/// A strong colour (HSV with s = 0.75, v = 0.8) for every scan; hues a golden angle apart stay
/// distinct for any number of scans.
fn scan_color(scan: usize) -> [u8; 3] {
    let hue = (scan as f64 * 137.508) % 360.0 / 60.0;
    [5.0, 3.0, 1.0].map(|n: f64| {
        let k = (n + hue) % 6.0;
        (255.0 * 0.8 * (1.0 - 0.75 * k.min(4.0 - k).clamp(0.0, 1.0))).round() as u8
    })
}

/// These points in the plane of their two longest principal axes.
fn projected(cloud: &MergedCloud, which: &[usize]) -> Vec<[f64; 2]> {
    let n = which.len().max(1) as f64;
    let points: Vec<Vector3<f64>> = which.iter().map(|&i| cloud.points[i].coords.cast()).collect();
    let mean = points.iter().sum::<Vector3<f64>>() / n;
    let covariance = points.iter().fold(Matrix3::zeros(), |sum, p| {
        let d = p - mean;
        sum + d * d.transpose()
    });
    let eigen = SymmetricEigen::new(covariance);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    // Eigenvectors have no sign of their own; fix one, so that the picture does not flip by chance.
    let axis = |i: usize| {
        let v = eigen.eigenvectors.column(order[i]).into_owned();
        if v[v.iamax()] < 0.0 { -v } else { v }
    };
    let (x, y) = (axis(0), axis(1));
    points.iter().map(|p| [x.dot(&(p - mean)), y.dot(&(p - mean))]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shortest_extent_is_looked_along_and_every_scan_has_its_path() {
        // 4 m along z, 2 m along x, 0.2 m along y: z runs to the right, x upwards.
        let corners = [[0.0, 0.0, 0.0], [2.0, 0.2, 0.0], [0.0, 0.2, 4.0], [2.0, 0.0, 4.0]];
        let points: Vec<Point> = corners.map(Point::from).to_vec();
        let cloud = MergedCloud { points, scan: vec![0, 0, 2, 2], ..MergedCloud::default() };
        let text = svg(&cloud, 3);
        // Hue 0 is red: v = 204 and v (1 − s) = 51.
        assert!(text.contains("<path stroke=\"#cc3333\""), "{text}");
        assert_eq!(text.matches("h0\"/>").count(), 2);
        // Width 900 less two margins of 30 for 4 m: 210 px a metre.
        assert!(text.contains("M30.0 450.0h0M30.0 30.0h0"), "{text}");
        assert!(text.contains("M870.0 450.0h0M870.0 30.0h0"), "{text}");
        assert!(text.contains(">1 m</text>"), "{text}");
    }

    #[test]
    fn a_point_far_out_does_not_shrink_the_rest() {
        let corners = [[0.0, 0.0, 0.0], [2.0, 0.2, 0.0], [0.0, 0.2, 4.0], [2.0, 0.0, 4.0]];
        let mut points: Vec<Point> = corners.map(Point::from).to_vec();
        let plain =
            svg(&MergedCloud { points: points.clone(), scan: vec![0; 4], ..MergedCloud::default() }, 1);
        points.insert(1, Point::new(500.0, 0.0, 0.0));
        let wild = MergedCloud { points, scan: vec![0, 1, 0, 0, 0], ..MergedCloud::default() };
        assert_eq!(svg(&wild, 2), plain);
    }
}
