//! Rough poses of scans from one file, in any of the formats that poses come in.

mod json;
mod lists;
mod matching;
mod table;

use super::poses::{lines, numbers, read_text};
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use matching::Labels;
use std::path::{Path, PathBuf};

/// What a file says before it is known which scans are meant.
#[derive(Debug, Clone, PartialEq)]
enum Poses {
    /// With names, the first of which that fits is taken.
    Named(Vec<Entry<Vec<String>>>),
    /// With numbers of scans.
    Numbered(Vec<Entry<u64>>),
    /// With timestamps.
    Stamped(Vec<Entry<f64>>),
    /// One a scan.
    Ordered(Vec<RigidMotion>),
}

/// A pose, whose it is, and where that stands, for messages: `line 3`.
#[derive(Debug, Clone, PartialEq)]
struct Entry<K> {
    key: K,
    pose: RigidMotion,
    at: String,
}

/// Reads the rough pose of every scan; `names[i]` and `files[i]` are those of scan `i`, whose pose is
/// at `i` of the result.
///
/// The format is told by the content:
///
/// | Content | Which scan a pose belongs to |
/// |---|---|
/// | table with a header line that has `name` (or `file`), then `tx,ty,tz,qx,qy,qz,qw` or 12 or 16 further columns, a matrix row by row | by name |
/// | `poses.json` of this program: its first component | by name |
/// | other JSON: an object from names to matrices, nested or row by row | by name |
/// | COLMAP `images.txt`: `scan_from_world` | by name |
/// | `PoseGraph` JSON of Open3D | by the `name` in its nodes, else by order, one a scan |
/// | TUM: 8 numbers a line | by the timestamp |
/// | Redwood `.log` trajectory, g2o vertices | by the number |
/// | KITTI: 12 or 16 numbers a line | by the names in `<stem>_names.txt` beside it, else by order, one a scan |
///
/// *By name*: the name of the scan, its file as the user named it, the file's name, or that without its
/// extension; the first of these that fits.
///
/// *By the timestamp*: the number at the end of the scan's name, if the names of all scans end in
/// different numbers and every timestamp is one of them. Else, if all timestamps are whole numbers
/// below the number of scans, the scan's place in the input, from 0. Else by order, one a scan.
///
/// *By the number*: the number at the end of the scan's name, if the names of all scans end in different
/// numbers and every entry is one of them; or the scan's place in the input, from 0. A file that
/// could be read both ways, with different outcomes, is refused.
///
/// Poses are `world_from_scan` but for COLMAP's. Rotations that are rounded are repaired. A pose that
/// belongs to no scan is an error, and so are two of one scan; scans without a pose are none.
///
/// # Errors
/// [`Error::Read`]; [`Error::File`] for content of no known format, a damaged line, a pose that is no
/// rigid motion, that belongs to no scan or to several, and for two poses of one scan.
pub fn read_initial_poses(
    path: impl AsRef<Path>,
    names: &[String],
    files: &[Option<PathBuf>],
) -> Result<Vec<Option<RigidMotion>>> {
    let path = path.as_ref();
    let labels = Labels::new(path, names, files);
    match poses(path)? {
        Poses::Named(entries) => labels.by_name(&entries),
        Poses::Numbered(entries) => labels.by_number(&entries),
        Poses::Stamped(entries) => labels.by_timestamp(&entries),
        Poses::Ordered(poses) => labels.in_order(poses),
    }
}

fn poses(path: &Path) -> Result<Poses> {
    let text = read_text(path)?;
    let content = text.trim_start();
    if content.starts_with(['{', '[']) {
        return json::read(path, content);
    }
    if lines(&text).any(|l| l.1.starts_with("VERTEX_SE3:QUAT")) {
        return lists::read_g2o(path, &text);
    }
    let mut content = lines(&text);
    let first = content.next().map(|l| l.1).unwrap_or_default();
    if table::is_header(first) {
        return table::read(path, &text);
    }
    match numbers(first).map(|n| n.len()) {
        Some(3) => lists::read_log(path),
        Some(8) => lists::read_tum(path),
        Some(12 | 16) => lists::read_kitti(path),
        _ if lists::is_image(first) => lists::read_images(path, &text),
        _ => Err(unknown(path, first)),
    }
}

fn unknown(path: &Path, first: &str) -> Error {
    let found = match first.chars().take(80).collect::<String>() {
        start if start.is_empty() => "no pose".to_owned(),
        start => format!("a first line '{start}'"),
    };
    let expected = "poses: a table with the columns name, tx, ty, tz, qx, qy, qz, qw; poses.json or a JSON \
                    object from names to matrices; TUM; KITTI; a Redwood trajectory; g2o vertices; COLMAP images.txt";
    Error::file(path, found, expected, "write the poses in one of these formats")
}

#[cfg(test)]
mod tests;
