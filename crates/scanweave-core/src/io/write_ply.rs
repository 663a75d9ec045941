//! Writing clouds as binary PLY.

use super::blocks::{PointBlocks, Summary, unwrapped, wrapped};
use super::merged::MERGED_COMMENT;
use crate::atomic;
use crate::error::{Error, Result};
use crate::geometry::{Direction, Point};
use crate::scan::PointCloud;
use nalgebra::Vector3;
use std::io::{self, Write};
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
        let layout = Layout {
            far: cloud.origin_m != Vector3::zeros(),
            normals: cloud.normals.is_some(),
            colors: cloud.colors.is_some(),
            intensities: cloud.intensities.is_some(),
            scans: cloud.scans.is_some(),
        };
        layout.header(w, n, cloud.run)?;
        layout.rows(w, cloud)
    })
}

/// [`write_ply`] of a scan that is not held whole.
///
/// # Errors
/// [`Error::Write`], and those of the scan.
pub fn write_ply_blocks(
    path: impl AsRef<Path>,
    summary: &Summary,
    blocks: &mut dyn PointBlocks,
) -> Result<()> {
    let path = path.as_ref();
    let layout = Layout {
        far: summary.origin_m != Vector3::zeros(),
        normals: summary.normals,
        colors: summary.colors,
        intensities: summary.intensities,
        scans: false,
    };
    let written = atomic::write(path, |w| {
        layout.header(w, summary.points, None)?;
        let rows = &mut |block: PointCloud| {
            let PointCloud { points, origin_m, normals, colors, intensities, .. } = &block;
            let (normals, colors) = (normals.as_deref(), colors.as_deref());
            let intensities = intensities.as_deref();
            let block = PlyCloud {
                points,
                origin_m: *origin_m,
                normals,
                colors,
                intensities,
                scans: None,
                run: None,
            };
            layout.rows(w, &block).map_err(|e| Error::write(path, e))
        };
        blocks.for_each(rows).map_err(wrapped)
    });
    written.map_err(unwrapped)
}

/// What the rows of a file hold.
struct Layout {
    /// Whether coordinates need double precision.
    far: bool,
    normals: bool,
    colors: bool,
    intensities: bool,
    scans: bool,
}

impl Layout {
    fn header(&self, w: &mut impl Write, n: usize, run: Option<&str>) -> io::Result<()> {
        write!(w, "ply\nformat binary_little_endian 1.0\ncomment lengths in metres\n")?;
        if let Some(run) = run {
            writeln!(w, "{MERGED_COMMENT}{run}")?;
        }
        writeln!(w, "element vertex {n}")?;
        let number = if self.far { "double" } else { "float" };
        write!(w, "property {number} x\nproperty {number} y\nproperty {number} z\n")?;
        if self.normals {
            write!(w, "property float nx\nproperty float ny\nproperty float nz\n")?;
        }
        if self.colors {
            write!(w, "property uchar red\nproperty uchar green\nproperty uchar blue\n")?;
        }
        if self.intensities {
            writeln!(w, "property float intensity")?;
        }
        if self.scans {
            writeln!(w, "property int scan")?;
        }
        writeln!(w, "end_header")
    }

    fn rows(&self, w: &mut impl Write, cloud: &PlyCloud<'_>) -> io::Result<()> {
        for (i, p) in cloud.points.iter().enumerate() {
            let position = p.coords.cast::<f64>() + cloud.origin_m;
            for c in position.iter() {
                match self.far {
                    true => w.write_all(&c.to_le_bytes())?,
                    false => w.write_all(&(*c as f32).to_le_bytes())?,
                }
            }
            for c in cloud.normals.iter().flat_map(|n| n[i].iter()) {
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
    }
}
