//! Writing scans with their poses as one E57 file.

use crate::atomic;
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::scan::PointCloud;
use e57::{
    E57Writer, Extension, IntensityLimits, PointCloudWriter, Quaternion, Record, RecordDataType, RecordName,
    RecordValue, Transform, Translation,
};
use std::fs::File;
use std::io;
use std::path::Path;

/// A scan on its way into an E57 file.
#[derive(Debug, Clone)]
pub struct E57Scan {
    /// What it is called there.
    pub name: String,
    /// Its pose in the frame that all scans of the file share.
    pub world_from_scan: RigidMotion,
    /// Its points, in the coordinates that the pose takes to that frame.
    pub cloud: PointCloud,
}

/// The extension of the standard for normals.
const NORMALS: (&str, &str) = ("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt");

/// Writes scans one after the other, as `scans` gives them: each keeps its points in its own coordinates,
/// and its pose beside them. A scan whose coordinates are large is written relative to its origin, and its
/// pose takes that in.
///
/// # Errors
/// [`Error::Write`](crate::Error::Write), or that of the first scan that is an error.
pub fn write_e57(path: impl AsRef<Path>, scans: impl Iterator<Item = Result<E57Scan>>) -> Result<()> {
    let path = path.as_ref();
    let mut failed = None;
    let written = atomic::write_file(path, |file| {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let mut writer = E57Writer::new(file, &identifier(&name)).map_err(io::Error::other)?;
        let (namespace, url) = NORMALS;
        writer.register_extension(Extension::new(namespace, url)).map_err(io::Error::other)?;
        for scan in scans {
            match scan {
                Ok(scan) => add(&mut writer, &scan).map_err(io::Error::other)?,
                Err(error) => {
                    failed = Some(error);
                    return Err(io::Error::other("a scan could not be read"));
                }
            }
        }
        writer.finalize().map_err(io::Error::other)
    });
    match failed {
        Some(error) => Err(error),
        None => written,
    }
}

fn add(file: &mut E57Writer<&File>, scan: &E57Scan) -> e57::Result<()> {
    let cloud = &scan.cloud;
    let mut records = vec![Record::CARTESIAN_X_F32, Record::CARTESIAN_Y_F32, Record::CARTESIAN_Z_F32];
    if cloud.colors.is_some() {
        records.extend([Record::COLOR_RED_U8, Record::COLOR_GREEN_U8, Record::COLOR_BLUE_U8]);
    }
    let single = |name: RecordName| Record { name, data_type: RecordDataType::F32 };
    if cloud.intensities.is_some() {
        records.push(single(RecordName::Intensity));
    }
    if cloud.normals.is_some() {
        let named =
            |name: &str| RecordName::Unknown { namespace: NORMALS.0.to_owned(), name: name.to_owned() };
        records.extend(["normalX", "normalY", "normalZ"].map(|name| single(named(name))));
    }
    let mut writer = file.add_pointcloud(&identifier(&scan.name), records)?;
    writer.set_name(Some(scan.name.clone()));
    writer.set_transform(Some(transform(&(scan.world_from_scan * cloud.file_from_points()))));
    writer.set_intensity_limits(limits(cloud));
    add_points(&mut writer, cloud)?;
    writer.finalize()
}

fn add_points(writer: &mut PointCloudWriter<'_, &File>, cloud: &PointCloud) -> e57::Result<()> {
    for (i, p) in cloud.points.iter().enumerate() {
        let mut values: Vec<RecordValue> = p.coords.iter().map(|&c| RecordValue::Single(c)).collect();
        let colors = cloud.colors.iter().flat_map(|c| c[i]);
        values.extend(colors.map(|c| RecordValue::Integer(i64::from(c))));
        values.extend(cloud.intensities.iter().map(|v| RecordValue::Single(v[i])));
        let normals = cloud.normals.iter().flat_map(|n| n[i].iter());
        values.extend(normals.map(|&c| RecordValue::Single(c)));
        writer.add_point(values)?;
    }
    Ok(())
}

fn transform(motion: &RigidMotion) -> Transform {
    let q = motion.rotation;
    let [x, y, z]: [f64; 3] = motion.translation.vector.into();
    Transform {
        rotation: Quaternion { w: q.w, x: q.i, y: q.j, z: q.k },
        translation: Translation { x, y, z },
    }
}

/// The least and the strongest intensity.
fn limits(cloud: &PointCloud) -> Option<IntensityLimits> {
    let values = || cloud.intensities.iter().flatten().copied().filter(|v| v.is_finite());
    let (low, high) = (values().reduce(f32::min)?, values().reduce(f32::max)?);
    Some(IntensityLimits {
        intensity_min: Some(RecordValue::Single(low)),
        intensity_max: Some(RecordValue::Single(high)),
    })
}

/// A globally unique identifier that follows from a name, so that the same scans give the same bytes.
fn identifier(name: &str) -> String {
    let hex = blake3::hash(name.as_bytes()).to_hex();
    format!("{{{}-{}-{}-{}-{}}}", &hex[..8], &hex[8..12], &hex[12..16], &hex[16..20], &hex[20..32])
}
