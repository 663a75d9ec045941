//! Packed scans: one scan in a `.gz` or `.zip`.

use super::cloud::{Format, HEAD_BYTES, format_of};
use super::discover;
use super::scalar::counted;
use super::unpack_limit::UnpackLimit;
use crate::error::{Error, Result};
use crate::printable::{printable, printable_path};
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};

/// The content of a packed file.
#[derive(Debug)]
pub(super) struct Unpacked {
    /// Name of the content, whose extension tells the format.
    pub name: PathBuf,
    /// The content.
    pub bytes: Vec<u8>,
}

/// Unpacks a gzip file; its content is named as the file is, without `.gz`.
///
/// # Errors
/// [`Error::File`] for damaged or too much content, and for content that is no scan.
pub(super) fn gunzip(path: &Path, file: BufReader<File>, limit: UnpackLimit) -> Result<Unpacked> {
    let name = if discover::has_extension(path, &["gz"]) { path.with_extension("") } else { path.into() };
    let bytes = unpack(path, &name, flate2::bufread::MultiGzDecoder::new(file), limit)?;
    Ok(Unpacked { name, bytes })
}

/// Unpacks the only scan of a zip archive. An archive of NPY arrays only (an NPZ) is handed back as it is.
///
/// # Errors
/// [`Error::File`] for a damaged archive, for one without a scan or with several, and for too much content.
pub(super) fn unzip(path: &Path, mut file: BufReader<File>, limit: UnpackLimit) -> Result<Unpacked> {
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

/// All bytes of `content`, up to the limit: what an archive says of its sizes is not trusted. The format is looked at before the rest is
/// unpacked, so that what is no scan costs nothing.
fn unpack(path: &Path, name: &Path, mut content: impl Read, limit: UnpackLimit) -> Result<Vec<u8>> {
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
    let most = limit.bytes().saturating_add(1).saturating_sub(bytes.len() as u64);
    read_more(&mut content, &mut bytes, most).map_err(damaged)?;
    if bytes.len() as u64 > limit.bytes() {
        return Err(limit.exceeded(path, "content"));
    }
    Ok(bytes)
}

/// Reads to the end, or up to so many bytes more. A block that grows by itself would reserve twice as many.
fn read_more(content: &mut impl Read, bytes: &mut Vec<u8>, most: u64) -> std::io::Result<()> {
    const LEAST_STEP: usize = 1 << 16;
    let mut left = most;
    while left > 0 {
        let step = (bytes.len().max(LEAST_STEP) as u64).min(left);
        bytes.try_reserve_exact(step as usize)?;
        let read = content.by_ref().take(step).read_to_end(bytes)? as u64;
        if read < step {
            break;
        }
        left -= read;
    }
    Ok(())
}

/// Refuses a packed file in a packed file.
pub(super) fn packed_twice(path: &Path, name: &Path) -> Error {
    let found = format!("a packed file in it ('{}')", printable_path(name));
    Error::file(path, found, "one scan, packed once", "unpack it and name the scan itself")
}

#[cfg(test)]
mod tests;
