//! From what a user names (files, folders, globs, lists) to scan files in a fixed order.

use super::cloud::FORMATS;
use crate::error::{Error, Result};
use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Extensions of formats that hold nothing but clouds.
const CLOUD_EXTENSIONS: [&str; 11] =
    ["ply", "pcd", "xyz", "pts", "asc", "csv", "xyzrgb", "xyzn", "las", "laz", "e57"];
/// Extensions that hold a cloud only if nothing better is in the folder: features are kept in these too.
const ARRAY_EXTENSIONS: [&str; 2] = ["npy", "npz"];

/// Scan files named by `inputs`, naturally sorted (`s2` before `s10`), each once.
///
/// An input is
/// - a file, taken as it is;
/// - a folder: its `PointCloud/` if it has one (the 3DMatch layout), else its cloud files; NPY/NPZ only
///   if there are no others, then depth PNGs, then those of a subfolder `depth/`. Plain `.txt` is
///   never taken from a folder, since poses and notes have that extension too;
/// - a glob (`scans/*.ply`), where no file of that very name exists;
/// - `@list.txt`: a text file of inputs, one a line, relative to its folder; `#` begins a comment.
///
/// Hidden files are ignored. The order never depends on that of a directory or of `inputs`.
///
/// # Errors
/// [`Error::Read`] for an input that does not exist, [`Error::Input`] when an input
/// (or all of them) yields no scan file, saying what was looked for.
pub fn discover(inputs: &[String]) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for input in inputs {
        match input.strip_prefix('@') {
            Some(list) if !Path::new(input).exists() => read_list(Path::new(list), &mut found)?,
            _ => resolve(input, Path::new(""), &mut found)?,
        }
    }
    if found.is_empty() {
        return Err(Error::input(
            "inputs",
            "no scan",
            format!("files, folders, globs or @lists of scans: {FORMATS}"),
            "name at least one scan file or folder",
        ));
    }
    sort_naturally(&mut found);
    let mut seen = HashSet::new();
    // The same file by two names is one scan; what cannot be resolved is told apart by its name.
    found.retain(|p| seen.insert(fs::canonicalize(p).unwrap_or_else(|_| p.clone())));
    Ok(found)
}

fn read_list(list: &Path, found: &mut Vec<PathBuf>) -> Result<()> {
    let bytes = fs::read(list).map_err(|e| Error::read(list, e))?;
    let text = String::from_utf8(bytes).map_err(|_| {
        Error::file(
            list,
            "bytes that are not UTF-8",
            "one path a line, in UTF-8",
            "save the list as UTF-8 text",
        )
    })?;
    let before = found.len();
    let folder = list.parent().unwrap_or(Path::new(""));
    for line in text.trim_start_matches('\u{feff}').lines().map(str::trim) {
        if !line.is_empty() && !line.starts_with('#') {
            resolve(line, folder, found)?;
        }
    }
    if found.len() == before {
        return Err(Error::file(
            list,
            "no path",
            "one path a line",
            "list the scans, one a line, relative to the list",
        ));
    }
    Ok(())
}

/// Adds what one input names; relative ones start from `base`.
fn resolve(input: &str, base: &Path, found: &mut Vec<PathBuf>) -> Result<()> {
    let path = base.join(input);
    if path.is_dir() {
        found.extend(scan_files(&path)?);
        return Ok(());
    }
    if path.exists() {
        found.push(path);
        return Ok(());
    }
    if !input.contains(['*', '?', '[']) {
        let missing = std::io::Error::new(std::io::ErrorKind::NotFound, "no such file or folder");
        return Err(Error::read(path, missing));
    }
    let before = found.len();
    found.extend(expand(&path, base, input)?);
    if found.len() == before {
        let expected = "at least one scan file that matches it";
        let remedy = "check the pattern; hidden files and folders are not matched";
        return Err(Error::input(input, "no file", expected, remedy));
    }
    Ok(())
}

