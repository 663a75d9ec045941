//! Writing clouds as binary PLY.

use super::merged::MERGED_COMMENT;
use crate::atomic;
use crate::error::{Error, Result};
use crate::geometry::{Direction, Point};
use nalgebra::Vector3;
use std::io::Write;
use std::path::Path;

/// A cloud to be written: points, and what goes with each.
#[derive(Debug, Clone, Copy, Default)]
pub struct PlyCloud<'a> {
    /// `[n,3]`, metres, relative to `origin_m`.
    pub points: &'a [Point],
    /// Coordinates of the zero of `points` in the file.
    pub origin_m: Vector3<f64>,
    /// `[n,3]` unit normals.
    pub normals: Option<&'a [Direction]>,
    /// `[n]` sRGB colours.
    pub colors: Option<&'a [[u8; 3]]>,
    /// `[n]` strength of the return, in any unit.
    pub intensities: Option<&'a [f32]>,
    /// `[n]` number of the scan a point comes from.
    pub scans: Option<&'a [i32]>,
    /// Id of the run that the file is a merged cloud of, without spaces.
    pub run: Option<&'a str>,
}

/// Writes binary little-endian PLY: `float x y z`, or `double x y z` where the origin is not zero, then,
/// where given, `float nx ny nz`, `uchar red green blue`, `float intensity` and `int scan`.
///
/// # Errors
/// [`Error::Input`] when lengths differ, [`Error::Write`].
pub fn write_ply(path: impl AsRef<Path>, cloud: &PlyCloud<'_>) -> Result<()> {
    let n = cloud.points.len();
    let lengths = [
        ("normals", cloud.normals.map(<[_]>::len)),
        ("colours", cloud.colors.map(<[_]>::len)),
        ("intensities", cloud.intensities.map(<[_]>::len)),
        ("scan numbers", cloud.scans.map(<[_]>::len)),
    ];
    for (what, length) in lengths {
        if let Some(length) = length.filter(|&l| l != n) {
            let expected = format!("{n}, one for each point");
            return Err(Error::input(what, length.to_string(), expected, "give one value for every point"));
        }
    }
    atomic::write(path.as_ref(), |w| {
        write!(w, "ply\nformat binary_little_endian 1.0\ncomment lengths in metres\n")?;
        if let Some(run) = cloud.run {
            writeln!(w, "{MERGED_COMMENT}{run}")?;
        }
        writeln!(w, "element vertex {n}")?;
        let far = cloud.origin_m != Vector3::zeros();
        let number = if far { "double" } else { "float" };
        write!(w, "property {number} x\nproperty {number} y\nproperty {number} z\n")?;
        if cloud.normals.is_some() {
            write!(w, "property float nx\nproperty float ny\nproperty float nz\n")?;
        }
        if cloud.colors.is_some() {
            write!(w, "property uchar red\nproperty uchar green\nproperty uchar blue\n")?;
        }
        if cloud.intensities.is_some() {
            writeln!(w, "property float intensity")?;
        }
        if cloud.scans.is_some() {
            writeln!(w, "property int scan")?;
        }
        writeln!(w, "end_header")?;
        for (i, p) in cloud.points.iter().enumerate() {
            let normal = cloud.normals.map(|n| n[i]);
            if far {
                for c in (p.coords.cast::<f64>() + cloud.origin_m).iter() {
                    w.write_all(&c.to_le_bytes())?;
                }
            }
            let near = p.coords.iter().filter(|_| !far);
            for c in near.chain(normal.iter().flatten()) {
                w.write_all(&c.to_le_bytes())?;
            }
            if let Some(colors) = cloud.colors {
                w.write_all(&colors[i])?;
            }
            if let Some(intensities) = cloud.intensities {
                w.write_all(&intensities[i].to_le_bytes())?;
            }
            if let Some(scans) = cloud.scans {
                w.write_all(&scans[i].to_le_bytes())?;
            }
        }
        Ok(())
    })
}
