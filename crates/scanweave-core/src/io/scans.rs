//! Many scans at once: in parallel, in order, with unique names.

use super::discover::{self, Discovered, FoundFile, LeftOut};
use super::read_file;
use super::scalar::counted;
use super::scan_file::{Note, ReadOptions, ScanFile, StoredScan};
use crate::error::{Error, Result};
use crate::monitor::Monitor;
use crate::scan::{Scan, ScanId};
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

const STAGE: &str = "reading scans";

/// Scans as they were read, and what a user should know of it.
#[derive(Debug, Clone, Default)]
pub struct Inputs {
    /// The scans, in the order of the files and of the scans in them.
    pub scans: Vec<Scan>,
    /// Files that were not taken.
    pub left_out: Vec<LeftOut>,
    /// How the files were read, each sentence once with the files that it is about.
    pub notes: Vec<(Note, Vec<PathBuf>)>,
}

/// Reads every scan of the files in parallel. A file with several scans gives as many, named
/// `file#1`, `file#2`, …; those without a point are left out with a warning, and the others keep their
/// numbers.
///
/// A file that was found in a folder and turns out to be no scan is left out. So is one that cannot be
/// read, if `skip_unreadable`.
///
/// # Errors
/// That of the first file in order that fails; [`Error::File`] for a file without a finite point;
/// [`Error::Input`] when nothing is left; [`Error::Interrupted`].
pub fn read_inputs(
    found: &Discovered,
    options: &ReadOptions,
    skip_unreadable: bool,
    monitor: &dyn Monitor,
) -> Result<Inputs> {
    monitor.begin(STAGE, found.files.len());
    let one = |file: &FoundFile| {
        monitor.check(STAGE)?;
        let read =
            read_file(&file.path, options).and_then(|read| with_points(&file.path, read)).map(without_strays);
        monitor.advance(1);
        read
    };
    // Collected before errors are looked at: which of two bad files is named must not depend on threads.
    let results: Vec<Result<ScanFile>> = found.files.par_iter().map(one).collect();
    monitor.end();
    let mut left_out = found.left_out.clone();
    let mut read: Vec<(&Path, ScanFile)> = Vec::new();
    for (file, result) in found.files.iter().zip(results) {
        match result {
            Ok(scans) => read.push((&file.path, scans)),
            Err(Error::NotAScan { path, found, .. }) if !file.named => {
                left_out.push(LeftOut { path, why: found, unreadable: false });
            }
            Err(error @ Error::Interrupted { .. }) => return Err(error),
            Err(error) if skip_unreadable => {
                left_out.push(LeftOut { path: file.path.clone(), why: error.to_string(), unreadable: true });
            }
            Err(error) => return Err(error),
        }
    }
    if read.is_empty() {
        let names: Vec<String> = left_out.iter().take(3).map(|l| l.path.display().to_string()).collect();
        return Err(Error::input(
            "inputs",
            format!("no scan: {} left out ({} …)", counted(left_out.len(), "file"), names.join(", ")),
            "at least one file that can be read as a scan",
            "name the files themselves to see what is wrong with each",
        ));
    }
    let mut notes: BTreeMap<Note, Vec<PathBuf>> = BTreeMap::new();
    for (path, file) in &read {
        for note in &file.notes {
            notes.entry(note.clone()).or_default().push(path.to_path_buf());
        }
    }
    Ok(Inputs { scans: named(read), left_out, notes: notes.into_iter().collect() })
}

/// Reads `paths` in parallel; scan `i` comes from `paths[i]`.
///
/// # Errors
/// That of the first path in order that fails; [`Error::File`] for a file of several scans, and for one
/// without a finite point; [`Error::Interrupted`].
pub fn read_scans(paths: &[PathBuf], monitor: &dyn Monitor) -> Result<Vec<Scan>> {
    read_scans_with(paths, &ReadOptions::default(), monitor)
}

/// [`read_scans`] with options for all files.
///
/// # Errors
/// As [`read_scans`].
pub fn read_scans_with(paths: &[PathBuf], options: &ReadOptions, monitor: &dyn Monitor) -> Result<Vec<Scan>> {
    let files = paths.iter().map(|path| FoundFile { path: path.clone(), named: true }).collect();
    let found = Discovered { files, left_out: Vec::new() };
    let scans = read_inputs(&found, options, false, monitor)?.scans;
    match scans.iter().find(|s| s.part.is_some()) {
        None => Ok(scans),
        Some(scan) => {
            let path = scan.path.as_deref().unwrap_or(Path::new(""));
            let remedy = "export each scan to a file of its own";
            Err(Error::file(
                path,
                "several scans",
                "one scan a file, as its pose belongs to the file",
                remedy,
            ))
        }
    }
}

