//! Writing clouds as binary PCD.

use super::blocks::{PointBlocks, Summary, coordinates_m, unwrapped, wrapped};
use crate::atomic;
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use nalgebra::Vector3;
use std::io::{self, Write};
use std::path::Path;

/// Writes a scan as binary PCD 0.7: `x y z` as floats, or doubles where the origin is not zero, then `rgb`
/// (packed, as PCL has it), `intensity` and normals, where the scan has them; where the sensor stood as
/// its viewpoint.
///
/// # Errors
/// [`Error::Write`], and those of the scan.
pub fn write_pcd(path: impl AsRef<Path>, summary: &Summary, blocks: &mut dyn PointBlocks) -> Result<()> {
    let path = path.as_ref();
    let far = summary.origin_m != Vector3::zeros();
    let written = atomic::write(path, |w| {
        header(w, summary, far)?;
        let rows = &mut |block: PointCloud| rows(w, &block, far).map_err(|e| Error::write(path, e));
        blocks.for_each(rows).map_err(wrapped)
    });
    written.map_err(unwrapped)
}

fn header(w: &mut impl Write, summary: &Summary, far: bool) -> io::Result<()> {
    let mut fields: Vec<(&str, usize)> = ["x", "y", "z"].map(|n| (n, if far { 8 } else { 4 })).into();
    if summary.colors {
        fields.push(("rgb", 4));
    }
    if summary.intensities {
        fields.push(("intensity", 4));
    }
    if summary.normals {
        fields.extend(["normal_x", "normal_y", "normal_z"].map(|n| (n, 4)));
    }
    let line = |of: &dyn Fn(&(&str, usize)) -> String| fields.iter().map(of).collect::<Vec<_>>().join(" ");
    writeln!(w, "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7")?;
    writeln!(w, "FIELDS {}", line(&|f| f.0.to_owned()))?;
    writeln!(w, "SIZE {}", line(&|f| f.1.to_string()))?;
    writeln!(w, "TYPE {}", line(&|_| "F".to_owned()))?;
    writeln!(w, "COUNT {}", line(&|_| "1".to_owned()))?;
    let [x, y, z]: [f64; 3] = summary.viewpoint_m.unwrap_or_default().into();
    let n = summary.points;
    writeln!(w, "WIDTH {n}\nHEIGHT 1\nVIEWPOINT {x} {y} {z} 1 0 0 0\nPOINTS {n}\nDATA binary")
}

fn rows(w: &mut impl Write, block: &PointCloud, far: bool) -> io::Result<()> {
    for i in 0..block.len() {
        for c in coordinates_m(block, i).iter() {
            match far {
                true => w.write_all(&c.to_le_bytes())?,
                false => w.write_all(&(*c as f32).to_le_bytes())?,
            }
        }
        if let Some(colors) = &block.colors {
            let [r, g, b] = colors[i];
            w.write_all(&[b, g, r, 0])?;
        }
        if let Some(intensities) = &block.intensities {
            w.write_all(&intensities[i].to_le_bytes())?;
        }
        for c in block.normals.iter().flat_map(|n| n[i].iter()) {
            w.write_all(&c.to_le_bytes())?;
        }
    }
    Ok(())
}
