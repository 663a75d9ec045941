//! The files that scans are exported from.

use crate::error::{Error, Result};
use crate::io::{self, Held, PointBlocks, ReadOptions};
use crate::result::poses::Entry;
use crate::scan::PointCloud;
use std::path::PathBuf;

/// The files of the scans. A file that must be held whole is kept: it may hold the next scan too.
pub(super) struct Source {
    options: ReadOptions,
    current: Option<(PathBuf, Vec<Option<PointCloud>>)>,
}

impl Source {
    /// Files that are read as they were for the registration, with all that they hold.
    pub(super) fn new(options: &ReadOptions) -> Self {
        Self { options: ReadOptions { attributes: true, ..options.clone() }, current: None }
    }

    /// The scan, to be read block by block where that can be.
    pub(super) fn open(&mut self, entry: &Entry) -> Result<Box<dyn PointBlocks>> {
        let Some(path) = entry.file.as_ref().map(PathBuf::from) else {
            let expected = "the file that it came from";
            return Err(Error::input(&entry.name, "a scan without a file", expected, "register files"));
        };
        let part = entry.part.unwrap_or(0);
        let held = self.current.as_ref().is_some_and(|(read, _)| *read == path);
        if !held {
            // Before the next is read, so that two are never held.
            self.current = None;
            io::check_named_scan(&path)?;
            if let Some(blocks) = io::open_blocks(&path, part, &self.options)? {
                return Ok(blocks);
            }
            let scans = io::read_file(&path, &self.options)?.scans;
            self.current = Some((path.clone(), scans.into_iter().map(|s| Some(s.cloud)).collect()));
        }
        let scans = self.current.as_mut().map(|(_, scans)| scans);
        let cloud = scans.and_then(|scans| scans.get_mut(part)?.take()).ok_or_else(|| {
            let found = format!("no scan {} in it", part + 1);
            Error::file(&path, found, "the file that was registered", "register it again")
        })?;
        Ok(Box::new(Held(cloud)))
    }
}
