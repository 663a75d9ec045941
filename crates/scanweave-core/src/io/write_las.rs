//! Writing clouds as LAS or LAZ.

use super::blocks::{PointBlocks, Summary, coordinates_m, unwrapped, wrapped};
use crate::atomic;
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use las::point::Format;
use las::{Builder, Color, Header, Transform, Vector, Writer};
use std::io::{self, BufWriter};
use std::mem::ManuallyDrop;
use std::path::Path;

/// Writes a scan as LAS 1.2, or LAZ where `compressed`. Coordinates are whole multiples of a step, as the
/// format has it: the smallest power of ten, a micrometre or more, with which the scan fits. Intensities
/// are scaled to the 65535 that the format has; it has no normals.
///
/// # Errors
/// [`Error::Write`], and those of the scan.
pub fn write_las(
    path: impl AsRef<Path>,
    summary: &Summary,
    blocks: &mut dyn PointBlocks,
    compressed: bool,
) -> Result<()> {
    let path = path.as_ref();
    let strongest = summary.intensity_range.map_or(0.0, |[_, high]| high.max(0.0));
    // Values of 16 bits stay as they are; shares of one become shares of the largest number.
    let gain =
        if strongest <= 1.0 { f32::from(u16::MAX) } else { (f32::from(u16::MAX) / strongest).min(1.0) };
    let written = atomic::write_file(path, |file| {
        let file = BufWriter::with_capacity(1 << 16, file.try_clone()?);
        // A writer that could not be closed panics when it is dropped, as on a full disk: it is then
        // forgotten, with its handle of the file.
        let header = header(summary, compressed).map_err(io::Error::other)?;
        let mut writer = ManuallyDrop::new(Writer::new(file, header).map_err(io::Error::other)?);
        let points = &mut |block: PointCloud| {
            for i in 0..block.len() {
                let point = writer.write_point(point(&block, i, gain));
                point.map_err(|e| Error::write(path, io::Error::other(e)))?;
            }
            Ok(())
        };
        blocks.for_each(points).map_err(wrapped)?;
        writer.close().map_err(io::Error::other)?;
        ManuallyDrop::into_inner(writer).into_inner().map_err(io::Error::other)?.into_inner()?;
        Ok(())
    });
    written.map_err(unwrapped)
}

fn header(summary: &Summary, compressed: bool) -> las::Result<Header> {
    let mut builder = Builder::from((1, 2));
    builder.date = None;
    builder.generating_software = concat!("scanweave ", env!("CARGO_PKG_VERSION")).to_owned();
    let scale = step_m(summary);
    let axis = |axis: usize| Transform { scale, offset: summary.origin_m[axis] };
    builder.transforms = Vector { x: axis(0), y: axis(1), z: axis(2) };
    builder.point_format = Format::new(if summary.colors { 2 } else { 0 })?;
    builder.point_format.is_compressed = compressed;
    builder.into_header()
}

fn point(block: &PointCloud, i: usize, gain: f32) -> las::Point {
    let [x, y, z]: [f64; 3] = coordinates_m(block, i).into();
    let color = block.colors.as_ref().map(|c| {
        let [red, green, blue] = c[i].map(|v| u16::from(v) * 257);
        Color { red, green, blue }
    });
    let intensity = block.intensities.as_ref().map_or(0, |v| (v[i] * gain).round() as u16);
    las::Point { x, y, z, intensity, color, ..las::Point::default() }
}

/// Smallest power of ten, from a micrometre, of which no coordinate has more than thirty bits.
fn step_m(summary: &Summary) -> f64 {
    let Summary { low_m, high_m, origin_m, .. } = summary;
    let largest = (high_m - origin_m).amax().max((low_m - origin_m).amax());
    let mut step = 1e-6;
    // Without a point there is no largest coordinate.
    while summary.points > 0 && largest / step >= f64::from(1 << 30) {
        step *= 10.0;
    }
    step
}
