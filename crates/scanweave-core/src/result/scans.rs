//! Every placed scan as a file of its own, whole and moved into the frame of its component.

mod moved;
mod names;
mod source;

use super::poses::{Document, Entry};
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::io::{self, E57Scan, ReadOptions};
use crate::monitor::Monitor;
use crate::output_folder::is_same_place;
use crate::scan::{Reconstruction, ScanId};
use moved::Moved;
use serde::{Deserialize, Serialize};
use source::Source;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Formats that scans are exported in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScanFormat {
    /// Binary PLY, one file a scan.
    Ply,
    /// Binary PCD, one file a scan.
    Pcd,
    /// LAS 1.2, one file a scan; without normals.
    Las,
    /// LAZ, one file a scan; without normals.
    Laz,
    /// One E57 file a component: every scan in its own coordinates, with its pose.
    E57,
}

impl ScanFormat {
    fn extension(self) -> &'static str {
        match self {
            ScanFormat::Ply => "ply",
            ScanFormat::Pcd => "pcd",
            ScanFormat::Las => "las",
            ScanFormat::Laz => "laz",
            ScanFormat::E57 => "e57",
        }
    }
}

/// What [`export_scans`] made.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Exported {
    /// The files.
    pub files: Vec<PathBuf>,
    /// Names of the scans that have no pose, and so no file.
    pub left_out: Vec<String>,
}

/// Writes all placed scans of a result into `folder`, with every point and its colour, intensity and
/// normal: `<scan>.ply` (or as the format is called), those of further components in `component_1/`, …;
/// or `scans.e57`, `scans_1.e57`, …. Binary PLY and PCD, LAS, LAZ and E57 are read and written block by
/// block; of other files one is held in memory at a time. `options` are those that the scans were
/// registered with.
///
/// # Errors
/// [`Error::File`] when `folder` holds the scans themselves;
/// [`Error::OutputExists`] when one of the files exists and `replace` is not given; [`Error::Setting`] when
/// one is the file of a scan; files of scans that cannot be read any more or hold something else now;
/// [`Error::Write`], [`Error::Interrupted`].
pub fn export_scans(
    document: &Document,
    options: &ReadOptions,
    folder: &Path,
    format: ScanFormat,
    replace: bool,
    monitor: &dyn Monitor,
) -> Result<Exported> {
    let reconstruction = document.reconstruction()?;
    let exports = exports(document, &reconstruction, folder, format)?;
    let mut files: Vec<PathBuf> = exports.iter().map(|e| e.file.clone()).collect();
    files.dedup();
    refuse_inputs(document, folder)?;
    refuse_files_of_scans(document, &files)?;
    if !replace && files.iter().any(|f| f.exists()) {
        return Err(Error::OutputExists { path: folder.to_path_buf() });
    }
    let mut names: BTreeMap<&Path, Vec<String>> = BTreeMap::new();
    for file in &files {
        if let (Some(parent), Some(name)) = (file.parent(), file.file_name()) {
            names.entry(parent).or_default().push(name.to_string_lossy().into_owned());
        }
    }
    for (&parent, names) in &names {
        std::fs::create_dir_all(parent).map_err(|e| Error::write(parent, e))?;
        // Before the files: what a killed run leaves are copies, too.
        io::exported::note(parent, names.iter().cloned())?;
    }
    let written = write_all(&exports, &files, options, format, monitor);
    if written.is_err() {
        names.keys().for_each(|parent| io::exported::forget_missing(parent));
    }
    written?;
    let placed = |entry: &&Entry| exports.iter().any(|e| e.entry.id == entry.id);
    let left_out = document.scans.iter().filter(|entry| !placed(entry)).map(|e| e.name.clone()).collect();
    Ok(Exported { files, left_out })
}

