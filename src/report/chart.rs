//! Line and point charts as SVG.

use plotters::coord::Shift;
use plotters::prelude::*;
use std::io;

/// Points with a name, joined by a line or not.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// What the legend says; equal names have equal colours in all panels of a picture.
    pub name: String,
    /// (x, y).
    pub points: Vec<(f64, f64)>,
    /// Whether the points are joined.
    pub line: bool,
    /// Least and greatest y at each point, where there is a spread.
    pub spread: Vec<(f64, f64)>,
}

/// One pair of axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// Above the axes.
    pub title: String,
    /// Below them.
    pub x_label: String,
    /// Beside them.
    pub y_label: String,
    /// What stands at x = 0, 1, 2 … instead of numbers; empty for numbers.
    pub x_names: Vec<String>,
    /// What is drawn.
    pub series: Vec<Series>,
    /// Greatest y at least; the axis starts at the least y, or at 0 where that is near.
    pub y_most: f64,
}

const PANEL_WIDTH: u32 = 520;
const PANEL_HEIGHT: u32 = 340;
const LEGEND_LINE: u32 = 18;
const FONT: &str = "sans-serif";
/// Colours that stay apart for most kinds of colour blindness (Okabe & Ito 2008), then grey.
const COLORS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
    RGBColor(140, 140, 140),
];

/// A picture of the panels side by side, with one legend below.
///
/// # Errors
/// When the picture cannot be laid out.
pub fn svg(panels: &[Panel]) -> io::Result<String> {
    let mut names: Vec<&str> = Vec::new();
    for series in panels.iter().flat_map(|p| &p.series) {
        if !names.contains(&series.name.as_str()) {
            names.push(&series.name);
        }
    }
    let mut text = String::new();
    draw(panels, &names, &mut text).map_err(|e| io::Error::other(e.to_string()))?;
    Ok(text)
}

type Failure<'a> = DrawingAreaErrorKind<<SVGBackend<'a> as DrawingBackend>::ErrorType>;

fn draw<'a>(panels: &[Panel], names: &[&str], text: &'a mut String) -> Result<(), Failure<'a>> {
    let width = PANEL_WIDTH * panels.len().max(1) as u32;
    let height = PANEL_HEIGHT + LEGEND_LINE * names.len() as u32 + 10;
    let root = SVGBackend::with_string(text, (width, height)).into_drawing_area();
    root.fill(&WHITE)?;
    let (top, below) = root.split_vertically(PANEL_HEIGHT);
    for (panel, area) in panels.iter().zip(top.split_evenly((1, panels.len().max(1)))) {
        axes(panel, names, &area)?;
    }
    for (at, name) in names.iter().enumerate() {
        let y = (at as u32 * LEGEND_LINE + 8) as i32;
        below.draw(&Rectangle::new([(40, y - 2), (64, y + 2)], color(at).filled()))?;
        below.draw(&Text::new((*name).to_owned(), (72, y - 7), (FONT, 13)))?;
    }
    root.present()
}

fn color(at: usize) -> RGBColor {
    COLORS[at % COLORS.len()]
}

