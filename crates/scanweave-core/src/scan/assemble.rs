//! From decoded rows to a [`PointCloud`]: one place for what every format shares.
//!
//! Rows with a non-finite coordinate are dropped and counted; coordinates too
//! large for single precision are moved to a rounded origin first.

use super::PointCloud;
use crate::geometry::{Direction, Point};
use nalgebra::Vector3;

/// Coordinates of so many spreads of the points lose detail in single precision: 24 bits resolve a
/// millionth of the spread at ten of them, and less from there.
const LARGE_IN_SPREADS: f64 = 10.0;
/// Rows looked at to choose the origin.
const ORIGIN_SAMPLES: usize = 1001;

/// What a file holds of every row beside its coordinates, read on demand.
#[derive(Default)]
pub(crate) struct Attributes<'a> {
    /// sRGB.
    pub rgb: Option<&'a dyn Fn(usize) -> [u8; 3]>,
    /// Strength of the return, in the file's own unit.
    pub intensity: Option<&'a dyn Fn(usize) -> f32>,
    /// Normal in the coordinates of the file.
    pub normal: Option<&'a dyn Fn(usize) -> [f32; 3]>,
}

/// Builds a cloud of `rows` rows whose coordinates `xyz_m(i)` and colours `rgb(i)` are read on demand.
///
/// `viewpoint_m` is in file coordinates.
pub(crate) fn assemble(
    rows: usize,
    xyz_m: impl Fn(usize) -> [f64; 3],
    rgb: Option<impl Fn(usize) -> [u8; 3]>,
    viewpoint_m: Option<[f64; 3]>,
) -> PointCloud {
    let rgb = rgb.as_ref().map(|rgb| rgb as &dyn Fn(usize) -> [u8; 3]);
    assemble_with(rows, xyz_m, &Attributes { rgb, ..Attributes::default() }, viewpoint_m)
}

/// [`assemble`] with more than colours.
pub(crate) fn assemble_with(
    rows: usize,
    xyz_m: impl Fn(usize) -> [f64; 3],
    attributes: &Attributes<'_>,
    viewpoint_m: Option<[f64; 3]>,
) -> PointCloud {
    let origin_m = choose_origin(rows, &xyz_m);
    let Attributes { rgb, intensity, normal } = attributes;
    let mut points = Vec::with_capacity(rows);
    let mut colors = rgb.map(|_| Vec::with_capacity(rows));
    let mut intensities = intensity.map(|_| Vec::with_capacity(rows));
    let mut normals = normal.map(|_| Vec::with_capacity(rows));
    for i in 0..rows {
        let [x, y, z] = xyz_m(i);
        let p = Point::new((x - origin_m.x) as f32, (y - origin_m.y) as f32, (z - origin_m.z) as f32);
        // Checked after the cast: a double beyond the range of `f32` becomes infinite there.
        if p.x.is_finite() && p.y.is_finite() && p.z.is_finite() {
            points.push(p);
            colors.iter_mut().zip(rgb).for_each(|(all, rgb)| all.push(rgb(i)));
            intensities.iter_mut().zip(intensity).for_each(|(all, intensity)| all.push(intensity(i)));
            normals.iter_mut().zip(normal).for_each(|(all, normal)| all.push(Direction::from(normal(i))));
        }
    }
    let dropped_rows = rows - points.len();
    let mut cloud =
        PointCloud { points, colors, intensities, normals, origin_m, dropped_rows, ..PointCloud::default() };
    if let Some(viewpoint_m) = viewpoint_m {
        cloud.set_viewpoint(viewpoint_m.into());
    }
    cloud
}

/// No colours, spelled so that the type of the closure is known.
pub(crate) const NO_COLORS: Option<fn(usize) -> [u8; 3]> = None;

