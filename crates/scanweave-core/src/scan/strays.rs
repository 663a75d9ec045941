//! Points that do not belong to a scan: so far out that one of them would rule every sum.

use super::PointCloud;
use crate::geometry::Point;

/// A stray point is so many times farther from the middle of the scan than half of its points are.
///
/// A pose that brings half of the points to within the inlier radius, some twentieth of their distance from the
/// middle, says nothing about points a hundred times as far out: turning by as much moves these by several
/// times the size of the scan. They cannot be registered with the rest, nor it with them.
pub const STRAY: f64 = 100.0;
/// Points looked at to find the middle and the size.
const SAMPLE: usize = 8192;

impl PointCloud {
    /// Leaves out stray points and counts them in [`stray_points`](PointCloud::stray_points): those more
    /// than [`STRAY`] times as far from the coordinate-wise median as half of the points are. Points at
    /// that very place, as of a sensor's "no reading", say nothing about the size.
    pub fn drop_strays(&mut self) {
        let Some((middle, size_m)) = middle_and_size(&self.points) else { return };
        let limit = STRAY * size_m;
        let belongs = |p: &Point| (p.cast::<f64>() - middle).norm() <= limit;
        let stray = self.points.iter().filter(|p| !belongs(p)).count();
        if stray == 0 {
            return;
        }
        let keep: Vec<bool> = self.points.iter().map(belongs).collect();
        fn kept<T>(all: &mut Vec<T>, keep: &[bool]) {
            let mut keep = keep.iter();
            // One flag a value: lengths agree.
            all.retain(|_| keep.next().copied().unwrap_or(true));
        }
        kept(&mut self.points, &keep);
        self.colors.iter_mut().for_each(|all| kept(all, &keep));
        self.intensities.iter_mut().for_each(|all| kept(all, &keep));
        self.normals.iter_mut().for_each(|all| kept(all, &keep));
        self.stray_points += stray;
    }
}

/// The coordinate-wise median, and the median distance from it of the points elsewhere, metres; `None` where
/// all points are at one place.
pub fn middle_and_size(points: &[Point]) -> Option<(nalgebra::Point3<f64>, f64)> {
    let step = points.len().div_ceil(SAMPLE).max(1);
    let sample: Vec<&Point> = points.iter().step_by(step).collect();
    let middle = [0, 1, 2].map(|axis| lower_median(sample.iter().map(|p| f64::from(p[axis]))));
    let [Some(x), Some(y), Some(z)] = middle else { return None };
    let middle = nalgebra::Point3::new(x, y, z);
    let away = |p: &Point| Some((p.cast::<f64>() - middle).norm()).filter(|d| *d > 0.0);
    let size = lower_median(sample.iter().filter_map(|p| away(p)))
        .or_else(|| lower_median(points.iter().filter_map(away)))?;
    Some((middle, size))
}

fn lower_median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len().checked_sub(1)? / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid of 10 × 10 × 10 points 1 m apart around a place; half of them are within 4.6 m of its middle.
    fn grid(at: [f32; 3]) -> Vec<Point> {
        let point = |i: usize| {
            Point::new(at[0] + (i % 10) as f32, at[1] + (i / 10 % 10) as f32, at[2] + (i / 100) as f32)
        };
        (0..1000).map(point).collect()
    }

    fn without_strays(points: Vec<Point>) -> PointCloud {
        let colors = (0..points.len()).map(|i| [(i % 251) as u8; 3]).collect();
        let mut cloud = PointCloud { points, colors: Some(colors), ..PointCloud::default() };
        cloud.drop_strays();
        cloud
    }

    #[test]
    fn one_ten_and_a_tenth_of_wild_points_are_left_out_and_far_ones_stay() {
        for wild in [1, 10, 111] {
            let mut points = grid([100.0, -50.0, 3.0]);
            let expected = points.clone();
            for k in 0..wild {
                points.insert(7 * k, Point::new(1e10, -1e9 * k as f32, 1e10));
            }
            let cloud = without_strays(points);
            assert_eq!((cloud.points == expected, cloud.stray_points), (true, wild));
            assert_eq!(cloud.colors.unwrap().len(), 1000);
        }
        // A chimney at 300 m belongs to a scan of ten metres; a town a kilometre away does not.
        let chimney = [grid([0.0; 3]), vec![Point::new(300.0, 0.0, 0.0); 9]].concat();
        assert_eq!(without_strays(chimney).stray_points, 0);
        let town = [grid([0.0; 3]), grid([1000.0, 0.0, 0.0])[..400].to_vec()].concat();
        assert_eq!(without_strays(town).points, grid([0.0; 3]));
    }

    #[test]
    fn places_that_repeat_are_no_size_and_every_attribute_follows_its_point() {
        // More than half of the rows are at zero, a sensor's "no reading".
        let mut points = grid([1.0; 3]);
        points.extend(vec![Point::origin(); 1500]);
        assert_eq!(without_strays(points.clone()).points, points);
        assert_eq!(without_strays(vec![Point::new(1.0, 2.0, 3.0); 5]).points.len(), 5);
        assert_eq!(without_strays(Vec::new()).points.len(), 0);

        let mut cloud = PointCloud {
            points: [vec![Point::new(1e20, 0.0, 0.0)], grid([0.0; 3])].concat(),
            intensities: Some((0..1001).map(|i| i as f32).collect()),
            normals: Some(vec![crate::geometry::Direction::z(); 1001]),
            ..PointCloud::default()
        };
        cloud.drop_strays();
        assert_eq!(cloud.intensities.unwrap()[0], 1.0);
        assert_eq!((cloud.normals.unwrap().len(), cloud.colors), (1000, None));
    }
}
