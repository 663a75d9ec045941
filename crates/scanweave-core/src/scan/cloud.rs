//! Scans as they come from files.

use super::assemble::{NO_COLORS, assemble};
use crate::error::{Error, Result};
use crate::geometry::{Direction, Point, RigidMotion};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Index of a scan in the naturally sorted input.
///
/// It is a label: no stage may read meaning into its order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
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
    /// Strength of the return of every point, in the file's own unit, where the file has it and it was
    /// asked for ([`ReadOptions::attributes`](crate::io::ReadOptions::attributes)).
    pub intensities: Option<Vec<f32>>,
    /// Normal of every point in the coordinates of the file, where the file has it and it was asked for.
    pub normals: Option<Vec<Direction>>,
    /// File coordinates of the cloud's zero point: zero unless the points lie so far from the
    /// file's zero that single precision would lose detail (georeferenced scans).
    pub origin_m: Vector3<f64>,
    /// Where the sensor stood, in the same coordinates as `points`, where the file says so.
    pub viewpoint: Option<Point>,
    /// Rows of the file that were left out because a coordinate was not finite.
    pub dropped_rows: usize,
    /// Points that were left out because they lie too far from the rest
    /// ([`drop_strays`](Self::drop_strays)).
    pub stray_points: usize,
}

impl PointCloud {
    /// A cloud of bare points, seen from nobody knows where.
    pub fn from_points(points: Vec<Point>) -> Self {
        Self { points, ..Self::default() }
    }

    /// Takes coordinates of `points` to those of the file.
    pub fn file_from_points(&self) -> RigidMotion {
        RigidMotion::translation(self.origin_m.x, self.origin_m.y, self.origin_m.z)
    }

    /// Multiplies all lengths, as where a file's unit is not the metre.
    pub(crate) fn scale(&mut self, factor: f64) {
        let scaled = |p: &Point| Point::from((p.coords.cast::<f64>() * factor).cast::<f32>());
        self.points.iter_mut().for_each(|p| *p = scaled(p));
        self.viewpoint.iter_mut().for_each(|p| *p = scaled(p));
        self.origin_m *= factor;
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
#[derive(Debug, Clone, Default)]
pub struct Scan {
    /// Place in the sorted input.
    pub id: ScanId,
    /// Short name, unique in the input (file stem, or `folder/stem` where stems repeat).
    pub name: String,
    /// The file it came from; `None` for scans made in memory.
    pub path: Option<PathBuf>,
    /// Which scan of the file it is, from zero, where the file holds several.
    pub part: Option<usize>,
    /// A rough `world_from_scan`, as the file or the user states it.
    pub initial_pose: Option<RigidMotion>,
    /// Its points.
    pub cloud: PointCloud,
}

impl Scan {
    /// A scan of bare points in a program's own coordinates, metres.
    ///
    /// Points that are not finite, and stray ones, are left out and counted. Coordinates far from zero are kept
    /// relative to a rounded [`PointCloud::origin_m`], so that they lose nothing. Where the sensor
    /// stood is found out as far as the points tell, unless [`with_viewpoint`](Self::with_viewpoint)
    /// says it.
    pub fn from_points(name: impl Into<String>, points: &[[f64; 3]]) -> Self {
        let mut cloud = assemble(points.len(), |i| points[i], NO_COLORS, None);
        cloud.drop_strays();
        Self { name: name.into(), cloud, ..Self::default() }
    }

    /// [`from_points`](Self::from_points) with one sRGB colour a point.
    ///
    /// # Errors
    /// When there are not as many colours as points.
    pub fn from_colored_points(
        name: impl Into<String>,
        points: &[[f64; 3]],
        colors: &[[u8; 3]],
    ) -> Result<Self> {
        let name = name.into();
        if colors.len() != points.len() {
            return Err(Error::input(
                format!("colours of scan {name}"),
                colors.len().to_string(),
                format!("one for each of {} points", points.len()),
                "pass one sRGB triple a point",
            ));
        }
        let mut cloud = assemble(points.len(), |i| points[i], Some(|i: usize| colors[i]), None);
        cloud.drop_strays();
        Ok(Self { name, cloud, ..Self::default() })
    }

    /// The same scan seen from where the sensor stood, in the coordinates of the points, metres.
    pub fn with_viewpoint(mut self, viewpoint_m: [f64; 3]) -> Self {
        let relative = Vector3::from(viewpoint_m) - self.cloud.origin_m;
        self.cloud.viewpoint = Some(Point::from(relative.cast::<f32>()));
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_a_program_keep_millimetres_colours_and_viewpoint() {
        let points =
            [[431_250.123, 5_812_345.678, 101.5], [f64::NAN, 0.0, 0.0], [431_251.0, 5_812_346.0, 102.0]];
        let colors = [[1, 2, 3], [4, 5, 6], [7, 8, 9]];
        let scan = Scan::from_colored_points("a", &points, &colors).unwrap().with_viewpoint([
            431_240.0,
            5_812_340.0,
            103.0,
        ]);
        assert_eq!((scan.cloud.len(), scan.cloud.dropped_rows), (2, 1));
        assert_eq!(scan.cloud.colors, Some(vec![[1, 2, 3], [7, 8, 9]]));
        let back = |p: &Point| p.coords.cast::<f64>() + scan.cloud.origin_m;
        assert!((back(&scan.cloud.points[0]) - Vector3::from(points[0])).amax() < 1e-5);
        assert!(
            (back(&scan.cloud.viewpoint.unwrap()) - Vector3::new(431_240.0, 5_812_340.0, 103.0)).amax()
                < 1e-5
        );
        let error = Scan::from_colored_points("a", &points, &colors[..2]).unwrap_err().to_string();
        assert!(error.contains("colours of scan a: found 2, expected one for each of 3 points"), "{error}");
    }
}
