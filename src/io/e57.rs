//! E57 (terrestrial laser scans), with cargo feature `e57`.

use super::assemble::{NO_COLORS, assemble};
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use std::path::Path;

/// Reads all scans of an E57 file, each moved by its own pose into the file's frame.
///
/// The viewpoint is known where the file holds a single scan.
pub(super) fn read(path: &Path) -> Result<PointCloud> {
    let damaged = |e: ::e57::Error| {
        let found = format!("an E57 file that cannot be decoded ({e})");
        Error::file(
            path,
            found,
            "E57 1.0 with cartesian or spherical coordinates",
            "copy or export the file again",
        )
    };
    let mut reader = ::e57::E57Reader::from_file(path).map_err(damaged)?;
    let scans = reader.pointclouds();
    let mut xyz: Vec<[f64; 3]> = Vec::new();
    let mut colors: Vec<[u8; 3]> = Vec::new();
    for scan in &scans {
        let mut points = reader.pointcloud_simple(scan).map_err(damaged)?;
        points.apply_pose(true);
        for point in points {
            let point = point.map_err(damaged)?;
            xyz.push(match point.cartesian {
                ::e57::CartesianCoordinate::Valid { x, y, z } => [x, y, z],
                // No return in that direction: dropped and counted with the non-finite rows.
                _ => [f64::NAN; 3],
            });
            // Normalised to [0, 1] by the reader.
            let byte = |v: f32| (v * 255.0).round() as u8;
            colors.push(point.color.map_or([0; 3], |c| [byte(c.red), byte(c.green), byte(c.blue)]));
        }
    }
    let viewpoint = match &scans[..] {
        [scan] => scan.transform.as_ref().map(|t| [t.translation.x, t.translation.y, t.translation.z]),
        _ => None,
    };
    let at = |i: usize| xyz[i];
    Ok(if scans.iter().any(|s| s.has_color()) {
        assemble(xyz.len(), at, Some(|i: usize| colors[i]), viewpoint)
    } else {
        assemble(xyz.len(), at, NO_COLORS, viewpoint)
    })
}
