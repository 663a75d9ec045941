//! Packed scans: one scan in a `.gz` or `.zip`.

use super::cloud::{Format, HEAD_BYTES, format_of};
use super::discover;
use super::scalar::counted;
use crate::error::{Error, Result};
use crate::printable::{printable, printable_path};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Most bytes that a packed file may unpack to.
const LIMIT_BYTES: u64 = 4 << 30;
/// Most bytes that a packed byte may unpack to, beyond [`LIMIT_FLOOR_BYTES`]. Scans pack to a half or a
/// tenth; only files made to exhaust memory come near.
const LIMIT_RATIO: u64 = 1000;
/// What every packed file may unpack to: small files of one repeated number are no bomb.
const LIMIT_FLOOR_BYTES: u64 = 64 << 20;

/// The content of a packed file.
#[derive(Debug)]
pub(super) struct Unpacked {
    /// Name of the content, whose extension tells the format.
    pub name: PathBuf,
    /// The content.
    pub bytes: Vec<u8>,
}

/// Most bytes that so many packed ones are unpacked to.
fn limit_bytes(packed: u64) -> u64 {
    most_bytes(packed).min(LIMIT_BYTES)
}

/// Most bytes that so many packed ones are taken to stand for, where they need not be held at once.
pub(super) fn most_bytes(packed: u64) -> u64 {
    packed.saturating_mul(LIMIT_RATIO).saturating_add(LIMIT_FLOOR_BYTES)
}

/// Unpacks a gzip file; its content is named as the file is, without `.gz`.
///
/// # Errors
/// [`Error::File`] for damaged or too much content, and for content that is no scan.
pub(super) fn gunzip(path: &Path, mut file: BufReader<File>) -> Result<Unpacked> {
    let packed = file.seek(SeekFrom::End(0)).and_then(|size| file.rewind().map(|()| size));
    let packed = packed.map_err(|e| Error::read(path, e))?;
    let name = if discover::has_extension(path, &["gz"]) { path.with_extension("") } else { path.into() };
    let bytes = unpack(path, &name, flate2::bufread::MultiGzDecoder::new(file), limit_bytes(packed))?;
    Ok(Unpacked { name, bytes })
}

/// Unpacks the only scan of a zip archive. An archive of NPY arrays only (an NPZ) is handed back as it is.
///
/// # Errors
/// [`Error::File`] for a damaged archive, for one without a scan or with several, and for too much content.
pub(super) fn unzip(path: &Path, mut file: BufReader<File>) -> Result<Unpacked> {
    let damaged = |e: zip::result::ZipError| {
        Error::file(path, format!("a damaged archive ({e})"), "a ZIP or NPZ archive", "copy or save it again")
    };
    let mut archive = zip::ZipArchive::new(&mut file).map_err(damaged)?;
    let names: Vec<String> = archive.file_names().filter(|n| is_file(n)).map(str::to_owned).collect();
    if !names.is_empty() && names.iter().all(|name| name.ends_with(".npy")) {
        let mut bytes = Vec::new();
        file.rewind().and_then(|()| file.read_to_end(&mut bytes)).map_err(|e| Error::read(path, e))?;
        return Ok(Unpacked { name: path.with_extension("npz"), bytes });
    }
    let name = only_scan(path, &names)?;
    let entry = archive.by_name(&name).map_err(damaged)?;
    // What the archive says of itself is not trusted.
    let limit = limit_bytes(entry.compressed_size());
    let name = PathBuf::from(&name);
    let bytes = unpack(path, &name, entry, limit)?;
    Ok(Unpacked { name, bytes })
}

/// Not a folder, hidden, or what macOS adds to archives.
fn is_file(name: &str) -> bool {
    !name.ends_with('/') && !name.split('/').any(|part| part.starts_with('.') || part == "__MACOSX")
}

/// The only file of an archive, or the only one that is a scan by its extension.
fn only_scan(path: &Path, names: &[String]) -> Result<String> {
    let scans_among = |known: fn(&Path) -> bool| -> Vec<&String> {
        names.iter().filter(|name| known(Path::new(name))).collect()
    };
    let mut scans = scans_among(discover::is_cloud);
    if scans.is_empty() {
        scans = scans_among(discover::is_other);
    }
    match (names, &scans[..]) {
        ([only], _) => Ok(only.clone()),
        (_, [only]) => Ok((*only).clone()),
        (_, []) => {
            let found = format!("an archive of {}", listed("file", names));
            Err(Error::not_a_scan(
                path,
                found,
                "an archive of one scan",
                "unpack it and name the scan itself",
            ))
        }
        (_, several) => {
            let found = format!("an archive of {}", listed("scan", several));
            let remedy = "unpack it into a folder and name the folder";
            Err(Error::file(path, found, "an archive of one scan", remedy))
        }
    }
}

/// The number of files and the first names: "3 scans (a.ply, b.ply, …)".
fn listed(unit: &str, names: &[impl AsRef<str>]) -> String {
    const SHOWN: usize = 5;
    let shown: Vec<&str> = names.iter().take(SHOWN).map(AsRef::as_ref).collect();
    let more = if names.len() > SHOWN { ", …" } else { "" };
    format!("{} ({}{more})", counted(names.len(), unit), printable(&shown.join(", ")))
}

/// All bytes of `content`, which may be at most `limit`. The format is looked at before the rest is
/// unpacked, so that what is no scan costs nothing.
fn unpack(path: &Path, name: &Path, mut content: impl Read, limit: u64) -> Result<Vec<u8>> {
    let damaged = |e: std::io::Error| {
        let found = format!("packed content that cannot be unpacked ({e})");
        Error::file(path, found, "a whole .gz or .zip file", "copy or pack the file again")
    };
    let mut bytes = Vec::new();
    content.by_ref().take(HEAD_BYTES).read_to_end(&mut bytes).map_err(damaged)?;
    if bytes.is_empty() {
        return Err(Error::file(path, "an empty file, packed", "one scan", "pack the scan again"));
    }
    if bytes.get(257..262) == Some(b"ustar") {
        let remedy = "unpack it into a folder and name the folder";
        return Err(Error::file(path, "a tar archive, packed", "one scan, packed", remedy));
    }
    if matches!(format_of(path, name, &bytes)?, Format::Gzip | Format::Zip) {
        return Err(packed_twice(path, name));
    }
    content.take((limit + 1).saturating_sub(bytes.len() as u64)).read_to_end(&mut bytes).map_err(damaged)?;
    if bytes.len() as u64 > limit {
        let found = format!("content of more than {} MiB when unpacked", limit >> 20);
        let expected = format!(
            "at most {} GiB, and {LIMIT_RATIO} times the packed size and {} MiB",
            LIMIT_BYTES >> 30,
            LIMIT_FLOOR_BYTES >> 20
        );
        return Err(Error::file(path, found, expected, "unpack it and name the file itself"));
    }
    Ok(bytes)
}

/// Refuses a packed file in a packed file.
pub(super) fn packed_twice(path: &Path, name: &Path) -> Error {
    let found = format!("a packed file in it ('{}')", printable_path(name));
    Error::file(path, found, "one scan, packed once", "unpack it and name the scan itself")
}

#[cfg(test)]
mod tests;
