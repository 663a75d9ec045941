//! Normals of a scan of an E57 file, which an extension of the standard has beside its points.

use super::damaged;
use crate::error::Result;
use ::e57::{E57Reader, RecordDataType, RecordName};
use std::io::{Read, Seek};
use std::path::Path;

/// What the extension calls the three coordinates (`nor`, <http://www.libe57.org/E57_NOR_surface_normals.txt>).
const NAMES: [&str; 3] = ["normalX", "normalY", "normalZ"];

/// Where a record holds a normal, and how its coordinates are stored.
pub(super) struct Columns([(usize, RecordDataType); 3]);

/// Normals of the points, one after the other, those of invalid ones among them.
pub(super) type Rows<'a> = Box<dyn Iterator<Item = Result<[f32; 3]>> + 'a>;

impl Columns {
    /// Those of a scan that has normals.
    pub(super) fn of(scan: &::e57::PointCloud) -> Option<Self> {
        let column = |wanted: &str| {
            let named =
                |name: &RecordName| matches!(name, RecordName::Unknown { name, .. } if name == wanted);
            let at = scan.prototype.iter().position(|record| named(&record.name))?;
            Some((at, scan.prototype[at].data_type.clone()))
        };
        let [x, y, z] = NAMES.map(column);
        Some(Self([x?, y?, z?]))
    }

    /// The normals of all records, decoded as they are asked for.
    pub(super) fn rows<'a, R: Read + Seek>(
        self,
        path: &'a Path,
        reader: &'a mut E57Reader<R>,
        scan: &::e57::PointCloud,
    ) -> Result<Rows<'a>> {
        let records = reader.pointcloud_raw(scan).map_err(|e| damaged(path, &e))?;
        // A packet without a whole point: the next call reads the next one.
        let whole = records.filter(|record| !matches!(record, Err(::e57::Error::Internal { .. })));
        Ok(Box::new(whole.map(move |record| {
            let record = record.map_err(|e| damaged(path, &e))?;
            let mut normal = [0.0; 3];
            for (coordinate, (at, data_type)) in normal.iter_mut().zip(&self.0) {
                *coordinate = record[*at].to_f64(data_type).map_err(|e| damaged(path, &e))? as f32;
            }
            Ok(normal)
        })))
    }
}
