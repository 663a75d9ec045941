//! NPY and NPZ arrays (NumPy), and clouds `[n,3]` in them.
//!
//! The header is read here rather than through `ndarray-npy`, which reserves
//! whatever shape a header claims and needs the number type to be known before.

use super::scalar::{Endian, Scalar};
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use crate::scan::assemble::{NO_COLORS, assemble};
use std::io::{Cursor, Read};
use std::path::Path;

/// A dense array of numbers, row-major.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Array {
    pub shape: Vec<usize>,
    pub values: Vec<f64>,
}

impl Array {
    /// `[rows, columns]` of a two-dimensional array.
    pub(super) fn matrix(&self) -> Option<(usize, usize)> {
        match self.shape[..] {
            [rows, columns] => Some((rows, columns)),
            _ => None,
        }
    }

    /// The first three columns of `[n, >=3]`.
    pub(super) fn points(&self) -> Option<Vec<[f64; 3]>> {
        let (_, columns) = self.matrix().filter(|&(_, c)| c >= 3)?;
        Some(self.values.chunks_exact(columns).map(|r| [r[0], r[1], r[2]]).collect())
    }
}

/// Largest array entry taken out of an archive: far above any scan, far below what a bomb asks for.
const ENTRY_LIMIT_BYTES: u64 = 1 << 33;

/// Reads one array from the bytes of an NPY file; `label` names it in messages (its key in an NPZ).
///
/// # Errors
/// [`Error::File`] for another number type than integers and floats, or fewer bytes than the shape needs.
pub(super) fn read_array(path: &Path, label: &str, bytes: &[u8]) -> Result<Array> {
    let bad = |found: String, expected: &str| {
        Error::file(path, format!("{label}{found}"), expected, "save it again with numpy.save or numpy.savez")
    };
    let (header, data) = split_header(bytes).ok_or_else(|| {
        bad(format!("{} bytes that are no NPY array", bytes.len()), "an NPY header and data")
    })?;
    let descr = quoted(entry(header, "descr").unwrap_or("")).unwrap_or("");
    let (scalar, endian) = scalar_of(descr)
        .ok_or_else(|| bad(format!("elements of type '{descr}'"), "integers or 32/64-bit floats"))?;
    let shape = shape_of(entry(header, "shape").unwrap_or(""))
        .ok_or_else(|| bad("no shape".into(), "a shape (n, 3)"))?;
    let count = shape.iter().try_fold(1usize, |n, &d| n.checked_mul(d));
    let needed = count.and_then(|n| n.checked_mul(scalar.size()));
    let Some(data) = needed.and_then(|n| data.get(..n)) else {
        let needed = needed.map_or_else(|| "more".to_owned(), |n| n.to_string());
        let expected = format!("{needed} bytes for shape {shape:?} as its header says");
        return Err(Error::file(
            path,
            format!("{label}{} bytes of data", data.len()),
            expected,
            "copy or save the file again: it is cut short",
        ));
    };
    let mut values: Vec<f64> = data.chunks_exact(scalar.size()).map(|b| scalar.read(b, endian)).collect();
    if entry(header, "fortran_order").is_some_and(|v| v.starts_with("True")) {
        values = row_major(&values, &shape).ok_or_else(|| {
            bad(
                format!("column-major data of shape {shape:?}"),
                "at most two dimensions in column-major order",
            )
        })?;
    }
    Ok(Array { shape, values })
}

fn row_major(values: &[f64], shape: &[usize]) -> Option<Vec<f64>> {
    match *shape {
        [] | [_] => Some(values.to_vec()),
        [rows, columns] => {
            Some((0..rows).flat_map(|r| (0..columns).map(move |c| values[c * rows + r])).collect())
        }
        _ => None,
    }
}

/// Header text and what follows it.
fn split_header(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let rest = bytes.strip_prefix(b"\x93NUMPY")?;
    let (length, from) = match *rest.first()? {
        1 => (usize::from(u16::from_le_bytes(*rest.get(2..4)?.first_chunk()?)), 4),
        _ => (u32::from_le_bytes(*rest.get(2..6)?.first_chunk()?) as usize, 6),
    };
    let header = rest.get(from..)?.get(..length)?;
    Some((std::str::from_utf8(header).ok()?, &rest[from + length..]))
}

/// What follows `'key':` in the header's Python dictionary.
fn entry<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    ['\'', '"'].iter().find_map(|q| {
        let (_, after) = header.split_once(&format!("{q}{key}{q}"))?;
        Some(after.trim_start().strip_prefix(':')?.trim_start())
    })
}