/// Writes the files, in which the exports lie in order.
fn write_all(
    exports: &[Export<'_>],
    files: &[PathBuf],
    options: &ReadOptions,
    format: ScanFormat,
    monitor: &dyn Monitor,
) -> Result<()> {
    let mut source = Source::new(options);
    let of = exports.len();
    let numbered = |number: usize| format!("scan {} of {of}", number + 1);
    if format == ScanFormat::E57 {
        let mut number = 0;
        for file in files {
            let members: Vec<&Export<'_>> = exports.iter().filter(|e| e.file == *file).collect();
            let scans = members.iter().map(|export| {
                number += 1;
                e57_scan(&mut source, export, &numbered(number - 1), monitor)
            });
            io::write_e57(file, &identity(&members), scans)?;
        }
        return Ok(());
    }
    let mut numbers = exports.iter().enumerate();
    numbers
        .try_for_each(|(number, export)| write_one(&mut source, export, format, &numbered(number), monitor))
}

/// Refuses to write over what is to be read: the moved scan would be taken for the scan.
fn refuse_files_of_scans(document: &Document, files: &[PathBuf]) -> Result<()> {
    let sources: Vec<PathBuf> =
        document.scans.iter().filter_map(|s| std::fs::canonicalize(s.file.as_ref()?).ok()).collect();
    let taken = |file: &&PathBuf| std::fs::canonicalize(file).is_ok_and(|file| sources.contains(&file));
    match files.iter().find(taken) {
        None => Ok(()),
        Some(file) => {
            let found = format!("{}, the file of a scan", file.display());
            let expected = "a folder in which no scan is written over";
            Err(Error::setting("export-scans", found, expected, "name another folder"))
        }
    }
}

/// Moved scans beside the scans would be taken for more of them, or written over them.
fn refuse_inputs(document: &Document, folder: &Path) -> Result<()> {
    let of_scan = |entry: &'_ Entry| {
        let parent = Path::new(entry.file.as_deref()?).parent()?.to_path_buf();
        Some(if parent.as_os_str().is_empty() { PathBuf::from(".") } else { parent })
    };
    match document.scans.iter().any(|e| of_scan(e).is_some_and(|parent| is_same_place(&parent, folder))) {
        true => Err(Error::file(
            folder,
            "the scans that were registered",
            "a folder for the moved scans alone",
            "name another folder with --export-scans",
        )),
        false => Ok(()),
    }
}

/// What an E57 file of these scans is known by.
fn identity(members: &[&Export<'_>]) -> String {
    let of = |e: &&Export<'_>| format!("{} {:?} {:?}", e.entry.name, e.entry.file, e.world_from_scan);
    members.iter().map(of).collect::<Vec<_>>().join("\n")
}

/// A scan, its pose, and the file that it goes into.
struct Export<'a> {
    entry: &'a Entry,
    world_from_scan: RigidMotion,
    file: PathBuf,
}

/// What is to be written, file by file.
fn exports<'a>(
    document: &'a Document,
    reconstruction: &Reconstruction,
    folder: &Path,
    format: ScanFormat,
) -> Result<Vec<Export<'a>>> {
    let mut placed = Vec::new();
    for entry in &document.scans {
        let outcome = reconstruction.outcomes.get(entry.id);
        let Some(placement) = outcome.and_then(|o| o.placement()) else { continue };
        placed.push((placement.component, entry, placement.world_from_scan));
    }
    if placed.is_empty() {
        let expected = "at least one scan with a pose";
        return Err(Error::input("result", "no placed scan", expected, "register the scans again"));
    }
    // Components one after the other; within each the order of the input.
    placed.sort_by_key(|(component, entry, _)| (*component, ScanId(entry.id)));
    let mut names = names::Names::default();
    let export = |(component, entry, world_from_scan): (usize, &'a Entry, RigidMotion)| {
        let file = match (format, component) {
            (ScanFormat::E57, 0) => folder.join("scans.e57"),
            (ScanFormat::E57, c) => folder.join(format!("scans_{c}.e57")),
            (_, c) => folder.join(names.file(c, &entry.name, format.extension())),
        };
        Export { entry, world_from_scan, file }
    };
    Ok(placed.into_iter().map(export).collect())
}

fn write_one(
    source: &mut Source,
    export: &Export<'_>,
    format: ScanFormat,
    numbered: &str,
    monitor: &dyn Monitor,
) -> Result<()> {
    let (file, world_from_scan) = (&export.file, export.world_from_scan);
    let mut scan = Moved::new(source.open(export.entry)?, &export.entry.name, numbered, monitor);
    let summary = scan.move_by(world_from_scan)?;
    match format {
        ScanFormat::Pcd => io::write_pcd(file, &summary, &mut scan),
        ScanFormat::Las | ScanFormat::Laz => {
            io::write_las(file, &summary, &mut scan, format == ScanFormat::Laz)
        }
        ScanFormat::Ply | ScanFormat::E57 => io::write_ply_blocks(file, &summary, &mut scan),
    }
}

fn e57_scan<'a>(
    source: &mut Source,
    export: &Export<'_>,
    numbered: &str,
    monitor: &'a dyn Monitor,
) -> Result<E57Scan<'a>> {
    let name = export.entry.name.clone();
    let mut scan = Moved::new(source.open(export.entry)?, &name, numbered, monitor);
    // The points stay in the coordinates of their file, beside the pose.
    let summary = scan.move_by(RigidMotion::identity())?;
    let world_from_scan = export.world_from_scan;
    Ok(E57Scan { name, world_from_scan, summary, blocks: Box::new(scan) })
}

#[cfg(test)]
mod tests;