fn axes<'a>(
    panel: &Panel,
    names: &[&str],
    area: &DrawingArea<SVGBackend<'a>, Shift>,
) -> Result<(), Failure<'a>> {
    let (x, y) = ranges(panel);
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .caption(&panel.title, (FONT, 15))
        .x_label_area_size(40)
        .y_label_area_size(52)
        .build_cartesian_2d(x.0..x.1, y.0..y.1)?;
    let named = |x: &f64| match panel.x_names.get(x.round().max(0.0) as usize) {
        Some(name) if (x - x.round()).abs() < 1e-6 => name.clone(),
        _ => String::new(),
    };
    let plain = |x: &f64| format!("{}", (x * 1e6).round() / 1e6);
    let mut mesh = chart.configure_mesh();
    mesh.x_desc(&panel.x_label).y_desc(&panel.y_label).light_line_style(WHITE);
    mesh.y_label_formatter(&plain);
    if panel.x_names.is_empty() {
        mesh.x_label_formatter(&plain);
    } else {
        mesh.x_label_formatter(&named).x_labels(2 * panel.x_names.len() + 1);
    }
    mesh.draw()?;
    for series in &panel.series {
        let color = color(names.iter().position(|n| *n == series.name).unwrap_or(0));
        if series.line {
            chart.draw_series(LineSeries::new(series.points.iter().copied(), color.stroke_width(2)))?;
        }
        if !series.line || series.points.len() <= 20 {
            chart.draw_series(series.points.iter().map(|&p| Circle::new(p, 3, color.filled())))?;
        }
        for (&(x, _), &(low, high)) in series.points.iter().zip(&series.spread) {
            chart.draw_series([PathElement::new([(x, low), (x, high)], color)])?;
        }
    }
    Ok(())
}

/// Ranges of both axes that hold every point, with some room.
fn ranges(panel: &Panel) -> ((f64, f64), (f64, f64)) {
    let points = || panel.series.iter().flat_map(|s| &s.points);
    let spreads = panel.series.iter().flat_map(|s| &s.spread);
    let ys = || points().map(|p| p.1);
    let span = |values: &mut dyn Iterator<Item = f64>| {
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
    };
    let (mut low, mut high) = span(&mut ys().chain(spreads.flat_map(|s| [s.0, s.1])));
    high = high.max(panel.y_most);
    low = low.min(high);
    // Zero belongs to the axis unless all values are far above it.
    low = if low < 0.5 * high { low.min(0.0) } else { low - 0.1 * (high - low) };
    if high - low < 1e-9 {
        high = low + 1.0;
    }
    let (left, right) = match panel.x_names.len() {
        0 => span(&mut points().map(|p| p.0)),
        n => (-0.5, n as f64 - 0.5),
    };
    let (left, right) = if left < right {
        (left, right)
    } else if left.is_finite() {
        (left - 1.0, left + 1.0)
    } else {
        (0.0, 1.0)
    };
    ((left, right), (low, high))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(points: Vec<(f64, f64)>, line: bool) -> Panel {
        let series = Series { name: "a & b".into(), points, line, spread: vec![(0.2, 0.9)] };
        Panel {
            title: "recall".into(),
            x_label: "keypoints".into(),
            y_label: "%".into(),
            x_names: vec!["1000".into(), "2500".into()],
            series: vec![series],
            y_most: 1.0,
        }
    }

    #[test]
    fn points_lines_spreads_and_names_are_drawn() {
        let text = svg(&[panel(vec![(0.0, 0.5), (1.0, 0.75)], true)]).unwrap();
        assert!(text.starts_with("<svg") && text.trim_end().ends_with("</svg>"));
        assert_eq!(text.matches("<circle").count(), 2);
        for expected in ["1000", "2500", "keypoints", "recall", "a &amp; b"] {
            assert!(text.contains(expected), "{expected} is missing in {text}");
        }
        // A line and a spread in the series' colour.
        assert!(text.matches("#0072B2").count() >= 4, "{text}");
        // Higher values lie higher up.
        let centres: Vec<f64> =
            text.split("cy=\"").skip(1).map(|t| t[..t.find('"').unwrap()].parse().unwrap()).collect();
        assert!(centres[1] < centres[0], "{centres:?}");
    }

    #[test]
    fn nothing_to_draw_is_no_failure() {
        let mut empty = panel(Vec::new(), false);
        empty.x_names.clear();
        empty.series[0].spread.clear();
        assert!(svg(&[empty]).unwrap().contains("</svg>"));
        assert!(svg(&[]).unwrap().contains("</svg>"));
        let same = panel(vec![(0.0, 0.0)], false);
        let single = Panel { y_most: 0.0, x_names: Vec::new(), ..same };
        assert!(svg(&[single]).unwrap().contains("<circle"));
    }
}
