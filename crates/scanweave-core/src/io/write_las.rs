//! Writing clouds as LAS or LAZ.

use crate::atomic;
use crate::error::Result;
use crate::scan::PointCloud;
use las::point::Format;
use las::{Builder, Color, Transform, Vector, Writer};
use std::io::{self, BufWriter};
use std::mem::ManuallyDrop;
use std::path::Path;

/// Writes a cloud as LAS 1.2, or LAZ where `compressed`, in the coordinates of its file. Coordinates are
/// whole multiples of a step, as the format has it: the smallest power of ten, a micrometre or more, with
/// which the cloud fits. Intensities are scaled to the 65535 that the format has; it has no normals.
///
/// # Errors
/// [`Error::Write`](crate::Error::Write).
pub fn write_las(path: impl AsRef<Path>, cloud: &PointCloud, compressed: bool) -> Result<()> {
    let scale = step_m(cloud);
    let mut builder = Builder::from((1, 2));
    builder.date = None;
    builder.generating_software = concat!("scanweave ", env!("CARGO_PKG_VERSION")).to_owned();
    let axis = |axis: usize| Transform { scale, offset: cloud.origin_m[axis] };
    builder.transforms = Vector { x: axis(0), y: axis(1), z: axis(2) };
    let strongest = cloud.intensities.iter().flatten().copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
    // Values of 16 bits stay as they are; shares of one become shares of the largest number.
    let gain =
        if strongest <= 1.0 { f32::from(u16::MAX) } else { (f32::from(u16::MAX) / strongest).min(1.0) };
    atomic::write_file(path.as_ref(), |file| {
        let mut format = Format::new(if cloud.colors.is_some() { 2 } else { 0 }).map_err(io::Error::other)?;
        format.is_compressed = compressed;
        builder.point_format = format;
        let header = builder.into_header().map_err(io::Error::other)?;
        let file = BufWriter::with_capacity(1 << 16, file.try_clone()?);
        // A writer that could not be closed panics when it is dropped, as on a full disk: it is then
        // forgotten, with its handle of the file.
        let mut writer = ManuallyDrop::new(Writer::new(file, header).map_err(io::Error::other)?);
        for (i, p) in cloud.points.iter().enumerate() {
            let [x, y, z]: [f64; 3] = (p.coords.cast::<f64>() + cloud.origin_m).into();
            let color = cloud.colors.as_ref().map(|c| {
                let [red, green, blue] = c[i].map(|v| u16::from(v) * 257);
                Color { red, green, blue }
            });
            let intensity = cloud.intensities.as_ref().map_or(0, |v| (v[i] * gain).round() as u16);
            let point = las::Point { x, y, z, intensity, color, ..las::Point::default() };
            writer.write_point(point).map_err(io::Error::other)?;
        }
        writer.close().map_err(io::Error::other)?;
        ManuallyDrop::into_inner(writer).into_inner().map_err(io::Error::other)?.into_inner()?;
        Ok(())
    })
}

/// Smallest power of ten, from a micrometre, of which no coordinate has more than thirty bits.
fn step_m(cloud: &PointCloud) -> f64 {
    let largest = cloud.points.iter().map(|p| f64::from(p.coords.amax())).fold(0.0, f64::max);
    let mut step = 1e-6;
    while largest / step >= f64::from(1 << 30) {
        step *= 10.0;
    }
    step
}
