//! Points of a scan of an E57 file, block by block.

use super::{check, damaged, each_block, place_sensor};
use crate::error::Result;
use crate::files;
use crate::io::blocks::{BLOCK_POINTS, PointBlocks, TakeBlock};
use crate::io::scan_file::ReadOptions;
use crate::io::scanner::drop_implausible_viewpoint;
use crate::scan::PointCloud;
use ::e57::E57Reader;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

struct Rows {
    path: PathBuf,
    reader: E57Reader<BufReader<File>>,
    scan: ::e57::PointCloud,
    options: ReadOptions,
}

/// The points of scan `part`; `None` where the file has none of that number.
pub(in crate::io) fn open(
    path: &Path,
    part: usize,
    options: &ReadOptions,
) -> Result<Option<Box<dyn PointBlocks>>> {
    let file = BufReader::new(files::open(path)?);
    let reader = E57Reader::new(file).map_err(|e| damaged(path, &e))?;
    let Some(scan) = reader.pointclouds().into_iter().nth(part) else { return Ok(None) };
    check(path, part, &scan)?;
    Ok(Some(Box::new(Rows { path: path.into(), reader, scan, options: options.clone() })))
}

impl PointBlocks for Rows {
    fn rows(&self) -> usize {
        usize::try_from(self.scan.records).unwrap_or(0)
    }

    fn for_each(&mut self, take: &mut TakeBlock<'_>) -> Result<()> {
        let Self { path, reader, scan, options } = self;
        each_block(path, reader, scan, options, BLOCK_POINTS, |block| take(block.into_cloud()))?;
        Ok(())
    }

    fn place_sensor(&self, sample: &mut PointCloud) {
        place_sensor(&self.scan, sample);
        drop_implausible_viewpoint(sample);
    }
}
