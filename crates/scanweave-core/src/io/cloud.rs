//! One entry for every cloud format: content first, extension second.

use super::scalar::counted;
use super::scan_file::{ReadOptions, ScanFile};
use super::{depth, e57, las, mesh, npy, npz, pcd, ply, text};
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use std::fs;
use std::path::Path;

/// Formats [`read_file`] can tell apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Ply,
    Pcd,
    Text,
    Npy,
    Npz,
    Las,
    E57,
    DepthPng,
    Mesh,
}

/// What to give instead of a file that cannot be read, for messages.
pub(super) const FORMATS: &str =
    "PLY, PCD, XYZ/PTS/TXT/ASC/CSV text, NPY, NPZ, LAS/LAZ, E57, OBJ/OFF/STL/GLB or a 16-bit depth PNG";

/// Reads the only scan of a file, with the options' defaults: see [`read_file`].
///
/// # Errors
/// Those of [`read_file`]; [`Error::File`] for a file of several scans.
pub fn read_cloud(path: impl AsRef<Path>) -> Result<PointCloud> {
    let path = path.as_ref();
    let mut scans = read_file(path, &ReadOptions::default())?.scans;
    match scans.len() {
        1 => Ok(scans.swap_remove(0).cloud),
        n => {
            let remedy = "register the file, which takes them as scans of their own, or export one of them";
            Err(Error::file(path, counted(n, "scan"), "a file of one scan", remedy))
        }
    }
}

/// Reads all scans of a file. The format is told by the file's first bytes, and by its
/// extension where those are plain text.
///
/// Rows with non-finite coordinates are dropped and counted; coordinates that are large beside their
/// spread are moved to a rounded `origin_m`. A depth PNG is back-projected with
/// the intrinsics found beside it (see [`depth::find_intrinsics`]).
/// An empty cloud is not an error here; [`read_scans`](super::read_scans) refuses it.
///
/// # Errors
/// [`Error::Read`] when the system refuses, [`Error::NotAScan`] when the content is something else,
/// [`Error::File`] when it cannot be used; a file that ends early says what was found and what its
/// header promised.
pub fn read_file(path: &Path, options: &ReadOptions) -> Result<ScanFile> {
    if path.is_dir() {
        let remedy = "name a file in it, or pass the folder as an input of its own";
        return Err(Error::file(path, "a folder", "a scan file", remedy));
    }
    let bytes = fs::read(path).map_err(|e| Error::read(path, e))?;
    if bytes.is_empty() {
        return Err(Error::file(path, "an empty file", FORMATS, "export or copy the scan again"));
    }
    let format = format_of(path, &bytes)?;
    let mut file: ScanFile = match format {
        Format::Ply => ply::read(path, &bytes, options)?,
        Format::Pcd => pcd::read(path, &bytes, options)?,
        Format::Text => text::read(path, &bytes)?.into(),
        Format::Npy => npy::read(path, &bytes, options)?,
        Format::Npz => npz::read(path, &bytes, options)?,
        Format::Las => las::read(path)?.into(),
        Format::E57 => e57::read(path)?.into(),
        Format::Mesh => mesh::read(path, &bytes, options)?,
        Format::DepthPng => {
            let intrinsics = depth::find_intrinsics(path)?;
            depth::decode_depth_png(path, &bytes)?.to_cloud(&intrinsics, depth::UNITS_PER_M)?.into()
        }
    };
    // Text may say its own unit, and the depth of images has one of its own.
    if let Some(unit_m) = options.unit_m.filter(|_| !matches!(format, Format::Text | Format::DepthPng)) {
        for scan in &mut file.scans {
            scan.cloud.scale(unit_m);
            scan.pose.iter_mut().for_each(|pose| pose.translation.vector *= unit_m);
        }
    }
    Ok(file)
}

fn format_of(path: &Path, bytes: &[u8]) -> Result<Format> {
    let begins = |magic: &[u8]| bytes.starts_with(magic);
    if begins(b"ply\n") || begins(b"ply\r") || begins(b"ply ") {
        return Ok(Format::Ply);
    }
    if begins(b"\x93NUMPY") {
        return Ok(Format::Npy);
    }
    if begins(b"PK\x03\x04") || begins(b"PK\x05\x06") {
        return Ok(Format::Npz);
    }
    if begins(b"LASF") {
        return Ok(Format::Las);
    }
    if begins(b"ASTM-E57") {
        return Ok(Format::E57);
    }
    if begins(b"\x89PNG") {
        return Ok(Format::DepthPng);
    }
    if mesh::is_mesh(path, bytes) {
        return Ok(Format::Mesh);
    }
    if looks_like_pcd(bytes) {
        return Ok(Format::Pcd);
    }
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let is_text = matches!(extension.as_str(), "xyz" | "pts" | "txt" | "asc" | "csv" | "xyzrgb" | "xyzn");
    let head = &bytes[..bytes.len().min(512)];
    if is_text && !head.contains(&0) {
        return Ok(Format::Text);
    }
    let start: String = String::from_utf8_lossy(&head[..head.len().min(12)]).escape_debug().collect();
    let found = format!("a file that begins with '{start}'");
    let (expected, remedy) = if is_text {
        ("lines of numbers".to_owned(), "name the file after its real format")
    } else {
        (
            FORMATS.to_owned(),
            "export the scan in one of these; plain text needs the extension .xyz, .pts, .txt, .asc or .csv",
        )
    };
    Err(Error::file(path, found, expected, remedy))
}

/// PCD has no magic: its first line that is no comment begins with VERSION or FIELDS.
fn looks_like_pcd(bytes: &[u8]) -> bool {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(1024)]).into_owned();
    let first = head.lines().map(str::trim).find(|l| !l.is_empty() && !l.starts_with('#'));
    head.starts_with("# .PCD") || first.is_some_and(|l| l.starts_with("VERSION") || l.starts_with("FIELDS"))
}
