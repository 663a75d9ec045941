//! E57 (terrestrial laser scans).

pub(super) mod blocks;
mod normals;

use super::scan_file::{Note, ReadOptions, ScanFile, StoredScan};
use super::scanner::{drop_implausible_viewpoint, drop_poses_that_say_nothing};
use super::unpack_limit::UnpackLimit;
use super::vertices::Vertices;
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::scan::PointCloud;
use ::e57::{CartesianCoordinate, E57Reader, RecordDataType};
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// Bytes of the coordinates of a point, which may be packed to a few bits.
const POINT_BYTES: u64 = 24;

/// Reads every scan of an E57 file in its own coordinates, with the pose that the file states for it.
///
/// The standard puts the sensor at the zero of a scan, which is the viewpoint where the scan has a pose or
/// spherical coordinates. Many exports have points in the coordinates of the file all the same: a zero far
/// from the points is no viewpoint. Points that are marked as invalid are dropped and counted, and so are
/// those at zero (see [`Vertices::without_zeros`]). A scan without points or coordinates beside others is an empty one.
///
/// # Errors
/// [`Error::File`] for a damaged file, and for one without a scan.
pub(super) fn read(path: &Path, mut file: impl Read + Seek, options: &ReadOptions) -> Result<ScanFile> {
    let size = file.seek(SeekFrom::End(0)).and_then(|size| file.rewind().map(|()| size));
    let size = size.map_err(|e| damaged(path, &e))?;
    let mut reader = E57Reader::new(file).map_err(|e| damaged(path, &e))?;
    let stored = reader.pointclouds();
    if stored.is_empty() {
        let remedy = "export it with its point clouds";
        return Err(Error::file(path, "an E57 file without a scan", "at least one scan", remedy));
    }
    if !stored.iter().any(has_coordinates) {
        return Err(damaged(path, &"none of its scans has coordinates"));
    }
    let mut read = ScanFile::default();
    let (mut strange_pose, mut far) = (false, false);
    let limit = UnpackLimit::of_scan(options, size);
    let mut room = limit.bytes();
    for (index, scan) in stored.iter().enumerate() {
        // Without a point there is no packet either, which the decoder takes for damage.
        if scan.records == 0 || !has_coordinates(scan) {
            read.scans.push(StoredScan::default());
            continue;
        }
        check(path, index, scan)?;
        room = room
            .checked_sub(scan.records.saturating_mul(POINT_BYTES))
            .ok_or_else(|| limit.exceeded(path, "points"))?;
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

fn has_coordinates(scan: &::e57::PointCloud) -> bool {
    scan.has_cartesian() || scan.has_spherical()
}

/// Refuses a scan whose decoder would not end.
fn check(path: &Path, index: usize, scan: &::e57::PointCloud) -> Result<()> {
    // A value that never changes takes no bytes. Where none does, nothing but the header says how many
    // points there are, and the decoder makes as many values as memory holds.
    let constant = |data_type: &RecordDataType| match data_type {
        RecordDataType::Integer { min, max } | RecordDataType::ScaledInteger { min, max, .. } => min == max,
        RecordDataType::Single { .. } | RecordDataType::Double { .. } => false,
    };
    if scan.prototype.iter().all(|record| constant(&record.data_type)) {
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
) -> Result<PointCloud> {
    let mut cloud = PointCloud::default();
    let columns = normals::Columns::of(scan).filter(|_| options.attributes);
    let held =
        columns.map(|columns| columns.rows(path, reader, scan)?.collect::<Result<Vec<_>>>()).transpose()?;
    let mut rows = held.map(|rows| -> normals::Rows<'_> { Box::new(rows.into_iter().map(Ok)) });
    let invalid = each_block(path, reader, scan, options, rows.as_mut(), usize::MAX, |all| {
        cloud = all.without_zeros().into_cloud();
        Ok(())
    })?;
    place_sensor(scan, &mut cloud);
    cloud.dropped_rows += invalid;
    Ok(cloud)
}

/// Puts the sensor at the zero of the scan where it has a pose or spherical coordinates.
fn place_sensor(scan: &::e57::PointCloud, cloud: &mut PointCloud) {
    if scan.transform.is_some() || scan.has_spherical() {
        cloud.set_viewpoint(Vector3::zeros());
    }
}

/// Hands the points of a scan to `take`, at most so many at a time, and returns how many are invalid; `normals`
/// are those of all records.
fn each_block<R: Read + Seek>(
    path: &Path,
    reader: &mut E57Reader<R>,
    scan: &::e57::PointCloud,
    options: &ReadOptions,
    mut normals: Option<&mut normals::Rows<'_>>,
    most: usize,
    mut take: impl FnMut(Vertices) -> Result<()>,
) -> Result<usize> {
    let mut points = reader.pointcloud_simple(scan).map_err(|e| damaged(path, &e))?;
    points.apply_pose(false);
    points.intensity_to_color(false);
    points.normalize_intensity(false);
    let has_normals = normals.is_some();
    let empty = || Vertices {
        rgb: scan.has_color().then(Vec::new),
        normal: has_normals.then(Vec::new),
        intensity: (options.attributes && scan.has_intensity()).then(Vec::new),
        ..Vertices::default()
    };
    let mut block = empty();
    let mut invalid = 0;
    for point in points {
        let point = match point {
            // A packet without a whole point, such as one of an index. The next call reads the next packet.
            Err(::e57::Error::Internal { .. }) => continue,
            point => point.map_err(|e| damaged(path, &e))?,
        };
        let normal = normals.as_mut().and_then(|rows| rows.next()).transpose()?;
        let CartesianCoordinate::Valid { x, y, z } = point.cartesian else {
            // No return in that direction.
            invalid += 1;
            continue;
        };
        block.xyz.push([x, y, z]);
        block.normal.iter_mut().for_each(|all| all.push(normal.unwrap_or_default()));
        // Normalised to [0, 1] by the reader.
        let byte = |v: f32| (v * 255.0).round() as u8;
        let color = point.color.map_or([0; 3], |c| [byte(c.red), byte(c.green), byte(c.blue)]);
        block.rgb.iter_mut().for_each(|all| all.push(color));
        block.intensity.iter_mut().for_each(|all| all.push(point.intensity.unwrap_or(0.0)));
        if block.xyz.len() == most {
            take(std::mem::replace(&mut block, empty()))?;
        }
    }
    if !block.xyz.is_empty() {
        take(block)?;
    }
    Ok(invalid)
}

#[cfg(test)]
mod tests;
