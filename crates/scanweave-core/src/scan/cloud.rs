//! Scans as they come from files.

use super::assemble::{Attributes, NO_COLORS, assemble, assemble_with};
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

    /// Puts the sensor at a place in the coordinates of the file; it stays unknown where single precision has
    /// no number for that beside the origin.
    pub(crate) fn set_viewpoint(&mut self, file_m: Vector3<f64>) {
        self.viewpoint = Some(Point::from((file_m - self.origin_m).cast::<f32>())).filter(is_finite);
    }

    /// Multiplies all lengths, as where a file's unit is not the metre. Points that have no number in the new
    /// unit are left out and counted.
    pub(crate) fn scale(&mut self, factor: f64) {
        let scaled = |p: &Point| Point::from((p.coords.cast::<f64>() * factor).cast::<f32>());
        self.points.iter_mut().for_each(|p| *p = scaled(p));
        self.viewpoint = self.viewpoint.as_ref().map(scaled).filter(is_finite);
        self.origin_m *= factor;
        if !self.origin_m.iter().all(|v| v.is_finite()) {
            let dropped_rows = self.dropped_rows + self.len();
            *self = Self { dropped_rows, stray_points: self.stray_points, ..Self::default() };
        } else if !self.points.iter().all(is_finite) {
            self.keep_finite();
        }
    }

    fn keep_finite(&mut self) {
        let keep: Vec<bool> = self.points.iter().map(is_finite).collect();
        fn retain<T>(all: &mut Vec<T>, keep: &[bool]) {
            let mut keep = keep.iter();
            all.retain(|_| keep.next().is_some_and(|keep| *keep));
        }
        self.dropped_rows += keep.iter().filter(|keep| !**keep).count();
        retain(&mut self.points, &keep);
        self.colors.iter_mut().for_each(|all| retain(all, &keep));
        self.intensities.iter_mut().for_each(|all| retain(all, &keep));
        self.normals.iter_mut().for_each(|all| retain(all, &keep));
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

fn is_finite(point: &Point) -> bool {
    point.coords.iter().all(|v| v.is_finite())
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

    /// [`from_points`](Self::from_points) of `rows` points that are read on demand, wherever and in whatever
    /// precision a program keeps them; with them, where they are known, an sRGB colour and a normal a point.
    /// Normals are kept with the scan; a registration estimates its own.
    pub fn from_rows(
        name: impl Into<String>,
        rows: usize,
        xyz_m: impl Fn(usize) -> [f64; 3],
        rgb: Option<&dyn Fn(usize) -> [u8; 3]>,
        normal: Option<&dyn Fn(usize) -> [f32; 3]>,
    ) -> Self {
        let mut cloud = assemble_with(rows, xyz_m, &Attributes { rgb, normal, intensity: None }, None);
        cloud.drop_strays();
        Self { name: name.into(), cloud, ..Self::default() }
    }

    /// The same scan seen from where the sensor stood, in the coordinates of the points, metres.
    pub fn with_viewpoint(mut self, viewpoint_m: [f64; 3]) -> Self {
        self.cloud.set_viewpoint(viewpoint_m.into());
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_number_in_another_unit_is_left_out() {
        let cloud = PointCloud {
            colors: Some(vec![[1; 3], [2; 3], [3; 3]]),
            viewpoint: Some(Point::new(1e37, 0.0, 0.0)),
            dropped_rows: 2,
            ..PointCloud::from_points([1.0, 1e36, 2.0].map(|x| Point::new(x, 0.0, 0.0)).to_vec())
        };
        let scaled = |cloud: &PointCloud| {
            let mut scaled = cloud.clone();
            scaled.scale(1e3);
            scaled
        };
        let kept = scaled(&cloud);
        assert_eq!(kept.points, [1e3, 2e3].map(|x| Point::new(x, 0.0, 0.0)));
        assert_eq!((kept.colors, kept.viewpoint, kept.dropped_rows), (Some(vec![[1; 3], [3; 3]]), None, 3));
        let far = scaled(&PointCloud { origin_m: Vector3::new(1e306, 0.0, 0.0), ..cloud });
        assert_eq!((far.len(), far.origin_m, far.dropped_rows), (0, Vector3::zeros(), 5));
    }

    #[test]
    fn rows_are_the_points_and_what_is_known_of_each_stays_with_it() {
        let points = [[0.5, 0.0, 0.0], [0.0, f64::INFINITY, 0.0], [0.0, 0.5, 0.25]];
        let normals = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let (rgb, normal) = (|i: usize| [i as u8; 3], |i: usize| normals[i]);
        let scan = Scan::from_rows("a", 3, |i| points[i], Some(&rgb), Some(&normal));
        assert_eq!(scan.cloud.points, Scan::from_points("a", &points).cloud.points);
        assert_eq!((scan.cloud.colors, scan.cloud.dropped_rows), (Some(vec![[0; 3], [2; 3]]), 1));
        assert_eq!(scan.cloud.normals, Some(vec![Direction::x(), Direction::z()]));
    }

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
