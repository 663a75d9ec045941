//! Meshes, of which the vertices are taken as points.

mod glb;
mod obj;
mod off;
mod stl;
#[cfg(test)]
mod tests;

use super::scalar::parse_number;
use super::scan_file::{Note, ReadOptions, ScanFile};
use super::vertices::Vertices;
use crate::error::{Error, Result};
use std::path::Path;

/// What a file of a mesh gives.
struct Mesh {
    vertices: Vertices,
    /// Whether it has surfaces, and is not a cloud in a mesh's format.
    surfaces: bool,
}

/// Whether a file is a mesh: GLB by its first bytes, the others by their extensions, as text has no magic.
pub(super) fn is_mesh(path: &Path, bytes: &[u8]) -> bool {
    bytes.starts_with(glb::MAGIC) || matches!(extension(path).as_str(), "obj" | "off" | "stl" | "gltf")
}

fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

/// Reads the vertices of a mesh; `name` tells its extension where it was packed in `path`.
///
/// # Errors
/// [`Error::File`] when it is damaged or packed in a way that is not read, [`Error::NotAScan`] when it is
/// something else.
pub(super) fn read(path: &Path, name: &Path, bytes: &[u8], options: &ReadOptions) -> Result<ScanFile> {
    let mesh = match extension(name).as_str() {
        _ if bytes.starts_with(glb::MAGIC) => glb::read(path, bytes)?,
        "obj" => obj::read(path, bytes, options.attributes)?,
        "off" => off::read(path, bytes)?,
        "stl" => stl::read(path, bytes)?,
        _ => {
            let found = "a glTF file whose data lie elsewhere or are written as text";
            let remedy = "export it as GLB, which holds everything in one file";
            return Err(Error::file(path, found, "the binary form of glTF (.glb)", remedy));
        }
    };
    let file: ScanFile = mesh.vertices.into_cloud().into();
    // How many vertices it has is left out, as that differs between files that are read alike.
    let note = "a mesh: its vertices are taken as points (sample its surface for more)";
    Ok(if mesh.surfaces { file.with(Note::info(note)) } else { file })
}

/// The next three words as numbers.
fn three<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<[f64; 3]> {
    let mut next = || parse_number(words.next()?);
    Some([next()?, next()?, next()?])
}

/// Line `index`, counted from zero, has a word where a number belongs.
fn bad_line(path: &Path, index: usize, line: &str, expected: &str) -> Error {
    let found = format!("line {} '{}'", index + 1, line.trim().chars().take(80).collect::<String>());
    Error::file(path, found, expected, "correct that line, or copy or export the file again")
}
