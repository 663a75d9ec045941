//! LAS and LAZ (airborne and terrestrial laser scans).

use super::packed::limit_bytes;
use super::scalar::counted;
use super::scan_file::{ReadOptions, ScanFile};
use crate::error::{Error, Result};
use crate::scan::assemble::{Attributes, assemble_with};
use ::las::raw;
use std::io::{Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// Points decoded at a time: few enough that a header's count reserves nothing by itself.
const CHUNK_POINTS: u64 = 1 << 16;

/// Reads a LAS or LAZ file; 16-bit colours are scaled to bytes. Points that are marked as withheld are
/// dropped and counted.
///
/// # Errors
/// [`Error::File`] for a damaged file, and for fewer points than its header promises.
pub(super) fn read<R>(path: &Path, mut file: R, options: &ReadOptions) -> Result<ScanFile>
where
    R: Read + Seek + Send + Sync + 'static,
{
    check_sizes(path, &mut file)?;
    // The decoder of LAZ indexes by what the file says and may panic on a damaged one.
    catch_unwind(AssertUnwindSafe(|| decode(path, file, options)))
        .unwrap_or_else(|_| Err(damaged(path, &"its parts contradict one another")))
}

fn damaged(path: &Path, why: &dyn std::fmt::Display) -> Error {
    let found = format!("a LAS file that cannot be decoded ({why})");
    Error::file(path, found, "LAS 1.0 to 1.4 or LAZ", "copy or export the file again")
}

fn cut_short(path: &Path, found: String, promised: u64) -> Error {
    let expected = format!("{promised} as its header says");
    Error::file(path, found, expected, "copy the file again: it is cut short")
}

/// Refuses sizes in the header that the file cannot hold, before the decoder reserves memory by them.
fn check_sizes(path: &Path, file: &mut (impl Read + Seek)) -> Result<()> {
    let io = |e: std::io::Error| damaged(path, &e);
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
    // The two upper bits of the format mark LAZ.
    let packed = header.point_data_record_format & 0xc0 != 0;
    let held = size.saturating_sub(start);
    let fits = if packed { limit_bytes(held).max(held) } else { held };
    if promised.checked_mul(record).is_none_or(|needed| needed > fits) {
        let room = counted((fits.checked_div(record).unwrap_or(0)) as usize, "point");
        return Err(cut_short(path, format!("room for {room}"), promised));
    }
    let mut number_at = |at: u64, bytes: &mut [u8]| -> std::io::Result<()> {
        file.seek(SeekFrom::Start(at)).and_then(|_| file.read_exact(bytes))
    };
    if let Some(evlr) = &header.evlr {
        // Its length stands after two reserved bytes, a user id of 16 and a record id of 2.
        let mut length = [0; 8];
        number_at(evlr.start_of_first_evlr.saturating_add(20), &mut length).map_err(io)?;
        let length = u64::from_le_bytes(length);
        if length > size {
            return Err(damaged(path, &format!("a record of {length} bytes in a file of {size}")));
        }
    }
    if packed {
        let (mut offset, mut chunks) = ([0; 8], [0; 4]);
        number_at(start, &mut offset).map_err(io)?;
        let mut table = u64::from_le_bytes(offset);
        // A writer that could not go back keeps the place of the table at the end of the file.
        if table as i64 <= start as i64 {
            number_at(size.saturating_sub(8), &mut offset).map_err(io)?;
            table = u64::from_le_bytes(offset);
        }
        // Every chunk of points begins with one that is not packed.
        if number_at(table.saturating_add(4), &mut chunks).is_ok()
            && u64::from(u32::from_le_bytes(chunks)) > held / record.max(1) + 1
        {
            return Err(damaged(path, &"more chunks than it has room for"));
        }
    }
    file.rewind().map_err(io)
}

/// The columns of the points that are kept, as the file stores them.
#[derive(Default)]
struct Columns {
    xyz: Vec<[i32; 3]>,
    rgb: Option<Vec<[u16; 3]>>,
    intensity: Option<Vec<u16>>,
    withheld: usize,
}

impl Columns {
    fn push(&mut self, data: &::las::PointData) {
        let extended = data.format().is_extended;
        let withheld = |record: &[u8]| match extended {
            true => record.get(15).is_some_and(|flags| flags & 0b100 != 0),
            false => record.get(15).is_some_and(|flags| flags & 0x80 != 0),
        };
        let keep: Vec<bool> =
            data.raw_bytes().chunks_exact(data.record_len()).map(|r| !withheld(r)).collect();
        let xyz = data.x_raw().zip(data.y_raw()).zip(data.z_raw()).map(|((x, y), z)| [x, y, z]);
        self.xyz.extend(xyz.zip(&keep).filter(|(_, keep)| **keep).map(|(p, _)| p));
        if let (Some(all), Some(rgb)) = (&mut self.rgb, data.rgb()) {
            all.extend(rgb.zip(&keep).filter(|(_, keep)| **keep).map(|((r, g, b), _)| [r, g, b]));
        }
        if let Some(all) = &mut self.intensity {
            all.extend(data.intensity().zip(&keep).filter(|(_, keep)| **keep).map(|(v, _)| v));
        }
        self.withheld += keep.iter().filter(|keep| !**keep).count();
    }
}

fn decode<R>(path: &Path, file: R, options: &ReadOptions) -> Result<ScanFile>
where
    R: Read + Seek + Send + Sync + 'static,
{
    let mut reader = ::las::Reader::new(file).map_err(|e| damaged(path, &e))?;
    let promised = reader.header().number_of_points();
    let transforms = *reader.header().transforms();
    let mut columns = Columns {
        rgb: reader.header().point_format().has_color.then(Vec::new),
        intensity: options.attributes.then(Vec::new),
        ..Columns::default()
    };
    let mut chunk = ::las::PointDataBuilder::new().for_header(reader.header()).build();
    let mut read = 0;
    while read < promised {
        let wanted = CHUNK_POINTS.min(promised - read);
        let got = reader.fill_points(wanted, &mut chunk);
        let got = got.map_err(|e| {
            cut_short(path, format!("points that end after {read} to {} ({e})", read + wanted), promised)
        })?;
        if got == 0 {
            return Err(cut_short(path, format!("{read} points"), promised));
        }
        columns.push(&chunk);
        read += got;
    }
    Ok(cloud(&columns, &transforms))
}

fn cloud(columns: &Columns, transforms: &::las::Vector<::las::Transform>) -> ScanFile {
    let xyz = &columns.xyz;
    let at = |i: usize| {
        let [x, y, z] = xyz[i];
        [transforms.x.direct(x), transforms.y.direct(y), transforms.z.direct(z)]
    };
    // The standard asks for 16-bit colours; files with 8-bit values in them are common.
    let bytes = columns.rgb.iter().flatten().flatten().all(|&v| v <= 255);
    let rgb = columns.rgb.as_ref();
    let rgb = rgb.map(|rgb| move |i: usize| rgb[i].map(|v| if bytes { v as u8 } else { (v >> 8) as u8 }));
    let intensity = columns.intensity.as_ref().map(|all| |i: usize| f32::from(all[i]));
    let attributes = Attributes {
        rgb: rgb.as_ref().map(|rgb| rgb as &dyn Fn(usize) -> [u8; 3]),
        intensity: intensity.as_ref().map(|intensity| intensity as &dyn Fn(usize) -> f32),
        ..Attributes::default()
    };
    let mut cloud = assemble_with(xyz.len(), at, &attributes, None);
    cloud.dropped_rows += columns.withheld;
    cloud.into()
}

#[cfg(test)]
mod tests {
    use crate::io::read_cloud;

    #[test]
    fn las_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        for (name, compressed) in [("a.las", false), ("a.laz", true)] {
            let path = dir.path().join(name);
            let mut builder = ::las::Builder::from((1, 2));
            builder.point_format = ::las::point::Format::new(2).unwrap();
            builder.point_format.is_compressed = compressed;
            let transform = |offset: f64| ::las::Transform { scale: 0.001, offset };
            builder.transforms =
                ::las::Vector { x: transform(431_000.0), y: transform(5_812_000.0), z: transform(0.0) };
            let mut writer = ::las::Writer::from_path(&path, builder.into_header().unwrap()).unwrap();
            for i in 0..10 {
                writer
                    .write_point(::las::Point {
                        x: 431_250.123 + f64::from(i),
                        y: 5_812_345.678,
                        z: 12.5,
                        color: Some(::las::Color::new(0xff00, 0x8000, 0)),
                        ..Default::default()
                    })
                    .unwrap();
            }
            writer.close().unwrap();
            let cloud = read_cloud(&path).unwrap();
            assert_eq!(cloud.origin_m, nalgebra::Vector3::new(431_300.0, 5_812_300.0, 0.0));
            assert_eq!(cloud.colors, Some(vec![[255, 128, 0]; 10]));
            let back = cloud.points[3].coords.cast::<f64>() + cloud.origin_m;
            // The file's own step is 1 mm.
            assert!(
                (back - nalgebra::Vector3::new(431_253.123, 5_812_345.678, 12.5)).amax() < 6e-4,
                "{back}"
            );
        }
    }
}
