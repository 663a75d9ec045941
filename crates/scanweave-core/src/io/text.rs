//! Plain text clouds: XYZ, PTS, TXT, ASC, CSV.
//!
//! Numbers stand between spaces, tabs, commas or semicolons. `#` and `//` begin
//! a comment. One line of column names and (as in PTS) one line with the number
//! of points may stand before the rows. Where a semicolon separates, a comma is
//! the decimal mark.

use super::colors::channels_to_bytes;
use super::scalar::{counted, parse_number};
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use crate::scan::assemble::{NO_COLORS, assemble};
use std::path::Path;

/// Which columns hold what, from the line of names.
#[derive(Debug, Clone, Copy)]
struct Columns {
    xyz: [usize; 3],
    rgb: Option<[usize; 3]>,
}

/// Reads the points (and colours, where there are any) of a text file's `bytes`.
///
/// Without a line of names the first three columns are coordinates, and colours
/// are columns 4 to 6 (or 5 to 7 of seven, after an intensity) where they hold
/// only whole numbers from 0 to 255.
///
/// # Errors
/// [`Error::File`] for a row that is not numbers, or a count that disagrees with the rows.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<PointCloud> {
    let text = String::from_utf8_lossy(bytes);
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let mut names: Option<Columns> = None;
    let mut promised: Option<usize> = None;
    let mut width = 0;
    let mut values: Vec<f64> = Vec::new();
    let mut xyz: Vec<[f64; 3]> = Vec::new();
    for (index, line) in text.split('\n').enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') || line.starts_with("//") {
            continue;
        }
        let words = split(line);
        let row: Option<Vec<f64>> = words.iter().map(|w| parse_number(w)).collect();
        if xyz.is_empty() {
            if let Some([count]) = row.as_deref()
                && promised.is_none()
                && count.fract() == 0.0
                && *count >= 0.0
            {
                promised = Some(*count as usize);
                continue;
            }
            if row.is_none() && names.is_none() && words.iter().all(|w| parse_number(w).is_none()) {
                names = Some(columns_of(path, &words)?);
                continue;
            }
        }
        let columns = names.map_or([0, 1, 2], |n| n.xyz);
        // Only what is used must be a number: a trailing label does not spoil a row.
        let number = |c: usize| words.get(c).and_then(|w| parse_number(w));
        let (Some(x), Some(y), Some(z)) = (number(columns[0]), number(columns[1]), number(columns[2])) else {
            let found = format!("line {} '{}'", index + 1, line.chars().take(80).collect::<String>());
            let remedy = "remove that line, start it with # if it is a comment, or export the scan again";
            return Err(Error::file(path, found, "at least three numbers", remedy));
        };
        xyz.push([x, y, z]);
        if xyz.len() == 1 {
            width = words.len();
        }
        // Ragged rows keep their coordinates; colours need every row to have them.
        width = width.min(words.len());
        values
            .extend((0..3).map(|k| color_column(names, words.len(), k).and_then(number).unwrap_or(f64::NAN)));
    }
    if let Some(promised) = promised.filter(|&p| p != xyz.len()) {
        let expected = format!("{} as its first line says", counted(promised, "row"));
        let remedy = "copy or export the file again if it is cut short, or correct the count";
        return Err(Error::file(path, counted(xyz.len(), "row"), expected, remedy));
    }
    let named = names.is_some_and(|n| n.rgb.is_some());
    let (rgb, _) = values.as_chunks::<3>();
    let colors = if width >= 6 || named { colors_of(rgb, named) } else { None };
    let at = |i: usize| xyz[i];
    Ok(match colors {
        Some(colors) => assemble(xyz.len(), at, Some(|i: usize| colors[i]), None),
        None => assemble(xyz.len(), at, NO_COLORS, None),
    })
}

/// Words of a row, with decimal commas made points where semicolons separate.
fn split(line: &str) -> Vec<std::borrow::Cow<'_, str>> {
    use std::borrow::Cow;
    if line.contains(';') && line.contains(',') {
        let words = line.split(|c: char| c == ';' || c.is_whitespace()).filter(|w| !w.is_empty());
        return words.map(|w| Cow::Owned(w.replace(',', "."))).collect();
    }
    line.split(|c: char| c == ',' || c == ';' || c.is_whitespace())
        .filter(|w| !w.is_empty())
        .map(Cow::Borrowed)
        .collect()
}

fn columns_of(path: &Path, words: &[std::borrow::Cow<'_, str>]) -> Result<Columns> {
    let clean: Vec<String> =
        words.iter().map(|w| w.trim_matches(['"', '\'', '/', '#']).to_ascii_lowercase()).collect();
    let find = |names: &[&str]| names.iter().find_map(|n| clean.iter().position(|w| w == n));
    let x = find(&["x", "points:0", "x[m]", "x_m", "easting"]);
    let y = find(&["y", "points:1", "y[m]", "y_m", "northing"]);
    let z = find(&["z", "points:2", "z[m]", "z_m", "height", "elevation"]);
    let (Some(x), Some(y), Some(z)) = (x, y, z) else {
        let found = format!("columns [{}]", clean.join(", "));
        let remedy = "name the coordinate columns x, y and z, or remove the line of names";
        return Err(Error::file(path, found, "columns named x, y and z", remedy));
    };
    let rgb = match (find(&["r", "red"]), find(&["g", "green"]), find(&["b", "blue"])) {
        (Some(r), Some(g), Some(b)) => Some([r, g, b]),
        _ => None,
    };
    Ok(Columns { xyz: [x, y, z], rgb })
}

/// Column of colour channel `k` in a row of `width` columns.
fn color_column(names: Option<Columns>, width: usize, k: usize) -> Option<usize> {
    match names {
        Some(names) => names.rgb.map(|rgb| rgb[k]),
        // x y z intensity r g b (PTS)
        None if width == 7 => Some(4 + k),
        None if width >= 6 => Some(3 + k),
        None => None,
    }
}

/// Colours, if that is what the values are: named so, or whole numbers from 0 to 255 that
/// are not all 0, 1 (which would be normals along the axes).
fn colors_of(values: &[[f64; 3]], named: bool) -> Option<Vec<[u8; 3]>> {
    let mut all = values.iter().flatten();
    let bytes =
        all.clone().all(|v| v.fract() == 0.0 && (0.0..=255.0).contains(v)) && all.clone().any(|&v| v > 1.0);
    let usable = bytes || (named && all.all(|v| v.is_finite()));
    if !usable {
        return None;
    }
    Some(channels_to_bytes(values))
}
