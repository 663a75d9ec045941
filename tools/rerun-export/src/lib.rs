//! A result of Scanweave as a recording for the [Rerun](https://rerun.io) viewer.
//!
//! Reads what is documented in docs/poses-json.md, poses.json and merged*.ply, and logs the growth
//! of every model on the timeline `step`. It does not use the scanweave crate, so that neither
//! builds the other's dependencies.

mod merged;
mod poses;
mod recording;

pub use merged::{Merged, read_merged};
pub use poses::{Component, Entry, Outcome, Poses, read_poses};
pub use recording::{colour, record};

use anyhow::{Context, Result};
use re_sdk::RecordingStreamBuilder;
use std::path::{Path, PathBuf};

/// What was logged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Written {
    /// Scans with a pose.
    pub placed: usize,
    /// Scans without.
    pub declined: usize,
    /// Points of all scans.
    pub points: usize,
}

/// Reads the result in `folder` and writes the recording `file`, whole or not at all.
///
/// # Errors
/// A folder that holds no result, files that do not fit each other, a place that cannot be
/// written to.
pub fn export(folder: &Path, file: &Path) -> Result<Written> {
    let poses = read_poses(&folder.join("poses.json"))?;
    let merged = merged_files(folder, poses.components.len())
        .iter()
        .map(|path| match path.exists() {
            true => read_merged(path),
            false => Ok(Merged::default()),
        })
        .collect::<Result<Vec<Merged>>>()?;
    let beside = beside(file);
    // Told before Rerun tries, which would say less.
    std::fs::File::create(&beside).with_context(|| format!("cannot write {}", file.display()))?;
    let written = (|| {
        let stream = RecordingStreamBuilder::new("scanweave").save(&beside)?;
        let written = record(&stream, &poses, &merged)?;
        stream.flush_blocking()?;
        Ok(written)
    })();
    match written {
        Ok(written) => {
            std::fs::rename(&beside, file).with_context(|| format!("cannot write {}", file.display()))?;
            Ok(written)
        }
        Err(error) => {
            std::fs::remove_file(&beside).ok();
            Err(error)
        }
    }
}

/// `merged.ply` of the first component, `merged_1.ply` of the second, and so on.
fn merged_files(folder: &Path, components: usize) -> Vec<PathBuf> {
    let name = |c: usize| if c == 0 { "merged.ply".to_owned() } else { format!("merged_{c}.ply") };
    (0..components).map(|c| folder.join(name(c))).collect()
}

/// A file in the same folder, to be renamed.
fn beside(file: &Path) -> PathBuf {
    let mut name = file.file_name().unwrap_or_default().to_os_string();
    name.push(".partial");
    file.with_file_name(name)
}
