//! What is in a file or folder: scans, features, checkpoints, results.

mod content;
mod tensors;
mod text;

pub use content::{FeatureContent, ResultContent, ScanContent};
pub use tensors::CheckpointContent;
pub use text::text;

use crate::io::{self, ReadOptions, StoredScan};
use crate::{Error, Result};
use serde::Serialize;
use std::fs;
use std::path::{Path, PathBuf};

/// The file that marks a folder as a result.
const POSES: &str = "poses.json";

/// One inspected item.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// The file or folder.
    pub path: PathBuf,
    /// Which scan of the file it is, from zero, where the file holds several.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub part: Option<usize>,
    /// Size on disk; of a folder, that of the files in it.
    pub bytes: u64,
    /// What it is.
    #[serde(flatten)]
    pub content: Content,
}

/// What a file or folder holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Content {
    /// A point cloud.
    Scan(ScanContent),
    /// Keypoints and descriptors of a scan.
    Features(FeatureContent),
    /// Weights of a network.
    Checkpoint(CheckpointContent),
    /// Output of `register`.
    Result(Box<ResultContent>),
}

/// Inspects a file or folder. A folder is a result, or else every scan and features file in it
/// is inspected.
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] and [`Error::Input`] when it is nothing that this program
/// reads, or is damaged.
pub fn inspect(path: &Path, options: &ReadOptions) -> Result<Vec<Finding>> {
    if !path.is_dir() {
        return file(path, options);
    }
    if path.join(POSES).exists() {
        return Ok(vec![result(path)?]);
    }
    let mut files = checkpoints_in(path)?;
    match io::scan_files(path) {
        Ok(scans) => files.extend(scans),
        Err(e) if files.is_empty() => return Err(e),
        Err(_) => {}
    }
    let found = files.iter().map(|f| file(f, options)).collect::<Result<Vec<_>>>()?;
    Ok(found.concat())
}

/// Checkpoints of a folder, sorted.
fn checkpoints_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).map_err(|e| Error::read(folder, e))?;
    let paths = entries.map(|e| e.map(|e| e.path()).map_err(|e| Error::read(folder, e)));
    let mut found: Vec<PathBuf> = paths.collect::<Result<_>>()?;
    found.retain(|p| has_extension(p, "safetensors") && p.is_file());
    found.sort();
    Ok(found)
}

fn file(path: &Path, options: &ReadOptions) -> Result<Vec<Finding>> {
    let bytes = fs::metadata(path).map_err(|e| Error::read(path, e))?.len();
    let content = if path.file_name().is_some_and(|n| n == POSES) {
        Content::Result(Box::new(content::result(path.parent().unwrap_or(Path::new("")))?))
    } else if has_extension(path, "safetensors") {
        Content::Checkpoint(tensors::checkpoint(path)?)
    } else if has_extension(path, "npz") && io::holds_features(path)? {
        Content::Features(content::features(&io::read_features(path)?))
    } else {
        let read = io::read_file(path, options)?;
        let several = read.scans.len() > 1;
        let notes: Vec<String> = read.notes.into_iter().map(|note| note.text).collect();
        let scan = |(part, stored): (usize, StoredScan)| Finding {
            path: path.to_path_buf(),
            part: several.then_some(part),
            bytes,
            content: Content::Scan(ScanContent { notes: notes.clone(), ..content::scan(&stored.cloud) }),
        };
        return Ok(read.scans.into_iter().enumerate().map(scan).collect());
    };
    Ok(vec![Finding { path: path.to_path_buf(), part: None, bytes, content }])
}

fn result(folder: &Path) -> Result<Finding> {
    let content = content::result(folder)?;
    let bytes = content.files.iter().map(|f| f.bytes).sum();
    Ok(Finding { path: folder.to_path_buf(), part: None, bytes, content: Content::Result(Box::new(content)) })
}

fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension))
}

#[cfg(test)]
mod tests;
