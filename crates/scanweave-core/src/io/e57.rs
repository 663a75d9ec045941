//! E57 (terrestrial laser scans).

use super::scan_file::{Note, ReadOptions, ScanFile, StoredScan};
use super::scanner::{drop_implausible_viewpoint, drop_poses_that_say_nothing};
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::scan::assemble::{Attributes, assemble_with};
use ::e57::{CartesianCoordinate, E57Reader, RecordDataType};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use std::io::{Read, Seek};
use std::path::Path;

/// Reads every scan of an E57 file in its own coordinates, with the pose that the file states for it.
///
/// The standard puts the sensor at the zero of a scan, which is the viewpoint where the scan has a pose or
/// spherical coordinates. Many exports have points in the coordinates of the file all the same: a zero far
/// from the points is no viewpoint. Points that are marked as invalid are dropped and counted.
///
/// # Errors
/// [`Error::File`] for a damaged file, and for one without a scan.
pub(super) fn read(path: &Path, file: impl Read + Seek, options: &ReadOptions) -> Result<ScanFile> {
    let mut reader = E57Reader::new(file).map_err(|e| damaged(path, &e))?;
    let stored = reader.pointclouds();
    if stored.is_empty() {
        let remedy = "export it with its point clouds";
        return Err(Error::file(path, "an E57 file without a scan", "at least one scan", remedy));
    }
    let mut read = ScanFile::default();
    let (mut strange_pose, mut far) = (false, false);
    for (index, scan) in stored.iter().enumerate() {
        check(path, index, scan)?;
        let mut cloud = points(path, &mut reader, scan, options)?;
        far |= drop_implausible_viewpoint(&mut cloud);
        let pose = scan.transform.as_ref().map(motion);
        strange_pose |= matches!(pose, Some(None));
        read.scans.push(StoredScan { cloud, pose: pose.flatten() });
    }
    drop_poses_that_say_nothing(&mut read.scans);
    if strange_pose {
        read.notes.push(Note::warning("a scan states a pose that is no rigid motion; it is not used"));
    }
    if far {
        let text = "the zero of a scan, where its sensor should have stood, is far from its points; \
                    the place of the sensor is taken as unknown";
        read.notes.push(Note::warning(text));
    }
    Ok(read)
}

fn damaged(path: &Path, why: &dyn std::fmt::Display) -> Error {
    let found = format!("an E57 file that cannot be decoded ({why})");
    let expected = "E57 1.0 with cartesian or spherical coordinates";
    Error::file(path, found, expected, "copy or export the file again")
}

/// Refuses a scan without coordinates, and one whose decoder would not end.
fn check(path: &Path, index: usize, scan: &::e57::PointCloud) -> Result<()> {
    if !(scan.has_cartesian() || scan.has_spherical()) {
        return Err(damaged(path, &format!("scan {} has no coordinates", index + 1)));
    }
    // A value that never changes takes no bytes. Where none does, nothing but the header says how many
    // points there are, and the decoder makes as many values as memory holds.
    let constant = |data_type: &RecordDataType| match data_type {
        RecordDataType::Integer { min, max } | RecordDataType::ScaledInteger { min, max, .. } => min == max,
        RecordDataType::Single { .. } | RecordDataType::Double { .. } => false,
    };
    if scan.records > 0 && scan.prototype.iter().all(|record| constant(&record.data_type)) {
        return Err(damaged(path, &format!("scan {} has points at one place only", index + 1)));
    }
    Ok(())
}

/// `world_from_scan` of a pose; `None` where its numbers are none.
fn motion(pose: &::e57::Transform) -> Option<RigidMotion> {
    let ::e57::Transform { rotation: q, translation: t } = pose;
    let rotation = UnitQuaternion::try_new(Quaternion::new(q.w, q.x, q.y, q.z), 1e-6)?;
    let motion = RigidMotion::from_parts(Translation3::new(t.x, t.y, t.z), rotation);
    motion.to_homogeneous().iter().all(|v| v.is_finite()).then_some(motion)
}

fn points<R: Read + Seek>(
    path: &Path,
    reader: &mut E57Reader<R>,
    scan: &::e57::PointCloud,
    options: &ReadOptions,
) -> Result<crate::scan::PointCloud> {
    let mut points = reader.pointcloud_simple(scan).map_err(|e| damaged(path, &e))?;
    points.apply_pose(false);
    points.intensity_to_color(false);
    points.normalize_intensity(false);
    let mut xyz: Vec<[f64; 3]> = Vec::new();
    let mut colors = scan.has_color().then(Vec::new);
    let mut intensities = (options.attributes && scan.has_intensity()).then(Vec::new);
    let mut invalid = 0;
    for point in points {
        let point = match point {
            // A packet without a whole point, such as one of an index. The next call reads the next packet.
            Err(::e57::Error::Internal { .. }) => continue,
            point => point.map_err(|e| damaged(path, &e))?,
        };
        let CartesianCoordinate::Valid { x, y, z } = point.cartesian else {
            // No return in that direction.
            invalid += 1;
            continue;
        };
        xyz.push([x, y, z]);
        // Normalised to [0, 1] by the reader.
        let byte = |v: f32| (v * 255.0).round() as u8;
        let color = point.color.map_or([0; 3], |c| [byte(c.red), byte(c.green), byte(c.blue)]);
        colors.iter_mut().for_each(|all| all.push(color));
        intensities.iter_mut().for_each(|all| all.push(point.intensity.unwrap_or(0.0)));
    }
    let rgb = colors.as_ref().map(|all| |i: usize| all[i]);
    let intensity = intensities.as_ref().map(|all| |i: usize| all[i]);
    let attributes = Attributes {
        rgb: rgb.as_ref().map(|rgb| rgb as &dyn Fn(usize) -> [u8; 3]),
        intensity: intensity.as_ref().map(|intensity| intensity as &dyn Fn(usize) -> f32),
        ..Attributes::default()
    };
    let viewpoint = (scan.transform.is_some() || scan.has_spherical()).then_some([0.0; 3]);
    let mut cloud = assemble_with(xyz.len(), |i| xyz[i], &attributes, viewpoint);
    cloud.dropped_rows += invalid;
    Ok(cloud)
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
