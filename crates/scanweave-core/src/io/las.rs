//! LAS and LAZ (airborne and terrestrial laser scans).

pub(super) mod blocks;
mod sizes;

use self::sizes::PointsOf;
use super::scan_file::{ReadOptions, ScanFile};
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use crate::scan::assemble::{Attributes, assemble_with};
use std::io::{Read, Seek};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// Points decoded at a time: few enough that a header's count reserves nothing by itself.
const CHUNK_POINTS: u64 = 1 << 16;

/// Reads a LAS or LAZ file; 16-bit colours are scaled to bytes. Points that are marked as withheld are
/// dropped and counted.
///
/// # Errors
/// [`Error::File`] for a damaged file, for fewer points than its header promises, and for a scale that
/// leaves nothing of the coordinates.
pub(super) fn read<R>(path: &Path, mut file: R, options: &ReadOptions) -> Result<ScanFile>
where
    R: Read + Seek + Send + Sync + 'static,
{
    let end = sizes::end_of_points(path, &mut file, options)?;
    let file = PointsOf::new(file, end);
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

/// The columns of the points that are kept, as the file stores them.
#[derive(Default)]
struct Columns {
    xyz: Vec<[i32; 3]>,
    rgb: Option<Vec<[u16; 3]>>,
    intensity: Option<Vec<u16>>,
    withheld: usize,
}

impl Columns {
    fn new(header: &::las::Header, options: &ReadOptions) -> Self {
        Self {
            rgb: header.point_format().has_color.then(Vec::new),
            intensity: options.attributes.then(Vec::new),
            ..Self::default()
        }
    }

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

    fn has_wide_colors(&self) -> bool {
        self.rgb.iter().flatten().flatten().any(|&v| v > 255)
    }

    /// The points; `bytes` says that colours are of 8 bits.
    fn into_cloud(self, transforms: &::las::Vector<::las::Transform>, bytes: bool) -> PointCloud {
        let xyz = &self.xyz;
        let at = |i: usize| {
            let [x, y, z] = xyz[i];
            [transforms.x.direct(x), transforms.y.direct(y), transforms.z.direct(z)]
        };
        let rgb = self.rgb.as_ref();
        let rgb = rgb.map(|rgb| move |i: usize| rgb[i].map(|v| if bytes { v as u8 } else { (v >> 8) as u8 }));
        let intensity = self.intensity.as_ref().map(|all| |i: usize| f32::from(all[i]));
        let attributes = Attributes {
            rgb: rgb.as_ref().map(|rgb| rgb as &dyn Fn(usize) -> [u8; 3]),
            intensity: intensity.as_ref().map(|intensity| intensity as &dyn Fn(usize) -> f32),
            ..Attributes::default()
        };
        let mut cloud = assemble_with(xyz.len(), at, &attributes, None);
        cloud.dropped_rows += self.withheld;
        cloud
    }
}

fn decode<R>(path: &Path, file: R, options: &ReadOptions) -> Result<ScanFile>
where
    R: Read + Seek + Send + Sync + 'static,
{
    let mut reader = ::las::Reader::new(file).map_err(|e| damaged(path, &e))?;
    let mut columns = Columns::new(reader.header(), options);
    each_chunk(path, &mut reader, |chunk| {
        columns.push(chunk);
        Ok(true)
    })?;
    check_scales(path, &columns, reader.header().transforms())?;
    // The standard asks for 16-bit colours; files with 8-bit values in them are common.
    let bytes = !columns.has_wide_colors();
    Ok(columns.into_cloud(reader.header().transforms(), bytes).into())
}

/// Refuses a scale that takes all points to one place of an axis, or to none.
fn check_scales(path: &Path, columns: &Columns, transforms: &::las::Vector<::las::Transform>) -> Result<()> {
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let ::las::Transform { scale, offset } = [transforms.x, transforms.y, transforms.z][axis];
        // Writers that fit the scale to the points write zero for an axis along which nothing varies.
        let varies = columns.xyz.windows(2).any(|pair| pair[0][axis] != pair[1][axis]);
        if !(scale.is_finite() && offset.is_finite()) || (scale == 0.0 && varies) {
            let found = format!("a scale of {scale} and an offset of {offset} for {name}");
            let remedy = "export the file again: its header is damaged";
            return Err(Error::file(path, found, "finite numbers, and a scale that is not zero", remedy));
        }
    }
    Ok(())
}

/// Hands the points to `take`, some at a time, until it wants no more.
fn each_chunk(
    path: &Path,
    reader: &mut ::las::Reader,
    mut take: impl FnMut(&::las::PointData) -> Result<bool>,
) -> Result<()> {
    let promised = reader.header().number_of_points();
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
        if !take(&chunk)? {
            return Ok(());
        }
        read += got;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
