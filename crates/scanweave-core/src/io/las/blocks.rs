//! Points of a LAS or LAZ file, block by block.

use super::sizes::{PointsOf, end_of_points};
use super::{Columns, damaged, each_chunk};
use crate::error::Result;
use crate::files;
use crate::io::blocks::{PointBlocks, TakeBlock};
use crate::io::scan_file::ReadOptions;
use std::io::BufReader;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

struct Chunks {
    path: PathBuf,
    options: ReadOptions,
    rows: usize,
    /// Whether colours are of 8 bits.
    bytes: bool,
}

/// The points of a file.
pub(in crate::io) fn open(path: &Path, options: &ReadOptions) -> Result<Box<dyn PointBlocks>> {
    let (mut rows, mut bytes) = (0, true);
    // Until the first colour that has more than 8 bits, mostly in the first chunk.
    each_columns(path, options, &mut |header, columns| {
        rows = usize::try_from(header.number_of_points()).unwrap_or(0);
        bytes = !columns.has_wide_colors();
        Ok(bytes && header.point_format().has_color)
    })?;
    Ok(Box::new(Chunks { path: path.into(), options: options.clone(), rows, bytes }))
}

/// Hands the columns of some points at a time to `take`, until it wants no more.
fn each_columns(
    path: &Path,
    options: &ReadOptions,
    take: &mut dyn FnMut(&::las::Header, Columns) -> Result<bool>,
) -> Result<()> {
    let mut file = BufReader::new(files::open(path)?);
    let end = end_of_points(path, &mut file, options)?;
    let file = PointsOf::new(file, end);
    let read = || {
        let mut reader = ::las::Reader::new(file).map_err(|e| damaged(path, &e))?;
        let header = reader.header().clone();
        each_chunk(path, &mut reader, |chunk| {
            let mut columns = Columns::new(&header, options);
            columns.push(chunk);
            take(&header, columns)
        })
    };
    // As where the file is read whole: the decoder may panic on a damaged file.
    catch_unwind(AssertUnwindSafe(read))
        .unwrap_or_else(|_| Err(damaged(path, &"its parts contradict one another")))
}

impl PointBlocks for Chunks {
    fn rows(&self) -> usize {
        self.rows
    }

    fn for_each(&mut self, take: &mut TakeBlock<'_>) -> Result<()> {
        each_columns(&self.path, &self.options, &mut |header, columns| {
            take(columns.into_cloud(header.transforms(), self.bytes))?;
            Ok(true)
        })
    }
}
