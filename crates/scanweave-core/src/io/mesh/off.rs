//! OFF (Object File Format), with normals (NOFF) and colours (COFF).

use super::{Mesh, bad_line, three};
use crate::error::{Error, Result};
use crate::io::colors::channels_to_bytes;
use crate::io::scalar::{counted, parse_number};
use crate::io::vertices::Vertices;
use std::path::Path;

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let text = String::from_utf8_lossy(bytes);
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let mut lines = text
        .lines()
        .enumerate()
        .map(|(index, line)| (index, line.split('#').next().unwrap_or_default().trim()))
        .filter(|(_, line)| !line.is_empty());
    let (form, (index, counts)) = header(path, &mut lines)?;
    let mut numbers = counts.split_ascii_whitespace().map(|w| w.parse::<usize>().ok());
    let (Some(Some(count)), Some(Some(faces))) = (numbers.next(), numbers.next()) else {
        return Err(bad_line(path, index, counts, "the numbers of vertices, faces and edges"));
    };
    let mut vertices = Vertices::default();
    let mut colors: Vec<[f64; 3]> = Vec::new();
    for row in 0..count {
        let Some((index, line)) = lines.next() else {
            let expected = format!("{} as its header says", counted(count, "vertex line"));
            let remedy = "copy or export the file again: it is cut short";
            return Err(Error::file(path, counted(row, "vertex line"), expected, remedy));
        };
        let mut words = line.split_ascii_whitespace();
        let bad = || bad_line(path, index, line, "the numbers of a vertex");
        vertices.xyz.push(three(&mut words).ok_or_else(bad)?);
        if form.normals {
            three(&mut words).ok_or_else(bad)?;
        }
        // A fourth number of the colour is its opacity.
        if form.colors {
            colors.extend(three(&mut words));
        }
    }
    vertices.rgb = (form.colors && colors.len() == count).then(|| channels_to_bytes(&colors));
    Ok(Mesh { vertices, surfaces: faces > 0 })
}

/// What the first word says of the vertex lines.
struct Form {
    normals: bool,
    colors: bool,
}

/// The form, and the line with the counts: the first, or the rest of it, or the one after.
fn header<'a>(
    path: &Path,
    lines: &mut impl Iterator<Item = (usize, &'a str)>,
) -> Result<(Form, (usize, &'a str))> {
    let remedy = "export it again as text OFF or as PLY";
    let (index, first) = lines.next().unwrap_or_default();
    let (keyword, rest) = match first.split_once(char::is_whitespace) {
        Some((keyword, rest)) => (keyword, rest.trim()),
        None => (first, ""),
    };
    // The keyword may be missing.
    if parse_number(keyword).is_some() {
        return Ok((Form { normals: false, colors: false }, (index, first)));
    }
    let Some(prefix) = keyword.strip_suffix("OFF") else {
        let found = format!("a first line '{}'", first.chars().take(40).collect::<String>());
        return Err(Error::not_a_scan(path, found, "OFF, COFF or NOFF", remedy));
    };
    // Coordinates of textures (ST) come last in a line, so that they need no care.
    let form = Form { normals: prefix.contains('N'), colors: prefix.contains('C') };
    if prefix.contains(['4', 'n']) || rest.starts_with("BINARY") {
        let found = format!("a file of the kind '{}'", first.chars().take(40).collect::<String>());
        return Err(Error::file(path, found, "text with three coordinates a vertex", remedy));
    }
    if !rest.is_empty() {
        return Ok((form, (index, rest)));
    }
    match lines.next() {
        Some(counts) => Ok((form, counts)),
        None => Err(Error::file(path, "no line after the first", "the number of vertices", remedy)),
    }
}