/// Refuses a file without a finite point, and warns of scans without one beside others.
fn with_points(path: &Path, mut file: ScanFile) -> Result<ScanFile> {
    let is_empty = |scan: &StoredScan| scan.cloud.is_empty();
    if file.scans.iter().all(is_empty) {
        let rows = counted(file.scans.iter().map(|s| s.cloud.dropped_rows).sum(), "row");
        let found = match file.scans.len() {
            1 => format!("0 finite points of {rows}"),
            n => format!("0 finite points of {rows} in {}", counted(n, "scan")),
        };
        let remedy = "leave this file out, or export it again";
        return Err(Error::file(path, found, "at least one point with finite coordinates", remedy));
    }
    // Scanners store a position that was given up as a scan without a point.
    let empty: Vec<String> =
        (1..).zip(&file.scans).filter(|(_, s)| is_empty(s)).map(|(n, _)| n.to_string()).collect();
    if !empty.is_empty() {
        let some = empty.get(..8).map_or_else(|| empty.join(", "), |some| format!("{} …", some.join(", ")));
        let text = format!("{} of the file without a point, left out: {some}", counted(empty.len(), "scan"));
        file.notes.push(Note::warning(text));
    }
    Ok(file)
}

/// The scans without points that lie too far out to belong to them.
fn without_strays(mut file: ScanFile) -> ScanFile {
    file.scans.iter_mut().for_each(|scan| scan.cloud.drop_strays());
    file
}

/// Scans with their places and names.
fn named(files: Vec<(&Path, ScanFile)>) -> Vec<Scan> {
    let paths: Vec<PathBuf> = files.iter().map(|(path, _)| path.to_path_buf()).collect();
    let mut scans = Vec::new();
    for ((path, file), name) in files.into_iter().zip(unique_names(&paths)) {
        let several = file.scans.len() > 1;
        for (part, stored) in file.scans.into_iter().enumerate().filter(|(_, s)| !s.cloud.is_empty()) {
            scans.push(Scan {
                id: ScanId(scans.len()),
                name: if several { format!("{name}#{}", part + 1) } else { name.clone() },
                path: Some(path.to_path_buf()),
                part: several.then_some(part),
                initial_pose: stored.pose,
                cloud: stored.cloud,
            });
        }
    }
    scans
}

/// A short name for each path: its stem, with as many folders before it as it takes to be unique,
/// and a number where even the whole paths look alike.
pub fn unique_names(paths: &[PathBuf]) -> Vec<String> {
    let deepest = paths.iter().map(|p| p.components().count()).max().unwrap_or(0);
    let mut depth = vec![1; paths.len()];
    for _ in 1..deepest {
        let names: Vec<String> = paths.iter().zip(&depth).map(|(p, &d)| name(p, d)).collect();
        let count = occurrences(&names);
        let repeated: Vec<usize> = (0..names.len()).filter(|&i| count[&names[i]] > 1).collect();
        if repeated.is_empty() {
            return names;
        }
        for i in repeated {
            depth[i] += 1;
        }
    }
    // Same stem in one folder, or names that differ only in bytes that are not UTF-8.
    let mut names: Vec<String> = paths
        .iter()
        .zip(&depth)
        .map(|(p, &d)| {
            let full = name(p, d);
            let (whole, stem) = (p.to_string_lossy(), without_extensions(p));
            // What was taken off: ".ply", or ".ply.gz".
            let extensions = whole.strip_prefix(&*stem.to_string_lossy()).unwrap_or("");
            format!("{full}{extensions}")
        })
        .collect();
    if occurrences(&names).values().all(|&n| n == 1) {
        return names;
    }
    for (i, name) in names.iter_mut().enumerate() {
        name.push_str(&format!("#{i}"));
    }
    names
}

fn occurrences(names: &[String]) -> HashMap<String, usize> {
    names.iter().fold(HashMap::new(), |mut count, n| {
        *count.entry(n.clone()).or_insert(0) += 1;
        count
    })
}

/// A path without its extension, and without that of the scan in a packed file.
fn without_extensions(path: &Path) -> PathBuf {
    let stem = path.with_extension("");
    if discover::is_packed(path) && discover::is_scan(&stem) { stem.with_extension("") } else { stem }
}

/// The last `depth` parts of a path, without its extensions; characters that would upset a
/// terminal or a table are replaced.
fn name(path: &Path, depth: usize) -> String {
    let stem = without_extensions(path);
    let parts: Vec<String> = stem
        .components()
        .filter(|c| matches!(c, std::path::Component::Normal(_)))
        .map(|c| c.as_os_str().to_string_lossy().replace(char::is_control, "\u{fffd}"))
        .collect();
    parts[parts.len().saturating_sub(depth)..].join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packed_scans_are_named_as_the_scans_in_them() {
        let names = |paths: &[&str]| unique_names(&paths.iter().map(PathBuf::from).collect::<Vec<_>>());
        assert_eq!(names(&["f/a.ply.gz", "f/b.xyz.zip", "f/c.v2.zip"]), ["a", "b", "c.v2"]);
        // No scan is packed in a.ply; the point belongs to its name.
        assert_eq!(names(&["f/a.ply.ply", "f/b.txt.gz"]), ["a.ply", "b"]);
        assert_eq!(names(&["f/a.ply.gz", "f/a.ply", "f/a.pcd.gz"]), ["f/a.ply.gz", "f/a.ply", "f/a.pcd.gz"]);
        assert_eq!(names(&["d/f/a.ply.gz", "d/g/a.ply.gz"]), ["f/a", "g/a"]);
    }
}
