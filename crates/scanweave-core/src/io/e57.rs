//! E57 (terrestrial laser scans).

use crate::error::{Error, Result};
use crate::scan::PointCloud;
use crate::scan::assemble::{NO_COLORS, assemble};
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

#[cfg(test)]
mod tests {
    use crate::geometry::Point;
    use crate::io::read_cloud;
    use ::e57::{E57Writer, Quaternion, Record, RecordValue, Transform, Translation};
    use std::path::Path;

    /// Writes a file of scans, each with a pose of its own: a shift, after a quarter turn about z.
    fn write(path: &Path, shifts: &[[f64; 3]], points: &[[f32; 3]]) {
        let mut file = E57Writer::from_file(path, "file").unwrap();
        for (number, [x, y, z]) in shifts.iter().copied().enumerate() {
            let prototype = vec![
                Record::CARTESIAN_X_F32,
                Record::CARTESIAN_Y_F32,
                Record::CARTESIAN_Z_F32,
                Record::COLOR_RED_U8,
                Record::COLOR_GREEN_U8,
                Record::COLOR_BLUE_U8,
            ];
            let mut scan = file.add_pointcloud(&format!("scan {number}"), prototype).unwrap();
            let half = std::f64::consts::FRAC_PI_4;
            scan.set_transform(Some(Transform {
                rotation: Quaternion { w: half.cos(), x: 0.0, y: 0.0, z: half.sin() },
                translation: Translation { x, y, z },
            }));
            for [x, y, z] in points {
                let values = [x, y, z].map(|v| RecordValue::Single(*v));
                let color = [255, 128, number as i64].map(RecordValue::Integer);
                scan.add_point([values, color].concat()).unwrap();
            }
            scan.finalize().unwrap();
        }
        file.finalize().unwrap();
    }

    #[test]
    fn scans_are_moved_by_their_poses_and_keep_their_colours() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.e57");
        let points = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];
        write(&path, &[[10.0, 20.0, 30.0]], &points);
        let one = read_cloud(&path).unwrap();
        // A quarter turn about z takes (x, y) to (-y, x).
        let expected = [Point::new(8.0, 21.0, 33.0), Point::new(5.0, 24.0, 36.0)];
        assert_eq!(one.len(), 2);
        assert!(one.points.iter().zip(expected).all(|(p, e)| (p - e).norm() < 1e-5), "{:?}", one.points);
        assert_eq!(one.colors, Some(vec![[255, 128, 0]; 2]));
        assert!((one.viewpoint.unwrap() - Point::new(10.0, 20.0, 30.0)).norm() < 1e-5);

        write(&path, &[[10.0, 20.0, 30.0], [0.0, 0.0, 0.0]], &points);
        let two = read_cloud(&path).unwrap();
        assert_eq!(two.len(), 4);
        assert!((two.points[2] - Point::new(-2.0, 1.0, 3.0)).norm() < 1e-5);
        assert_eq!(two.colors.unwrap()[3], [255, 128, 1]);
        // Two stood at different places.
        assert_eq!(two.viewpoint, None);
    }

    #[test]
    fn a_file_that_is_cut_short_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.e57");
        write(&path, &[[0.0; 3]], &[[1.0, 2.0, 3.0]; 500]);
        let whole = std::fs::read(&path).unwrap();
        for keep in [whole.len() / 2, whole.len() - 1024, 100, 20] {
            std::fs::write(&path, &whole[..keep]).unwrap();
            let message = read_cloud(&path).unwrap_err().to_string();
            assert!(message.contains("a.e57: found an E57 file that cannot be decoded"), "{message}");
        }
    }
}
