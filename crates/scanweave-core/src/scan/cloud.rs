//! Scans as they come from files.

use crate::geometry::Point;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Index of a scan in the naturally sorted input.
///
/// It is a label: no stage may read meaning into its order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ScanId(pub usize);

impl std::fmt::Display for ScanId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// Points of one scan in its own frame.
#[derive(Debug, Clone, Default)]
pub struct PointCloud {
    /// Finite points, metres, relative to `origin_m`.
    pub points: Vec<Point>,
    /// One sRGB colour a point, where the file has colours.
    pub colors: Option<Vec<[u8; 3]>>,
    /// File coordinates of the cloud's zero point: zero unless the file uses
    /// coordinates too large for single precision (georeferenced scans).
    pub origin_m: Vector3<f64>,
    /// Where the sensor stood, in the same coordinates as `points`.
    pub viewpoint: Point,
    /// Rows of the file that were left out because a coordinate was not finite.
    pub dropped_rows: usize,
}

impl PointCloud {
    /// A cloud of bare points seen from the origin of its frame.
    pub fn from_points(points: Vec<Point>) -> Self {
        Self { points, viewpoint: Point::origin(), ..Self::default() }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// True when there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

/// One scan: an id, a name for people, and its points.
#[derive(Debug, Clone)]
pub struct Scan {
    /// Place in the sorted input.
    pub id: ScanId,
    /// Short name, unique in the input (file stem, or `folder/stem` where stems repeat).
    pub name: String,
    /// The file it came from; `None` for scans made in memory.
    pub path: Option<PathBuf>,
    /// Its points.
    pub cloud: PointCloud,
}
