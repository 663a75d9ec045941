//! Points of a scan of an E57 file, block by block.

use super::normals::Columns;
use super::{check, damaged, each_block, place_sensor};
use crate::error::Result;
use crate::files;
use crate::io::blocks::{BLOCK_POINTS, PointBlocks, TakeBlock};
use crate::io::scan_file::ReadOptions;
use crate::io::scanner::drop_implausible_viewpoint;
use crate::io::vertices::Vertices;
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
    let reader = open_reader(path)?;
    let Some(scan) = reader.pointclouds().into_iter().nth(part) else { return Ok(None) };
    check(path, part, &scan)?;
    Ok(Some(Box::new(Rows { path: path.into(), reader, scan, options: options.clone() })))
}

fn open_reader(path: &Path) -> Result<E57Reader<BufReader<File>>> {
    let file = BufReader::new(files::open(path)?);
    E57Reader::new(file).map_err(|e| damaged(path, &e))
}

impl PointBlocks for Rows {
    fn rows(&self) -> usize {
        usize::try_from(self.scan.records).unwrap_or(0)
    }

    fn for_each(&mut self, take: &mut TakeBlock<'_>) -> Result<()> {
        let Self { path, reader, scan, options } = self;
        // Beside the points, by a reader of their own.
        let columns = Columns::of(scan).filter(|_| options.attributes);
        let opened = columns.map(|columns| Ok((columns, open_reader(path)?))).transpose()?;
        let mut beside = None;
        let mut normals = match opened {
            Some((columns, other)) => Some(columns.rows(path, beside.insert(other), scan)?),
            None => None,
        };
        let take = |block: Vertices| take(block.into_cloud());
        each_block(path, reader, scan, options, normals.as_mut(), BLOCK_POINTS, take)?;
        Ok(())
    }

    fn place_sensor(&self, sample: &mut PointCloud) {
        place_sensor(&self.scan, sample);
        drop_implausible_viewpoint(sample);
    }
}