fn quoted(text: &str) -> Option<&str> {
    let quote = text.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
    text[1..].split(quote).next()
}

fn shape_of(text: &str) -> Option<Vec<usize>> {
    let inner = text.strip_prefix('(')?.split(')').next()?;
    inner
        .split(',')
        .map(str::trim)
        .filter(|t| !t.is_empty())
        .map(|t| t.trim_end_matches('L').parse().ok())
        .collect()
}

fn scalar_of(descr: &str) -> Option<(Scalar, Endian)> {
    let endian = if descr.starts_with('>') { Endian::Big } else { Endian::Little };
    let scalar = match descr.trim_start_matches(['<', '>', '|', '=']) {
        "f4" => Scalar::F32,
        "f8" => Scalar::F64,
        "i1" => Scalar::I8,
        "u1" => Scalar::U8,
        "i2" => Scalar::I16,
        "u2" => Scalar::U16,
        "i4" => Scalar::I32,
        "u4" => Scalar::U32,
        "i8" => Scalar::I64,
        "u8" => Scalar::U64,
        _ => return None,
    };
    Some((scalar, endian))
}

/// All arrays of an NPZ archive with their keys, in the archive's order.
///
/// # Errors
/// [`Error::File`] when the archive or an array in it is damaged.
pub(super) fn read_archive(path: &Path, bytes: &[u8]) -> Result<Vec<(String, Array)>> {
    let damaged = |what: String| {
        Error::file(
            path,
            what,
            "an NPZ archive of NPY arrays",
            "save it again with numpy.savez, or copy it again",
        )
    };
    let mut archive =
        zip::ZipArchive::new(Cursor::new(bytes)).map_err(|e| damaged(format!("a damaged archive ({e})")))?;
    let mut arrays = Vec::new();
    for index in 0..archive.len() {
        let entry = archive.by_index(index).map_err(|e| damaged(format!("a damaged entry {index} ({e})")))?;
        let Some(key) = entry.name().strip_suffix(".npy").map(str::to_owned) else { continue };
        let mut data = Vec::new();
        entry
            .take(ENTRY_LIMIT_BYTES)
            .read_to_end(&mut data)
            .map_err(|e| damaged(format!("a damaged array '{key}' ({e})")))?;
        // Arrays of text or objects may stand beside the numbers; whoever needs one by name will miss it.
        match read_array(path, &format!("array '{key}': "), &data) {
            Ok(array) => arrays.push((key, array)),
            Err(error) if WANTED.contains(&key.as_str()) => return Err(error),
            Err(_) => {}
        }
    }
    Ok(arrays)
}

/// Keys under which an archive's points are looked for, best first.
const CLOUD_KEYS: [&str; 5] = ["points", "xyz", "keypoints", "pcd", "pc"];
/// Keys whose damage is an error even where other arrays are sound.
const WANTED: [&str; 7] = ["points", "xyz", "keypoints", "pcd", "pc", "descriptors", "normals"];

/// Reads a cloud from the bytes of an NPY file.
pub(super) fn read_npy(path: &Path, bytes: &[u8]) -> Result<PointCloud> {
    cloud(path, &read_array(path, "", bytes)?)
}

/// Reads a cloud from an NPZ archive: `points`, `xyz`, `keypoints`, or its only array.
pub(super) fn read_npz(path: &Path, bytes: &[u8]) -> Result<PointCloud> {
    let arrays = read_archive(path, bytes)?;
    let named = CLOUD_KEYS.iter().find_map(|key| arrays.iter().find(|(k, _)| k == key));
    let chosen = named.or(if arrays.len() == 1 { arrays.first() } else { None }).ok_or_else(|| {
        let keys: Vec<&str> = arrays.iter().map(|(k, _)| k.as_str()).collect();
        let found = format!("arrays [{}]", keys.join(", "));
        Error::file(
            path,
            found,
            "an array named points or xyz, or only one array",
            "save the points under that name",
        )
    })?;
    cloud(path, &chosen.1)
}

fn cloud(path: &Path, array: &Array) -> Result<PointCloud> {
    let points = array.points().ok_or_else(|| {
        let found = format!("an array of shape {:?}", array.shape);
        Error::file(path, found, "shape [n, 3] or wider", "save one point a row: x, y, z")
    })?;
    Ok(assemble(points.len(), |i| points[i], NO_COLORS, None))
}
