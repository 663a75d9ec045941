//! Sizes that the header of a LAS file states, held against the file before memory is reserved by them.

use super::{cut_short, damaged};
use crate::error::Result;
use crate::io::scalar::counted;
use crate::io::scan_file::ReadOptions;
use crate::io::unpack_limit::UnpackLimit;
use ::las::{Header, raw};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// The two upper bits of the format of the points mark LAZ.
const PACKED: u8 = 0xc0;
/// Bytes of points that a packed byte stands for at most; a file that promises more is cut short.
const LARGEST_EXPANSION: u64 = 1000;
/// In LAZ the place of the table of chunks stands before the points.
const TABLE_PLACE_BYTES: u64 = 8;
/// Id of the record that says how LAZ is packed.
const LAZ_RECORD_ID: u16 = 22204;
/// LAZ without chunks, and so without a table of them.
const WITHOUT_CHUNKS: u16 = 1;

/// Where the points of a file end. The file is left at its start.
///
/// # Errors
/// [`Error::File`](crate::Error::File) for more points, chunks or extended records than it has room for, and
/// for packed points beyond the limit.
pub(super) fn end_of_points(
    path: &Path,
    file: &mut (impl Read + Seek),
    options: &ReadOptions,
) -> Result<u64> {
    let io = |e: io::Error| damaged(path, &e);
    let size = file.seek(SeekFrom::End(0)).map_err(io)?;
    file.rewind().map_err(io)?;
    let header = raw::Header::read_from(&mut *file).map_err(|e| damaged(path, &e))?;
    let start = u64::from(header.offset_to_point_data);
    let record = u64::from(header.point_data_record_length);
    let legacy = u64::from(header.number_of_point_records);
    let promised = match &header.large_file {
        Some(large) if legacy == 0 => large.number_of_point_records,
        _ => legacy,
    };
    let mut end = size;
    if let Some(evlr) = &header.evlr {
        // Its length stands after two reserved bytes, a user id of 16 and a record id of 2.
        let length: [u8; 8] = bytes_at(file, evlr.start_of_first_evlr.saturating_add(20)).map_err(io)?;
        let length = u64::from_le_bytes(length);
        if length > size {
            return Err(damaged(path, &format!("a record of {length} bytes in a file of {size}")));
        }
        end = end.min(evlr.start_of_first_evlr.max(start));
    }
    let packed = header.point_data_record_format & PACKED != 0;
    let held = end.saturating_sub(start);
    let limit = UnpackLimit::of_scan(options, size);
    let most = held.saturating_mul(LARGEST_EXPANSION).max(limit.bytes());
    let room = if packed { most } else { held };
    let stated = promised.saturating_mul(record);
    if stated > room {
        let room = counted(room.checked_div(record).unwrap_or(0) as usize, "point");
        return Err(cut_short(path, format!("room for {room}"), promised));
    }
    if packed && stated > limit.bytes() {
        return Err(limit.exceeded(path, "points"));
    }
    if packed {
        end = end_of_chunks(path, file, (start, size), (record, promised))?;
    }
    file.rewind().map_err(io)?;
    Ok(end)
}

/// Where the chunks of a LAZ file end and the table of them begins.
fn end_of_chunks(
    path: &Path,
    file: &mut (impl Read + Seek),
    (start, size): (u64, u64),
    (record, promised): (u64, u64),
) -> Result<u64> {
    let io = |e: io::Error| damaged(path, &e);
    file.rewind().map_err(io)?;
    let header = Header::new(&mut *file).map_err(|e| damaged(path, &e))?;
    let vlr = header.laz_vlr().map_err(|e| damaged(path, &e))?;
    if vlr.items_size() != record {
        let why = format!("points of {} bytes packed as {}", record, vlr.items_size());
        return Err(damaged(path, &why));
    }
    // The record of the compression begins with its kind.
    let record_of_laz = header.vlrs().iter().find(|vlr| vlr.record_id == LAZ_RECORD_ID);
    if record_of_laz
        .and_then(|vlr| vlr.data.first_chunk())
        .is_some_and(|kind| u16::from_le_bytes(*kind) == WITHOUT_CHUNKS)
    {
        return Ok(size);
    }
    let mut table = u64::from_le_bytes(bytes_at(file, start).map_err(io)?);
    // A writer that could not go back keeps the place of the table at the end of the file.
    if table as i64 <= start as i64 {
        table = u64::from_le_bytes(bytes_at(file, size.saturating_sub(8)).map_err(io)?);
    }
    if table < start.saturating_add(TABLE_PLACE_BYTES) || table > size.saturating_sub(8) {
        let found = format!("{size} bytes that end before the table of the chunks");
        return Err(cut_short(path, found, promised));
    }
    // Every chunk begins with a point that is not packed.
    let chunks = u64::from(u32::from_le_bytes(bytes_at(file, table.saturating_add(4)).map_err(io)?));
    if chunks > (table - start) / record.max(1) {
        return Err(damaged(path, &format!("{chunks} chunks, more than it has room for")));
    }
    Ok(table)
}

fn bytes_at<const N: usize>(file: &mut (impl Read + Seek), at: u64) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    file.seek(SeekFrom::Start(at))?;
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// A file that ends for whoever reads on from its points; what lies behind them must be sought.
///
/// Without it the decoder of LAZ takes the table of the chunks for more points.
pub(super) struct PointsOf<R> {
    file: R,
    position: u64,
    end: u64,
    sought: bool,
}

impl<R> PointsOf<R> {
    /// The file, at its start, with the place where its points end.
    pub(super) fn new(file: R, end: u64) -> Self {
        Self { file, position: 0, end, sought: false }
    }
}

impl<R: Read> Read for PointsOf<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let room = match self.end.checked_sub(self.position) {
            Some(0) if !self.sought => 0,
            Some(left) if left > 0 => usize::try_from(left).unwrap_or(usize::MAX).min(buffer.len()),
            _ => buffer.len(),
        };
        let read = self.file.read(&mut buffer[..room])?;
        self.position += read as u64;
        self.sought = false;
        Ok(read)
    }
}

impl<R: Seek> Seek for PointsOf<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.position = self.file.seek(to)?;
        // Asking for the position moves nothing.
        self.sought |= !matches!(to, SeekFrom::Current(0));
        Ok(self.position)
    }
}