fn expand(pattern: &Path, base: &Path, input: &str) -> Result<Vec<PathBuf>> {
    // A folder name with [ in it must not become part of the pattern.
    let pattern = match base.to_str() {
        Some(b) if !b.is_empty() && !Path::new(input).is_absolute() => {
            format!("{}/{input}", glob::Pattern::escape(b))
        }
        _ => pattern.to_string_lossy().into_owned(),
    };
    let options = glob::MatchOptions { require_literal_leading_dot: true, ..glob::MatchOptions::new() };
    let matches = glob::glob_with(&pattern, options).map_err(|e| {
        Error::input(
            input,
            format!("a pattern that is not valid: {e}"),
            "a glob such as scans/*.ply",
            "correct the pattern",
        )
    })?;
    let files = matches.map(|m| m.map_err(|e| Error::read(e.path(), std::io::Error::from(e.error().kind()))));
    let files: Vec<PathBuf> = files.collect::<Result<_>>()?;
    let wanted = |p: &PathBuf| {
        p.is_file() && (is_cloud(p) || is_array(p) || is_depth(p) || has_extension(p, &["txt"]))
    };
    Ok(files.into_iter().filter(wanted).collect())
}

/// Scan files of a folder, naturally sorted: see [`discover`].
///
/// # Errors
/// [`Error::Read`], or [`Error::Input`] when there is none.
pub fn scan_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let named = folder.join("PointCloud");
    let (place, depth) = (if named.is_dir() { named } else { folder.to_path_buf() }, folder.join("depth"));
    let files = visible_files(&place)?;
    let pick = |keep: fn(&Path) -> bool| files.iter().filter(|p| keep(p)).cloned().collect::<Vec<_>>();
    let mut scans = pick(is_cloud);
    if scans.is_empty() {
        scans = pick(is_array);
    }
    if scans.is_empty() {
        scans = pick(is_depth);
    }
    if scans.is_empty() && depth.is_dir() {
        scans = visible_files(&depth)?.into_iter().filter(|p| is_depth(p)).collect();
    }
    if scans.is_empty() {
        let found = match files.len() {
            0 => "no visible file".to_owned(),
            n => format!("{n} files, none of them a scan by its extension"),
        };
        let remedy = "name another folder, or name the files themselves (.txt clouds must be named)";
        return Err(Error::input(place.display().to_string(), found, format!("scans: {FORMATS}"), remedy));
    }
    sort_naturally(&mut scans);
    Ok(scans)
}

fn visible_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).map_err(|e| Error::read(folder, e))?;
    let mut files = Vec::new();
    for entry in entries {
        let entry = entry.map_err(|e| Error::read(folder, e))?;
        // `path().is_file()` follows links, as opening will.
        if !entry.file_name().as_encoded_bytes().starts_with(b".") && entry.path().is_file() {
            files.push(entry.path());
        }
    }
    Ok(files)
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|e| extensions.iter().any(|x| e.eq_ignore_ascii_case(x)))
}

fn is_cloud(path: &Path) -> bool {
    has_extension(path, &CLOUD_EXTENSIONS)
}

fn is_array(path: &Path) -> bool {
    has_extension(path, &ARRAY_EXTENSIONS)
}

/// A PNG that is not, by its name, the colour image of a frame.
fn is_depth(path: &Path) -> bool {
    let stem = path.file_stem().map(|s| s.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    has_extension(path, &["png"]) && !stem.ends_with("color") && !stem.ends_with("rgb")
}

/// Sorts so that numbers in names count as numbers. Total, hence the same for every input order.
pub(super) fn sort_naturally(paths: &mut [PathBuf]) {
    paths.sort_by_cached_key(|p| (natural_key(p), p.clone()));
}

/// A stretch of a path: text, or the digits of a number.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    /// Number of digits without leading zeros, then those digits: ordered as the number is.
    Number(usize, Vec<u8>),
    Text(Vec<u8>),
}

/// Each component of the path as its stretches; folders sort before deeper files of the same name.
fn natural_key(path: &Path) -> Vec<Vec<Part>> {
    let component = |c: std::path::Component<'_>| {
        let bytes = c.as_os_str().as_encoded_bytes();
        let stretches = bytes.chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit());
        stretches
            .map(|s| {
                if !s[0].is_ascii_digit() {
                    return Part::Text(s.to_ascii_lowercase());
                }
                let digits: Vec<u8> = s.iter().copied().skip_while(|&d| d == b'0').collect();
                Part::Number(digits.len(), digits)
            })
            .collect()
    };
    path.components().map(component).collect()
}
