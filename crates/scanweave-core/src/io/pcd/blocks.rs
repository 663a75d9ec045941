//! Points of a binary PCD file, block by block.

use super::super::pcd_header::{Color, Encoding, Header, Places, parse_header};
use super::super::pcd_viewpoint::place_sensor;
use super::decode;
use crate::error::{Error, Result};
use crate::files;
use crate::io::blocks::{BLOCK_POINTS, PointBlocks, TakeBlock};
use crate::io::scalar::Scalar;
use crate::io::scan_file::ReadOptions;
use crate::scan::PointCloud;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Bytes that a header is looked for in.
const HEADER_BYTES: u64 = 1 << 20;
/// Bytes of a block, where rows are long.
const BLOCK_BYTES: usize = 16 << 20;

struct Rows {
    path: PathBuf,
    file: File,
    header: Header,
    places: Places,
    stride: usize,
}

/// The points of a file; `None` where they are text or compressed, do not fill the file as its header says,
/// or have colours whose range only all of them tell.
pub(in crate::io) fn open(path: &Path, options: &ReadOptions) -> Result<Option<Box<dyn PointBlocks>>> {
    let refused = |e| Error::read(path, e);
    let mut file = files::open(path)?;
    let size = file.metadata().map_err(refused)?.len();
    let mut head = Vec::new();
    file.by_ref().take(HEADER_BYTES).read_to_end(&mut head).map_err(refused)?;
    let Ok(header) = parse_header(path, &head) else { return Ok(None) };
    let Ok(stride) = header.stride(path) else { return Ok(None) };
    let Ok(mut places) = header.places(path, stride, false) else { return Ok(None) };
    let own_range = matches!(&places.color, Some(Color::Channels(c)) if c[0].scalar != Scalar::U8);
    let length = (stride as u64).checked_mul(header.points as u64);
    let fits = length.and_then(|n| n.checked_add(header.data_start as u64)) == Some(size);
    if header.encoding != Encoding::Binary || !fits || stride == 0 || own_range {
        return Ok(None);
    }
    if !options.attributes {
        (places.intensity, places.normal) = (None, None);
    }
    Ok(Some(Box::new(Rows { path: path.into(), file, header, places, stride })))
}

impl PointBlocks for Rows {
    fn rows(&self) -> usize {
        self.header.points
    }

    fn for_each(&mut self, take: &mut TakeBlock<'_>) -> Result<()> {
        let refused = |e| Error::read(&self.path, e);
        self.file.seek(SeekFrom::Start(self.header.data_start as u64)).map_err(refused)?;
        let most = (BLOCK_BYTES / self.stride).clamp(1, BLOCK_POINTS).min(self.header.points);
        let mut bytes = vec![0; most * self.stride];
        let mut left = self.header.points;
        while left > 0 {
            let rows = most.min(left);
            let data = &mut bytes[..rows * self.stride];
            self.file.read_exact(data).map_err(refused)?;
            take(decode(data, rows, &self.places))?;
            left -= rows;
        }
        Ok(())
    }

    fn place_sensor(&self, sample: &mut PointCloud) {
        if let Some(sensor) = &self.header.viewpoint {
            place_sensor(sensor, sample);
        }
    }
}
