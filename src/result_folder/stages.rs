//! The folders that the stages of a registration hand to each other: features, and pairs.

use crate::config::Config;
use crate::files::{FolderLock, is_same_place};
use crate::pipeline::{self, DescribedShard, FeatureSource, RegisteredShard, Shard};
use crate::scan::Scan;
use crate::{Error, Monitor, Result, io};
use std::path::{Path, PathBuf};

/// A folder that a stage writes into: alone, or beside the processes of other shards.
#[derive(Debug)]
pub struct StageFolder {
    path: PathBuf,
    shard: Shard,
    /// Runs that are no shards are kept out for as long as this value lives.
    _lock: FolderLock,
}

impl StageFolder {
    /// Makes the folder and locks it, before hours are spent.
    ///
    /// # Errors
    /// [`Error::OutputInUse`], [`Error::Write`].
    pub fn open(path: &Path, shard: Shard) -> Result<Self> {
        // Shards never write the same file.
        let lock = match shard == Shard::WHOLE {
            true => FolderLock::take(path)?,
            false => FolderLock::take_shared(path)?,
        };
        Ok(Self { path: path.to_path_buf(), shard, _lock: lock })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Which part of the work is done.
    pub fn shard(&self) -> Shard {
        self.shard
    }

    /// Where computed features are kept.
    pub fn cache(&self) -> PathBuf {
        self.path.join(CACHE)
    }

    /// Describes the scans of the shard and writes `<scan>.npz` of each. What is there is refused unless `force`;
    /// for a shard, which a scheduler may start again, only what is there with other bytes.
    ///
    /// # Errors
    /// As [`pipeline::describe`]; [`Error::File`] for a scan in the place of features;
    /// [`Error::OutputExists`], [`Error::Write`].
    pub fn describe(
        &self,
        scans: &[Scan],
        config: &Config,
        source: &FeatureSource<'_>,
        force: bool,
        monitor: &dyn Monitor,
    ) -> Result<DescribedShard> {
        self.refuse_inputs(scans)?;
        let mine = &scans[self.shard.range(scans.len())];
        for scan in mine {
            let path = self.features_of(scan);
            if self.shard == Shard::WHOLE && path.exists() && !force {
                return Err(Error::OutputExists { path: self.path.clone() });
            }
            let parent = path.parent().unwrap_or(&self.path);
            std::fs::create_dir_all(parent).map_err(|e| Error::write(parent, e))?;
        }
        let described = pipeline::describe_shard(scans, config, source, self.shard, monitor)?;
        for (scan, features) in mine.iter().zip(&described.features) {
            let path = self.features_of(scan);
            match path.exists() {
                true if io::holds_these_features(&path, features) => continue,
                true if !force => return Err(Error::OutputExists { path }),
                _ => io::write_features(path, features)?,
            }
        }
        Ok(described)
    }

    /// Registers the pairs of the shard and writes their file: [`pipeline::register_shard`].
    ///
    /// # Errors
    /// As [`pipeline::register_shard`].
    pub fn register_pairs(
        &self,
        scans: &[Scan],
        config: &Config,
        source: &FeatureSource<'_>,
        force: bool,
        monitor: &dyn Monitor,
    ) -> Result<RegisteredShard> {
        pipeline::register_shard(scans, config, source, (&self.path, force), self.shard, monitor)
    }

    fn features_of(&self, scan: &Scan) -> PathBuf {
        self.path.join(format!("{}.npz", scan.name))
    }

    /// Declines to write over a scan.
    fn refuse_inputs(&self, scans: &[Scan]) -> Result<()> {
        let own = |scan: &&Scan| {
            let place = |path: &PathBuf| scans.iter().any(|s| is_same_place(path, &self.features_of(s)));
            scan.path.as_ref().is_some_and(place)
        };
        match scans.iter().find(own).and_then(|s| s.path.as_ref()) {
            Some(path) => Err(Error::file(
                path,
                "a scan with the name of the features of a scan",
                "scans that the features do not replace",
                "choose another folder with --output",
            )),
            None => Ok(()),
        }
    }
}

const CACHE: &str = "cache";

/// Where `scanweave describe` keeps features of a folder that it wrote, or the folder itself, as of its `--cache`.
pub fn kept_features(described: &Path) -> PathBuf {
    Some(described.join(CACHE)).filter(|cache| cache.is_dir()).unwrap_or_else(|| described.to_path_buf())
}
