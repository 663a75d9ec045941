//! What the VIEWPOINT of a PCD file stands for.
//!
//! By the format it is the pose of the sensor. Some writers (CloudCompare) store the points in the
//! sensor's own frame, so that the pose takes them to the world. Others (the Point Cloud Library) store
//! them in the world already, and only the translation tells something: where the sensor stood. The
//! file does not say which; where the points lie does.

use super::pcd_header::Sensor;
use crate::geometry::{Point, RigidMotion};
use crate::scan::PointCloud;
use nalgebra::Vector3;

/// Points looked at to find the box in which they lie.
const SAMPLES: usize = 1000;
/// The share of points left out on each side of the box, so that single wild points do not stretch it.
const TAIL: f64 = 0.01;
/// A sensor further away than this many extents of what it saw is not plausible: a scanner of 100 m reach
/// and a thing of 10 m, seen alone.
const FURTHEST_IN_EXTENTS: f64 = 10.0;

/// Puts the sensor into the cloud, and returns the pose where the points lie in the sensor's frame.
///
/// The sensor stands at the translation if the points are in the world, and at zero if they are in its
/// frame. A place is near when it is no further from the points than they are from each other.
/// - The translation is near: the points are taken as the world's, as where both are near.
/// - Else the place that is nearer to the points.
/// - None of the two where it lies more than ten extents away.
pub(super) fn place_sensor(sensor: &Sensor, cloud: &mut PointCloud) -> Option<RigidMotion> {
    let bounds = Bounds::of(cloud)?;
    let translation = Vector3::from(sensor.translation);
    let (from_translation, from_zero) =
        (bounds.extents_to(&translation), bounds.extents_to(&Vector3::zeros()));
    let pose = sensor.pose.filter(|_| from_translation > 1.0 && from_zero < from_translation);
    let (stands, away) = match pose {
        Some(_) => (Vector3::zeros(), from_zero),
        None => (translation, from_translation),
    };
    if away > FURTHEST_IN_EXTENTS {
        return None;
    }
    cloud.set_viewpoint(stands);
    pose
}

/// The box in which nearly all points lie, in the coordinates of the file.
struct Bounds {
    low: Vector3<f64>,
    high: Vector3<f64>,
}

impl Bounds {
    fn of(cloud: &PointCloud) -> Option<Self> {
        let step = cloud.len().div_ceil(SAMPLES).max(1);
        let sample: Vec<&Point> = cloud.points.iter().step_by(step).collect();
        let last = sample.len().checked_sub(1)?;
        let tail = (last as f64 * TAIL).round() as usize;
        let sides = [0, 1, 2].map(|axis| {
            let mut values: Vec<f64> = sample.iter().map(|p| f64::from(p[axis])).collect();
            values.sort_unstable_by(f64::total_cmp);
            [values[tail], values[last - tail]]
        });
        let side = |end: usize| Vector3::from(sides.map(|s| s[end])) + cloud.origin_m;
        Some(Self { low: side(0), high: side(1) })
    }

    /// Distance of `place` from the box in diagonals of it. Infinite from a box without extent.
    fn extents_to(&self, place: &Vector3<f64>) -> f64 {
        let outside = (self.low - place).sup(&(place - self.high)).sup(&Vector3::zeros());
        let away = outside.norm() / (self.high - self.low).norm();
        if away.is_nan() { 0.0 } else { away }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    /// A sphere of 5 m with its centre at `center`, seen from within: 1000 points on a spiral.
    fn sphere(center: [f64; 3]) -> Vec<Vector3<f64>> {
        let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
        (0..1000)
            .map(|i| {
                let z = 1.0 - (2.0 * f64::from(i) + 1.0) / 1000.0;
                let (around, radius) = (golden * f64::from(i), (1.0 - z * z).sqrt());
                Vector3::from(center) + 5.0 * Vector3::new(radius * around.cos(), radius * around.sin(), z)
            })
            .collect()
    }

    fn placed(points: &[Vector3<f64>], translation: [f64; 3], rotated: bool) -> (Option<[f32; 3]>, bool) {
        let rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, 1.0);
        let pose = RigidMotion::from_parts(Translation3::from(translation), rotation);
        let sensor = Sensor { translation, pose: rotated.then_some(pose) };
        let mut cloud =
            PointCloud::from_points(points.iter().map(|p| Point::from(p.cast::<f32>())).collect());
        let stated = place_sensor(&sensor, &mut cloud);
        assert!(stated.is_none_or(|p| p == pose));
        (cloud.viewpoint.map(|v| v.coords.into()), stated.is_some())
    }

    #[test]
    fn points_around_zero_have_the_pose_and_points_around_the_translation_the_viewpoint() {
        let far = [104.0, 52.9, 1.5];
        assert_eq!(placed(&sphere([0.0; 3]), far, true), (Some([0.0; 3]), true));
        assert_eq!(placed(&sphere(far), far, true), (Some([104.0, 52.9, 1.5]), false));
        // Within the sphere: both are near.
        assert_eq!(placed(&sphere([0.0; 3]), [1.8, 1.2, 1.4], true), (Some([1.8, 1.2, 1.4]), false));
    }

    #[test]
    fn the_border_of_what_is_near_is_the_diagonal_of_the_box() {
        // The box is [-5, 5]³ less what its tails leave out (the outer 1% of a sphere's height: 0.1 m).
        let diagonal = 9.8 * 3f64.sqrt();
        let at = |extents: f64| [4.9 + extents * diagonal, 0.0, 0.0];
        assert!(!placed(&sphere([0.0; 3]), at(0.95), true).1);
        assert!(placed(&sphere([0.0; 3]), at(1.05), true).1);
        // Without a rotation there is no pose; the translation holds up to ten extents.
        assert!(placed(&sphere([0.0; 3]), at(9.5), false).0.is_some());
        assert_eq!(placed(&sphere([0.0; 3]), at(10.5), false), (None, false));
    }

    #[test]
    fn neither_is_taken_far_from_the_points_and_wild_points_do_not_count() {
        let georeferenced = sphere([431_000.0, 5_812_000.0, 100.0]);
        assert_eq!(placed(&georeferenced, [1.8, 1.2, 1.4], true), (None, false));
        let mut wild = sphere([0.0; 3]);
        wild.push(Vector3::new(1e6, 1e6, 1e6));
        assert!(placed(&wild, [104.0, 52.9, 1.5], true).1);
        assert_eq!(placed(&[], [1.0, 2.0, 3.0], true), (None, false));
        assert_eq!(placed(&[Vector3::new(1.0, 0.0, 0.0)], [9.0, 0.0, 0.0], true), (None, false));
    }
}