/// Zero, or for each axis whose median over evenly spread rows is large beside the spread of the rows,
/// that median rounded to a power of ten, so that it reads well in a report.
///
/// The median, not the first row or the mean: one wild row must not move the cloud.
pub(crate) fn choose_origin(rows: usize, xyz_m: &impl Fn(usize) -> [f64; 3]) -> Vector3<f64> {
    let step = rows.div_ceil(ORIGIN_SAMPLES).max(1);
    let sample: Vec<[f64; 3]> =
        (0..rows).step_by(step).map(xyz_m).filter(|p| p.iter().all(|c| c.is_finite())).collect();
    let median = |mut values: Vec<f64>| {
        let middle = values.len() / 2;
        if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
    };
    let middle = [0, 1, 2].map(|axis| median(sample.iter().map(|p| p[axis]).collect()));
    let away = |p: &[f64; 3]| (Vector3::from(*p) - Vector3::from(middle)).amax();
    let spread = median(sample.iter().map(away).collect());
    let step = 10f64.powf((LARGE_IN_SPREADS * spread).log10().ceil());
    // At the ends of double precision a multiple of the step may have no number.
    let rounded = |m: f64| Some((m / step).round() * step).filter(|r| r.is_finite()).unwrap_or(m);
    middle.map(|m| if m.abs() > step && step > 0.0 { rounded(m) } else { 0.0 }).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn georeferenced_coordinates_keep_millimetres() {
        // UTM-like; f32 alone resolves 0.5 m at 5.8e6.
        let rows = [[431_250.123, 5_812_345.678, 101.5], [431_251.124, 5_812_346.679, 102.0]];
        let cloud = assemble(2, |i| rows[i], NO_COLORS, Some([431_250.0, 5_812_345.0, 100.0]));
        assert_eq!(cloud.origin_m, Vector3::new(431_300.0, 5_812_300.0, 100.0));
        for (p, row) in cloud.points.iter().zip(rows) {
            let back = p.coords.cast::<f64>() + cloud.origin_m;
            // f32 spacing below 128 m is 7.6e-6 m.
            assert!((back - Vector3::from(row)).amax() < 1e-5, "{back:?}");
        }
        assert!((cloud.viewpoint.unwrap() - Point::new(-50.0, 45.0, 0.0)).norm() < 1e-4);
    }

    #[test]
    fn an_origin_and_a_viewpoint_are_finite_whatever_the_rows_are() {
        // The spread is a number of its own kind beside 1, and the multiple of 10^308 above 1.7e308 is none.
        for rows in [[[1.0, 0.0, 0.0], [1.0, 1e-320, 0.0]], [[1.7e308, 0.0, 0.0], [1.7e308, 5e306, 0.0]]] {
            let cloud = assemble(2, |i| rows[i], NO_COLORS, Some([0.0; 3]));
            assert_eq!(cloud.origin_m, Vector3::new(rows[0][0], 0.0, 0.0));
            // Beyond single precision nothing is known of the sensor.
            assert_eq!(cloud.viewpoint.is_some(), rows[0][0] == 1.0);
        }
        assert_eq!(assemble(1, |_| [1.0; 3], NO_COLORS, Some([1e300, 0.0, 0.0])).viewpoint, None);
        assert_eq!(assemble(1, |_| [1.0; 3], NO_COLORS, Some([f64::NAN, 0.0, 0.0])).viewpoint, None);
    }

    #[test]
    fn a_wild_row_does_not_move_the_cloud_and_non_finite_rows_are_counted() {
        let rows = [
            [1e30, 0.0, 0.0],
            [1.0, 2.0, 3.0],
            [f64::NAN, 0.0, 0.0],
            [4.0, 5.0, 6.0],
            [1e300, 0.0, 0.0],
            [7.0, 8.0, 9.0],
        ];
        let cloud = assemble(6, |i| rows[i], Some(|i: usize| [i as u8; 3]), None);
        assert_eq!(cloud.origin_m, Vector3::zeros());
        let kept = [[1e30, 0.0, 0.0], [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]];
        assert_eq!(cloud.points, kept.map(Point::from));
        assert_eq!(cloud.colors, Some(vec![[0; 3], [1; 3], [3; 3], [5; 3]]));
        assert_eq!(cloud.dropped_rows, 2);
    }
}
