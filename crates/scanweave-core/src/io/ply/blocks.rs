//! Vertices of a binary PLY file, block by block.

use super::header::{Element, Encoding};
use super::{Fields, binary, find_fields, parse, scalar_of};
use crate::error::{Error, Result};
use crate::files;
use crate::io::blocks::{BLOCK_POINTS, PointBlocks, TakeBlock};
use crate::io::scalar::{Endian, Scalar};
use crate::io::scan_file::ReadOptions;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Bytes that a header is looked for in.
const HEADER_BYTES: u64 = 1 << 20;
/// Bytes of a block, where rows are long.
const BLOCK_BYTES: usize = 16 << 20;

/// Bytes after the last element that are passed over, as where the file is read whole.
const PADDING_BYTES: u64 = 16;

struct Rows {
    path: PathBuf,
    file: File,
    start: u64,
    stride: usize,
    vertex: Element,
    fields: Fields,
    endian: Endian,
}

/// The vertices of a file; `None` where they are text, have lists or are preceded by them, do not fill the
/// file as its header says, or have colours whose range only all of them tell.
pub(in crate::io) fn open(path: &Path, options: &ReadOptions) -> Result<Option<Box<dyn PointBlocks>>> {
    let refused = |e| Error::read(path, e);
    let mut file = files::open(path)?;
    let size = file.metadata().map_err(refused)?.len();
    let mut head = Vec::new();
    file.by_ref().take(HEADER_BYTES).read_to_end(&mut head).map_err(refused)?;
    let Ok((header, vertex)) = parse(path, &head) else { return Ok(None) };
    let Encoding::Binary(endian) = header.encoding else { return Ok(None) };
    let bytes =
        |element: &Element| element.stride().and_then(|s| (s as u64).checked_mul(element.count as u64));
    let mut before = header.elements[..vertex].iter().map(bytes);
    let start = before.try_fold(header.data_start as u64, |sum, n| sum.checked_add(n?));
    let element = header.elements[vertex].clone();
    let (Some(start), Some(stride), Some(length)) = (start, element.stride(), bytes(&element)) else {
        return Ok(None);
    };
    // What follows the last element may mean that a count is wrong: reading it whole looks at that.
    let last = vertex + 1 == header.elements.len();
    let fits = start
        .checked_add(length)
        .is_some_and(|end| end <= size && !(last && end.saturating_add(PADDING_BYTES) < size));
    let Ok(fields) = find_fields(path, &element, options.attributes) else { return Ok(None) };
    let own_range =
        |index: usize| matches!(scalar_of(element.properties[index].kind), Scalar::F32 | Scalar::F64);
    if !fits || stride == 0 || fields.rgb.is_some_and(|rgb| own_range(rgb[0])) {
        return Ok(None);
    }
    Ok(Some(Box::new(Rows { path: path.into(), file, start, stride, vertex: element, fields, endian })))
}

impl PointBlocks for Rows {
    fn rows(&self) -> usize {
        self.vertex.count
    }

    fn for_each(&mut self, take: &mut TakeBlock<'_>) -> Result<()> {
        let refused = |e| Error::read(&self.path, e);
        self.file.seek(SeekFrom::Start(self.start)).map_err(refused)?;
        let most = (BLOCK_BYTES / self.stride).clamp(1, BLOCK_POINTS).min(self.vertex.count);
        let mut bytes = vec![0; most * self.stride];
        let mut block = self.vertex.clone();
        let mut left = self.vertex.count;
        while left > 0 {
            block.count = most.min(left);
            let rows = &mut bytes[..block.count * self.stride];
            self.file.read_exact(rows).map_err(refused)?;
            take(binary::fixed_rows(rows, &block, self.stride, &self.fields, self.endian))?;
            left -= block.count;
        }
        Ok(())
    }
}
