//! NPZ archives of arrays (NumPy). Only the arrays that are asked for are unpacked, of those no more
//! than their shapes need, and all together no more than the limit.

use super::fields::{INTENSITY, Names, RGB, three};
use super::npy::{self, Array, Color, Column, Columns, Number, View, XYZ};
use super::npy_header::{self, Header};
use super::scan_file::{ReadOptions, ScanFile};
use super::unpack_limit::UnpackLimit;
use crate::error::{Error, Result};
use ndarray_npy::{NpzWriter, WriteNpzError};
use std::io::{Cursor, Read};
use std::path::Path;
use zip::ZipArchive;

/// The arrays of an archive.
pub(super) struct Archive<'a> {
    path: &'a Path,
    zip: ZipArchive<Cursor<&'a [u8]>>,
    limit: UnpackLimit,
    /// Bytes that have been unpacked, a number as four or more: bytes become coordinates of four.
    unpacked: u64,
}

impl<'a> Archive<'a> {
    /// An archive that is kept for the next run, or looked into.
    ///
    /// # Errors
    /// [`Error::File`] when it is no archive.
    pub(super) fn open(path: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        Self::with_limit(path, bytes, UnpackLimit::of_other(bytes.len() as u64))
    }

    /// An archive of so much at most.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub(super) fn with_limit(path: &'a Path, bytes: &'a [u8], limit: UnpackLimit) -> Result<Self> {
        let zip = ZipArchive::new(Cursor::new(bytes))
            .map_err(|e| damaged(path, format!("a damaged archive ({e})")))?;
        Ok(Self { path, zip, limit, unpacked: 0 })
    }

    /// Names of the arrays, in the archive's order.
    pub(super) fn keys(&self) -> Vec<String> {
        self.zip.file_names().filter_map(|n| n.strip_suffix(".npy")).map(str::to_owned).collect()
    }

    /// The array of this name, `None` where there is none.
    ///
    /// # Errors
    /// [`Error::File`] when it is damaged, too large or holds no numbers.
    pub(super) fn array<T: Number>(&mut self, key: &str) -> Result<Option<Array<T>>> {
        let bytes = self.unpack(key)?;
        bytes.map(|bytes| npy::read_array(self.path, &label(key), &bytes)).transpose()
    }

    /// The header of an array and no more of it, where it can be read.
    fn header(&mut self, key: &str) -> Option<Header> {
        let index = self.zip.index_for_name(&format!("{key}.npy"))?;
        let mut entry = self.zip.by_index(index).ok()?;
        let mut bytes = Vec::new();
        read_header(&mut entry, &mut bytes).ok()?;
        Some(npy_header::parse(&bytes)?.0)
    }

    /// The bytes of an array as far as its shape needs them, `None` where there is none of that name.
    fn unpack(&mut self, key: &str) -> Result<Option<Vec<u8>>> {
        let path = self.path;
        let Some(index) = self.zip.index_for_name(&format!("{key}.npy")) else { return Ok(None) };
        let wrong = |e: &dyn std::fmt::Display| damaged(path, format!("a damaged array '{key}' ({e})"));
        let mut entry = self.zip.by_index(index).map_err(|e| wrong(&e))?;
        let mut bytes = Vec::new();
        read_header(&mut entry, &mut bytes).map_err(|e| wrong(&e))?;
        // Without a header there is nothing to unpack; who reads the array says so.
        let Some((header, _)) = npy_header::parse(&bytes) else { return Ok(Some(bytes)) };
        let promised = entry.size().saturating_sub(bytes.len() as u64);
        match header.data_bytes() {
            Some(needed) if needed as u64 <= promised => {
                let numbers = (header.elements().unwrap_or(usize::MAX) as u64).saturating_mul(4);
                self.unpacked = self.unpacked.saturating_add(numbers.max(needed as u64));
                if self.unpacked > self.limit.bytes() {
                    return Err(self.limit.exceeded(path, &format!("array '{key}' and those before it")));
                }
                // One byte more, as the checksum is compared at the end of the entry.
                entry.take(needed as u64 + 1).read_to_end(&mut bytes).map_err(|e| wrong(&e))?;
                Ok(Some(bytes))
            }
            _ => Err(npy::too_short(path, &label(key), &header, promised as usize)),
        }
    }
}

/// The bytes of an archive of arrays, as `add` adds them.
///
/// In memory: a writer of archives that is dropped because its disk is full says so on stderr.
pub(super) fn archive(
    add: impl FnOnce(&mut NpzWriter<Cursor<Vec<u8>>>) -> std::result::Result<(), WriteNpzError>,
) -> std::io::Result<Vec<u8>> {
    let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
    add(&mut npz).map_err(std::io::Error::other)?;
    Ok(npz.finish().map_err(std::io::Error::other)?.into_inner())
}

/// Reads as far as the header goes.
fn read_header(entry: &mut impl Read, bytes: &mut Vec<u8>) -> std::io::Result<()> {
    entry.take(12).read_to_end(bytes)?;
    let more = npy_header::length(bytes).unwrap_or(0).saturating_sub(bytes.len());
    entry.take(more as u64).read_to_end(bytes)?;
    Ok(())
}

