//! STL, as text and binary. Triangles do not share vertices there, so equal ones are taken once.

use super::{Mesh, bad_line, three};
use crate::error::{Error, Result};
use crate::io::scalar::{Endian, Scalar, counted};
use crate::io::vertices::Vertices;
use std::collections::HashSet;
use std::path::Path;

const HEADER_BYTES: usize = 84;
/// A normal, three corners and two bytes more.
const TRIANGLE_BYTES: usize = 50;

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let count =
        bytes.get(80..84).and_then(|b| b.first_chunk()).map_or(0, |b| u32::from_le_bytes(*b) as usize);
    let needed = count.saturating_mul(TRIANGLE_BYTES).saturating_add(HEADER_BYTES);
    // Binary files may begin with 'solid' as well; their length tells.
    if bytes.len() >= HEADER_BYTES && bytes.len() == needed {
        return Ok(mesh(binary(bytes)));
    }
    if bytes.trim_ascii_start().starts_with(b"solid") && !bytes[..bytes.len().min(1024)].contains(&0) {
        return text(path, bytes);
    }
    let expected = format!("{needed} bytes for {} as its header says", counted(count, "triangle"));
    let remedy = "copy or export the file again";
    Err(Error::file(path, counted(bytes.len(), "byte"), expected, remedy))
}

fn binary(bytes: &[u8]) -> impl Iterator<Item = [f64; 3]> {
    let (triangles, _) = bytes[HEADER_BYTES..].as_chunks::<TRIANGLE_BYTES>();
    triangles.iter().flat_map(|triangle| {
        let number = |at: usize| Scalar::F32.read(&triangle[at..], Endian::Little);
        [12, 24, 36].map(|at| [number(at), number(at + 4), number(at + 8)])
    })
}

fn text(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let text = String::from_utf8_lossy(bytes);
    let mut corners = Vec::new();
    let mut ended = false;
    for (index, line) in text.lines().enumerate() {
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("vertex") => {
                let bad = || bad_line(path, index, line, "three numbers after vertex");
                corners.push(three(&mut words).ok_or_else(bad)?);
            }
            Some(word) => ended = word == "endsolid",
            None => {}
        }
    }
    if !ended {
        let found = format!("{} and no end", counted(corners.len() / 3, "triangle"));
        let remedy = "copy or export the file again: it is cut short";
        return Err(Error::file(path, found, "a line endsolid at the end", remedy));
    }
    Ok(mesh(corners.into_iter()))
}

fn mesh(corners: impl Iterator<Item = [f64; 3]>) -> Mesh {
    let mut seen = HashSet::new();
    let mut xyz = Vec::new();
    for corner in corners {
        // The sum makes one zero of both.
        if seen.insert(corner.map(|v| (v + 0.0).to_bits())) {
            xyz.push(corner);
        }
    }
    Mesh { vertices: Vertices { xyz, ..Vertices::default() }, surfaces: true }
}
