//! Writing clouds as binary PCD.

use crate::atomic;
use crate::error::Result;
use crate::geometry::Point;
use crate::scan::PointCloud;
use nalgebra::Vector3;
use std::io::Write;
use std::path::Path;

/// Writes a cloud as binary PCD 0.7 in the coordinates of its file: `x y z` as floats, or doubles where
/// the origin is not zero, then `rgb` (packed, as PCL has it), `intensity` and normals, where the cloud
/// has them; the viewpoint as that of the file.
///
/// # Errors
/// [`Error::Write`](crate::Error::Write).
pub fn write_pcd(path: impl AsRef<Path>, cloud: &PointCloud) -> Result<()> {
    let far = cloud.origin_m != Vector3::zeros();
    let mut fields: Vec<(&str, usize, char)> =
        ["x", "y", "z"].map(|n| (n, if far { 8 } else { 4 }, 'F')).into();
    if cloud.colors.is_some() {
        fields.push(("rgb", 4, 'F'));
    }
    if cloud.intensities.is_some() {
        fields.push(("intensity", 4, 'F'));
    }
    if cloud.normals.is_some() {
        fields.extend(["normal_x", "normal_y", "normal_z"].map(|n| (n, 4, 'F')));
    }
    let line =
        |of: &dyn Fn(&(&str, usize, char)) -> String| fields.iter().map(of).collect::<Vec<_>>().join(" ");
    let n = cloud.len();
    let seen_from = |v: Point| v.coords.cast::<f64>() + cloud.origin_m;
    let viewpoint = cloud.viewpoint.map_or_else(Vector3::zeros, seen_from);
    atomic::write(path.as_ref(), |w| {
        writeln!(w, "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7")?;
        writeln!(w, "FIELDS {}", line(&|f| f.0.to_owned()))?;
        writeln!(w, "SIZE {}", line(&|f| f.1.to_string()))?;
        writeln!(w, "TYPE {}", line(&|f| f.2.to_string()))?;
        writeln!(w, "COUNT {}", line(&|_| "1".to_owned()))?;
        let [x, y, z]: [f64; 3] = viewpoint.into();
        writeln!(w, "WIDTH {n}\nHEIGHT 1\nVIEWPOINT {x} {y} {z} 1 0 0 0\nPOINTS {n}\nDATA binary")?;
        for (i, p) in cloud.points.iter().enumerate() {
            match far {
                true => {
                    for c in (p.coords.cast::<f64>() + cloud.origin_m).iter() {
                        w.write_all(&c.to_le_bytes())?;
                    }
                }
                false => {
                    for c in p.coords.iter() {
                        w.write_all(&c.to_le_bytes())?;
                    }
                }
            }
            if let Some(colors) = &cloud.colors {
                let [r, g, b] = colors[i];
                w.write_all(&[b, g, r, 0])?;
            }
            if let Some(intensities) = &cloud.intensities {
                w.write_all(&intensities[i].to_le_bytes())?;
            }
            if let Some(normals) = &cloud.normals {
                for c in normals[i].iter() {
                    w.write_all(&c.to_le_bytes())?;
                }
            }
        }
        Ok(())
    })
}