fn label(key: &str) -> String {
    format!("array '{key}': ")
}

fn damaged(path: &Path, what: String) -> Error {
    let remedy = "save it again with numpy.savez, or copy it again";
    Error::file(path, what, "an NPZ archive of NPY arrays", remedy)
}

/// Names under which an archive's points are looked for, best first.
const POINTS: Names = &["points", "xyz", "keypoints", "pcd", "pc"];
const COLORS: Names = &["colors", "rgb", "color", "colours"];
const NORMALS: Names = &["normals", "normal"];

/// Reads a cloud from an NPZ archive: the array `points`, `xyz`, …, or three arrays `x`, `y` and `z`, or
/// the only array that can hold points.
///
/// # Errors
/// [`Error::File`] for a damaged archive or array, [`Error::NotAScan`] where no array holds points.
pub(super) fn read(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<ScanFile> {
    let limit = UnpackLimit::of_scan(options, bytes.len() as u64);
    let mut archive = Archive::with_limit(path, bytes, limit)?;
    let keys = archive.keys();
    let find = |names: Names| names.iter().copied().find(|n| keys.iter().any(|k| k == n));
    let apart = find(POINTS).is_none().then(|| three(XYZ, find)).flatten();
    let together = match (find(POINTS), apart) {
        (Some(key), _) => Some(key),
        (None, Some(_)) => None,
        (None, None) => Some(only_points(path, &mut archive, &keys)?),
    };
    let points: Vec<&str> = together.into_iter().chain(apart.into_iter().flatten()).collect();
    let colors = match find(COLORS) {
        Some(key) => vec![key],
        None => three(RGB, find).map_or_else(Vec::new, Vec::from),
    };
    let attribute = |names: Names| find(names).filter(|_| options.attributes);
    let (intensity, normals) = (attribute(INTENSITY), attribute(NORMALS));

    let mut unpacked: Vec<(&str, Vec<u8>)> = Vec::new();
    for &key in points.iter().chain(&colors).chain(&intensity).chain(&normals) {
        unpacked.extend(archive.unpack(key)?.map(|bytes| (key, bytes)));
    }
    let mut views: Vec<(&str, View<'_>)> = Vec::new();
    for (key, bytes) in &unpacked {
        views.push((key, View::new(path, &label(key), bytes)?));
    }
    let view = |key: &str| views.iter().find(|(k, _)| *k == key).map(|(_, view)| view);
    let mut columns = match (together.and_then(|key| Some((key, view(key)?))), apart) {
        (Some((key, view)), _) => view.points().ok_or_else(|| npy::no_points(path, &label(key), view))?,
        (None, Some(keys)) => {
            let (xyz, rows) = same_rows(&keys, &view).ok_or_else(|| {
                let found = "arrays x, y and z that do not belong together";
                Error::not_a_scan(path, found, "one number of every point in each", "save them so")
            })?;
            Columns { rows, xyz, color: None, intensity: None, normal: None }
        }
        (None, None) => return Err(no_array(path, &keys)),
    };
    let rows = columns.rows;
    let wide = |key: &str| view(key)?.columns::<3>().filter(|(_, n)| *n == rows).map(|(c, _)| c);
    let channels = match colors[..] {
        [key] => wide(key),
        _ => same_rows(&colors, &view).filter(|(_, n)| *n == rows).map(|(c, _)| c),
    };
    columns.color = columns.color.or(channels.map(Color::Channels));
    let single = |key| view(key)?.columns::<1>().filter(|(_, n)| *n == rows).map(|([c], _)| c);
    columns.intensity = columns.intensity.or(intensity.and_then(single));
    columns.normal = columns.normal.or(normals.and_then(wide));
    Ok(columns.into_file(options))
}

/// Three arrays of one number a row, and their rows.
fn same_rows<'a, 'v>(
    keys: &[&str],
    view: &impl Fn(&str) -> Option<&'v View<'a>>,
) -> Option<([Column<'a>; 3], usize)>
where
    'a: 'v,
{
    let [x, y, z] = keys else { return None };
    let column = |key: &str| view(key)?.columns::<1>().map(|([c], n)| (c, n));
    let (x, rows) = column(x)?;
    let more = |key: &str| column(key).filter(|(_, n)| *n == rows).map(|(c, _)| c);
    Some(([x, more(y)?, more(z)?], rows))
}

/// The only array that can hold points by its header.
fn only_points<'k>(path: &Path, archive: &mut Archive<'_>, keys: &'k [String]) -> Result<&'k str> {
    if let [only] = keys {
        return Ok(only);
    }
    let mut found = Vec::new();
    for key in keys {
        let header = archive.header(key);
        if header.is_some_and(|h| h.plain().is_some() && matches!(h.shape[..], [_, columns] if columns >= 3))
        {
            found.push(key.as_str());
        }
    }
    match found[..] {
        [only] => Ok(only),
        _ => Err(no_array(path, keys)),
    }
}

fn no_array(path: &Path, keys: &[String]) -> Error {
    let found = format!("arrays [{}]", keys.join(", "));
    let expected = "an array named points or xyz, arrays x, y and z, or only one array of points";
    Error::not_a_scan(path, found, expected, "save the points under that name")
}

#[cfg(test)]
mod tests;
