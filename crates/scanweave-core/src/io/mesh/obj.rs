//! Wavefront OBJ: lines `v x y z`, with a colour after them where there is one.

use super::{Mesh, bad_line, three};
use crate::error::{Error, Result};
use crate::io::colors::channels_to_bytes;
use crate::io::scalar::parse_number;
use crate::io::vertices::Vertices;
use std::path::Path;

pub(super) fn read(path: &Path, bytes: &[u8], attributes: bool) -> Result<Mesh> {
    let text = String::from_utf8_lossy(bytes);
    let mut vertices = Vertices::default();
    let mut colors: Vec<[f64; 3]> = Vec::new();
    let mut normals: Vec<[f32; 3]> = Vec::new();
    let mut surfaces = false;
    for (index, line) in text.lines().enumerate() {
        let mut words = line.split('#').next().unwrap_or_default().split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let bad = || bad_line(path, index, line, "three numbers after v");
                vertices.xyz.push(three(&mut words).ok_or_else(bad)?);
                colors.extend(color(words));
            }
            Some("vn") if attributes => {
                let bad = || bad_line(path, index, line, "three numbers after vn");
                normals.push(three(&mut words).ok_or_else(bad)?.map(|v| v as f32));
            }
            Some("f") => surfaces = true,
            _ => {}
        }
    }
    if vertices.xyz.is_empty() {
        // Compilers give this extension to files of their own.
        let remedy = "export the scan again as OBJ or PLY";
        return Err(Error::not_a_scan(path, "no line that begins with v", "lines 'v x y z'", remedy));
    }
    let n = vertices.xyz.len();
    vertices.rgb = (colors.len() == n).then(|| channels_to_bytes(&colors));
    // Faces may join any normal to any vertex; as many of both are normals of the vertices.
    vertices.normal = (normals.len() == n).then_some(normals);
    Ok(Mesh { vertices, surfaces })
}

/// The colour after the coordinates, or after a weight that stands between.
fn color<'a>(words: impl Iterator<Item = &'a str>) -> Option<[f64; 3]> {
    let mut rest = [0.0; 4];
    let mut count = 0;
    for word in words.take(4) {
        rest[count] = parse_number(word)?;
        count += 1;
    }
    match count {
        3 => Some([rest[0], rest[1], rest[2]]),
        4 => Some([rest[1], rest[2], rest[3]]),
        _ => None,
    }
}
