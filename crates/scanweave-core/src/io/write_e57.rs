//! Writing scans with their poses as one E57 file.

use super::blocks::{PointBlocks, Summary, coordinates_m, unwrapped, wrapped};
use crate::atomic;
use crate::error::{Error, Result};
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
pub struct E57Scan<'a> {
    /// What it is called there.
    pub name: String,
    /// Its pose in the frame that all scans of the file share.
    pub world_from_scan: RigidMotion,
    /// What its header says, in the coordinates that the pose takes to that frame.
    pub summary: Summary,
    /// Its points, in these coordinates.
    pub blocks: Box<dyn PointBlocks + 'a>,
}

/// The extension of the standard for normals.
const NORMALS: (&str, &str) = ("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt");

/// Writes scans one after the other, as `scans` gives them: each keeps its points in its own coordinates,
/// and its pose beside them. A scan whose coordinates are large is written relative to its origin, and its
/// pose takes that in. `identity` is what the file is known by: other content has another.
///
/// # Errors
/// [`Error::Write`], or that of the first scan that is an error.
pub fn write_e57<'a>(
    path: impl AsRef<Path>,
    identity: &str,
    scans: impl Iterator<Item = Result<E57Scan<'a>>>,
) -> Result<()> {
    let path = path.as_ref();
    let written = atomic::write_file(path, |file| {
        let mut writer = E57Writer::new(file, &identifier(identity)).map_err(io::Error::other)?;
        let (namespace, url) = NORMALS;
        writer.register_extension(Extension::new(namespace, url)).map_err(io::Error::other)?;
        for (number, scan) in scans.enumerate() {
            let mut scan = scan.map_err(wrapped)?;
            add(path, &mut writer, &format!("{identity} {number}"), &mut scan).map_err(wrapped)?;
        }
        writer.finalize().map_err(io::Error::other)
    });
    written.map_err(unwrapped)
}

fn add(path: &Path, file: &mut E57Writer<&File>, identity: &str, scan: &mut E57Scan<'_>) -> Result<()> {
    let refused = |e: e57::Error| Error::write(path, io::Error::other(e));
    let summary = &scan.summary;
    let mut records = vec![Record::CARTESIAN_X_F32, Record::CARTESIAN_Y_F32, Record::CARTESIAN_Z_F32];
    if summary.colors {
        records.extend([Record::COLOR_RED_U8, Record::COLOR_GREEN_U8, Record::COLOR_BLUE_U8]);
    }
    let single = |name: RecordName| Record { name, data_type: RecordDataType::F32 };
    if summary.intensities {
        records.push(single(RecordName::Intensity));
    }
    if summary.normals {
        let named =
            |name: &str| RecordName::Unknown { namespace: NORMALS.0.to_owned(), name: name.to_owned() };
        records.extend(["normalX", "normalY", "normalZ"].map(|name| single(named(name))));
    }
    let mut writer = file.add_pointcloud(&identifier(identity), records).map_err(refused)?;
    writer.set_name(Some(scan.name.clone()));
    let origin = summary.origin_m;
    let scan_from_points = RigidMotion::translation(origin.x, origin.y, origin.z);
    writer.set_transform(Some(transform(&(scan.world_from_scan * scan_from_points))));
    writer.set_intensity_limits(limits(summary));
    scan.blocks.for_each(&mut |block| add_points(&mut writer, &block, summary).map_err(refused))?;
    writer.finalize().map_err(refused)
}

fn add_points(
    writer: &mut PointCloudWriter<'_, &File>,
    block: &PointCloud,
    summary: &Summary,
) -> e57::Result<()> {
    for i in 0..block.len() {
        let position = coordinates_m(block, i) - summary.origin_m;
        let mut values: Vec<RecordValue> = Vec::with_capacity(10);
        values.extend(position.iter().map(|&c| RecordValue::Single(c as f32)));
        let colors = block.colors.iter().flat_map(|c| c[i]);
        values.extend(colors.map(|c| RecordValue::Integer(i64::from(c))));
        values.extend(block.intensities.iter().map(|v| RecordValue::Single(v[i])));
        let normals = block.normals.iter().flat_map(|n| n[i].iter());
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
fn limits(summary: &Summary) -> Option<IntensityLimits> {
    let [low, high] = summary.intensity_range?;
    Some(IntensityLimits {
        intensity_min: Some(RecordValue::Single(low)),
        intensity_max: Some(RecordValue::Single(high)),
    })
}

/// A globally unique identifier that follows from what something is, so that the same scans give the
/// same bytes.
fn identifier(identity: &str) -> String {
    let hex = blake3::hash(identity.as_bytes()).to_hex();
    format!("{{{}-{}-{}-{}-{}}}", &hex[..8], &hex[8..12], &hex[12..16], &hex[16..20], &hex[20..32])
}
