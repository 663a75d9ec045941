//! One entry for every cloud format: content first, extension second.

use super::packed::{self, Unpacked};
use super::scalar::counted;
use super::scan_file::{ReadOptions, ScanFile};
use super::unpack_limit::UnpackLimit;
use super::{bin, depth, e57, las, mesh, npy, npz, pcd, ply, ptx, text};
use crate::error::{Error, Result};
use crate::files;
use crate::printable::printable;
use crate::scan::PointCloud;
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::Path;

/// Formats [`read_file`] can tell apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Ply,
    Pcd,
    Ptx,
    Text,
    Npy,
    Npz,
    Las,
    E57,
    Bin,
    DepthPng,
    Mesh,
    Gzip,
    Zip,
}

/// What to give instead of a file that cannot be read, for messages.
pub(super) const FORMATS: &str = "PLY, PCD, XYZ/PTS/TXT/ASC/CSV text, PTX, NPY, NPZ, LAS/LAZ, E57, KITTI BIN, \
                                  OBJ/OFF/STL/GLB, a 16-bit depth PNG, or one of these in a .gz or .zip";

/// Bytes at the start of a file that tell its format.
pub(super) const HEAD_BYTES: u64 = 4096;

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
/// extension where those are plain text or bare numbers. A `.gz` or `.zip` of one scan is unpacked first.
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
    let refused = |e| Error::read(path, e);
    let mut file = files::open(path)?;
    let size = file.metadata().map_err(refused)?.len();
    let mut head = Vec::new();
    file.by_ref().take(HEAD_BYTES).read_to_end(&mut head).map_err(refused)?;
    if head.is_empty() {
        return Err(Error::file(path, "an empty file", FORMATS, "export or copy the scan again"));
    }
    let format = format_of(path, path, &head)?;
    let limit = UnpackLimit::of_scan(options, size);
    // From the size of the file, whatever it holds: what is packed twice is not allowed more for it.
    let options = &limit.kept_in(options);
    let rewound = |mut file: File| file.rewind().map(|()| BufReader::new(file)).map_err(refused);
    // Scanners' files can be larger than memory allows to hold beside their points.
    let read = match format {
        Format::Las => las::read(path, rewound(file)?, options)?,
        Format::E57 => e57::read(path, rewound(file)?, options)?,
        Format::Gzip => return read_unpacked(path, packed::gunzip(path, rewound(file)?, limit)?, options),
        Format::Zip => return read_unpacked(path, packed::unzip(path, rewound(file)?, limit)?, options),
        _ => {
            file.read_to_end(&mut head).map_err(refused)?;
            return read_bytes(path, path, head, options);
        }
    };
    Ok(in_metres(read, format, options))
}

fn read_unpacked(path: &Path, unpacked: Unpacked, options: &ReadOptions) -> Result<ScanFile> {
    read_bytes(path, &unpacked.name, unpacked.bytes, options)
}

/// Reads all scans of a file's content. `name` tells its extension where it was packed in `path`.
fn read_bytes(path: &Path, name: &Path, bytes: Vec<u8>, options: &ReadOptions) -> Result<ScanFile> {
    let head = &bytes[..bytes.len().min(HEAD_BYTES as usize)];
    let format = format_of(path, name, head)?;
    let read = match format {
        Format::Ply => ply::read(path, &bytes, options)?,
        Format::Pcd => pcd::read(path, &bytes, options)?,
        Format::Ptx => ptx::read(path, &bytes, options)?,
        Format::Text => text::read(path, &bytes, options)?,
        Format::Npy => npy::read(path, &bytes, options)?,
        Format::Npz => npz::read(path, &bytes, options)?,
        Format::Mesh => mesh::read(path, name, &bytes, options)?,
        Format::Las => las::read(path, Cursor::new(bytes), options)?,
        Format::E57 => e57::read(path, Cursor::new(bytes), options)?,
        Format::Bin => bin::read(path, &bytes, options)?,
        Format::DepthPng => depth::read(path, &bytes, options)?,
        Format::Gzip | Format::Zip => return Err(packed::packed_twice(path, name)),
    };
    Ok(in_metres(read, format, options))
}

/// The scans in metres, where the user says what one unit is.
fn in_metres(mut file: ScanFile, format: Format, options: &ReadOptions) -> ScanFile {
    // Text may say its own unit, and the depth of images has one of its own.
    if let Some(unit_m) = options.unit_m.filter(|_| !matches!(format, Format::Text | Format::DepthPng)) {
        for scan in &mut file.scans {
            scan.cloud.scale(unit_m);
            scan.pose.iter_mut().for_each(|pose| pose.translation.vector *= unit_m);
            scan.pose = scan.pose.filter(|pose| pose.translation.vector.iter().all(|v| v.is_finite()));
        }
    }
    file
}

/// The format of the content that begins with `head`; `name` tells the extension, `path` is for messages.
///
/// # Errors
/// [`Error::File`] for content that is none.
pub(super) fn format_of(path: &Path, name: &Path, head: &[u8]) -> Result<Format> {
    let extension = name.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match format_by_content(head) {
        // An archive of NumPy arrays is one scan.
        Some(Format::Zip) if extension == "npz" => return Ok(Format::Npz),
        Some(format) => return Ok(format),
        None if mesh::is_mesh(name, head) => return Ok(Format::Mesh),
        None => {}
    }
    let is_text = matches!(extension.as_str(), "xyz" | "pts" | "txt" | "asc" | "csv" | "xyzrgb" | "xyzn");
    let plain = !head[..head.len().min(512)].contains(&0) || text::is_utf16(head);
    match extension.as_str() {
        "ptx" if plain => return Ok(Format::Ptx),
        "bin" => return Ok(Format::Bin),
        _ if is_text && plain => return Ok(Format::Text),
        _ => {}
    }
    let start = String::from_utf8_lossy(&head[..head.len().min(12)]);
    let start = printable(&start);
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

/// The format that the first bytes tell, whatever the file is named.
fn format_by_content(head: &[u8]) -> Option<Format> {
    let begins = |magic: &[u8]| head.starts_with(magic);
    Some(if begins(b"ply\n") || begins(b"ply\r") || begins(b"ply ") {
        Format::Ply
    } else if begins(b"\x93NUMPY") {
        Format::Npy
    } else if begins(b"PK\x03\x04") || begins(b"PK\x05\x06") {
        Format::Zip
    } else if begins(b"\x1f\x8b") {
        Format::Gzip
    } else if begins(b"LASF") {
        Format::Las
    } else if begins(b"ASTM-E57") {
        Format::E57
    } else if depth::is_image(head) {
        Format::DepthPng
    } else if looks_like_pcd(head) {
        Format::Pcd
    } else if ptx::begins(head) {
        Format::Ptx
    } else {
        return None;
    })
}

/// PCD has no magic: its first line that is no comment begins with VERSION or FIELDS.
fn looks_like_pcd(bytes: &[u8]) -> bool {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(1024)]).into_owned();
    let first = head.lines().map(str::trim).find(|l| !l.is_empty() && !l.starts_with('#'));
    head.starts_with("# .PCD") || first.is_some_and(|l| l.starts_with("VERSION") || l.starts_with("FIELDS"))
}
