//! What the engine keeps of a scan to compare its surface with others': an index, a thin
//! sample, a bounding sphere, and how far it saw in every direction.

mod free_space;
mod intensity_gradient;

pub use free_space::FreeSpace;

use crate::geometry::nearest_map::{NO_POINT, NearestMap};
use crate::geometry::rigid::PointMover;
use crate::geometry::{Direction, MIN_NORMAL_COSINE, Point, RigidMotion};
use crate::registration::config::RegistrationConfig;
use crate::registration::prior::PosePrior;
use crate::scan::Surface;
use std::sync::OnceLock;

/// Reliability of a viewpoint that nothing is known of yet.
pub const UNKNOWN_RELIABILITY: f64 = 0.5;

/// A scan's surface prepared for comparison, all in its own frame.
pub struct ScanModel<'a> {
    /// Points and normals.
    pub surface: &'a Surface,
    /// τ, the radius that surfaces are compared at, metres.
    pub radius_m: f32,
    /// Rows of the surface that are compared: evenly strided among those with a normal.
    pub sample: Vec<u32>,
    /// Centre of the bounding sphere of surface and viewpoint.
    pub centre: Point,
    /// Radius of the bounding sphere, metres.
    pub reach_m: f32,
    /// How far the scan saw.
    pub free_space: FreeSpace,
    /// Viewpoint reliability: how far what it saw to be empty counts, in `[0, 1]`.
    pub viewpoint_reliability: f64,
    /// What is known of its pose before.
    pub prior: PosePrior,
    /// What is near, for radii up to τ.
    fine: NearestMap,
    /// What is near for larger radii; made when first asked for.
    coarse: OnceLock<NearestMap>,
    /// The largest radius that will be asked for, metres.
    widest_m: f32,
    /// How the intensity changes along the surface; made when first asked for.
    gradients: OnceLock<Vec<Direction>>,
}

impl<'a> ScanModel<'a> {
    /// Prepares a surface for comparisons within `radius_m` (τ, metres), of as many points as the
    /// settings say.
    pub fn new(surface: &'a Surface, radius_m: f32, config: &RegistrationConfig) -> Self {
        let widest = config.multiview_icp.widest_radius() as f32;
        Self::with_sizes(surface, radius_m, config.compared_points(), widest * radius_m)
    }

    /// Prepares a surface for comparisons of at most `points` of its points within `radius_m`, and of
    /// places within `widest_m`.
    pub(super) fn with_sizes(surface: &'a Surface, radius_m: f32, points: usize, widest_m: f32) -> Self {
        let usable: Vec<u32> = (0..surface.len() as u32)
            .filter(|&i| surface.normals[i as usize] != Direction::zeros())
            .collect();
        let count = usable.len().min(points);
        let sample = (0..count).map(|k| usable[k * usable.len() / count]).collect();
        let low = surface.points.iter().fold(Point::from([f32::INFINITY; 3]), |c, p| c.inf(p));
        let high = surface.points.iter().fold(Point::from([f32::NEG_INFINITY; 3]), |c, p| c.sup(p));
        let centre = if surface.is_empty() { Point::origin() } else { nalgebra::center(&low, &high) };
        // The space between viewpoint and surface counts too: it was seen to be empty.
        let reach_m = surface.points.iter().chain([&surface.viewpoint]).map(|p| (p - centre).norm());
        let reach_m = if surface.is_empty() { 0.0 } else { reach_m.fold(0.0, f32::max) };
        Self {
            surface,
            radius_m,
            sample,
            centre,
            reach_m,
            free_space: FreeSpace::new(surface),
            viewpoint_reliability: UNKNOWN_RELIABILITY * f64::from(surface.viewpoint_confidence),
            prior: PosePrior::default(),
            fine: NearestMap::new(&surface.points, radius_m),
            coarse: OnceLock::new(),
            widest_m,
            gradients: OnceLock::new(),
        }
    }

    /// Whether two scans show the same side of a surface where their normals have this inner product; any
    /// side where it is not known which is which.
    #[inline]
    pub fn same_side(&self, other: &ScanModel<'_>, cosine: f32) -> bool {
        let known = self.surface.is_oriented() && other.surface.is_oriented();
        (if known { cosine } else { cosine.abs() }) >= MIN_NORMAL_COSINE
    }

    /// Takes in how far other scans bear out that the viewpoint is the sensor's, in `[0, 1]`: its
    /// reliability is that as far as the scan's own shape bears it out.
    pub fn set_borne_out(&mut self, by_others: f64) {
        self.viewpoint_reliability = by_others * f64::from(self.surface.viewpoint_confidence);
    }

    /// Slope of the intensity at every point of the surface, per metre; zero everywhere without colour.
    pub(super) fn gradients(&self) -> &[Direction] {
        self.gradients.get_or_init(|| match self.surface.intensities.is_empty() {
            true => vec![Direction::zeros(); self.surface.len()],
            false => intensity_gradient::gradients(self.surface, self.radius_m),
        })
    }

    /// Whether any of a few points of the other scan's surface lies within τ of this one's.
    pub fn meets(&self, other: &ScanModel<'_>, self_from_other: &RigidMotion) -> bool {
        /// Every n-th of the compared points.
        const STRIDE: usize = 4;
        let mover = PointMover::new(self_from_other);
        let mut points = other.sample.iter().step_by(STRIDE).map(|&i| &other.surface.points[i as usize]);
        points.any(|p| self.near(&mover.point(p), self.radius_m).is_some())
    }

    /// A point of the surface within `radius_m` of a place in the scan's frame, and (up to a voxel of
    /// the map, a third of its radius) the nearest one.
    #[inline]
    pub fn near(&self, place: &Point, radius_m: f32) -> Option<usize> {
        let found = self.map(radius_m).near(place)?;
        ((self.surface.points[found] - place).norm_squared() <= radius_m * radius_m).then_some(found)
    }

    /// [`Self::near`] of every place in the scan's frame, [`NO_POINT`] for `None`.
    pub fn near_each(&self, places: &[Point], radius_m: f32) -> Vec<u32> {
        let mut found = self.map(radius_m).near_each(places);
        let Some(last) = self.surface.len().checked_sub(1) else { return found };
        for (found, place) in found.iter_mut().zip(places) {
            // Of any point: a branch would be guessed wrongly and wait.
            let squared = (self.surface.points[(*found as usize).min(last)] - place).norm_squared();
            *found = if squared <= radius_m * radius_m { *found } else { NO_POINT };
        }
        found
    }

    fn map(&self, radius_m: f32) -> &NearestMap {
        if radius_m <= self.radius_m {
            &self.fine
        } else {
            self.coarse.get_or_init(|| NearestMap::new(&self.surface.points, self.widest_m))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall at x = 3 m, seen from the origin.
    fn wall() -> Surface {
        let points: Vec<Point> = (0..6400)
            .map(|i| Point::new(3.0, (i % 80) as f32 * 0.05 - 2.0, (i / 80) as f32 * 0.05 - 2.0))
            .collect();
        Surface { normals: vec![-Direction::x(); points.len()], points, ..Surface::default() }
    }

    #[test]
    fn what_lies_between_the_viewpoint_and_the_wall_is_in_front_by_that_much() {
        let wall = wall();
        let model = ScanModel::with_sizes(&wall, 0.07, 100, 0.14);
        assert_eq!(model.sample.len(), 100);
        let at = |x: f32, y: f32| model.free_space.in_front_m(&Point::new(x, y, 0.0));
        // A bin is 3° wide: the nearest of its wall points is nearer by at most 3°·tan(0) of it.
        assert!((at(1.0, 0.0).unwrap() - 2.0).abs() < 0.02);
        assert!((at(4.0, 0.0).unwrap() + 1.0).abs() < 0.02);
        // The scan saw nothing behind itself or beside the wall.
        assert_eq!(at(-1.0, 0.0), None);
        assert_eq!(at(0.5, 3.0), None);
        assert!((model.centre - Point::new(3.0, -0.025, -0.025)).norm() < 1e-5);
    }

    #[test]
    fn places_beyond_the_radius_have_no_point_near_whether_asked_one_by_one_or_together() {
        let wall = wall();
        let model = ScanModel::with_sizes(&wall, 0.07, 100, 0.14);
        for radius_m in [0.03f32, 0.07, 0.1, 0.14] {
            // Up to twice the radius in front of a point of the wall: the wall's other points are further.
            let away: Vec<f32> = (0..=40).map(|k| radius_m * k as f32 / 20.0).collect();
            let places: Vec<Point> = away.iter().map(|d| Point::new(3.0 - d, 0.0, 0.0)).collect();
            let found = model.near_each(&places, radius_m);
            for ((place, away), found) in places.iter().zip(away).zip(found) {
                assert_eq!(model.near(place, radius_m).map_or(NO_POINT, |i| i as u32), found);
                // The map may miss none within the radius and the distance tells those beyond it.
                if (away - radius_m).abs() > 1e-4 {
                    assert_eq!(found != NO_POINT, away < radius_m, "{away} of {radius_m}");
                }
            }
        }
        let nothing = Surface::default();
        assert_eq!(
            ScanModel::with_sizes(&nothing, 0.07, 1, 0.14).near_each(&[Point::origin()], 0.07),
            [NO_POINT]
        );
    }

    #[test]
    fn slopes_are_made_once_however_many_tasks_ask_for_them_at_once() {
        use rayon::prelude::*;
        use std::sync::mpsc;
        let mut wall = wall();
        wall.intensities = vec![0.5; wall.len()];
        let (done, waiting) = mpsc::channel();
        // Tasks that wait for each other never end: not joined, so that the test does.
        std::thread::spawn(move || {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(8).build().unwrap();
            for _ in 0..100 {
                let model = ScanModel::with_sizes(&wall, 0.07, 100, 0.14);
                let asked = |k: usize| {
                    // Some threads are still busy with something else when the first asks.
                    std::thread::sleep(std::time::Duration::from_micros(k as u64 * 137 % 1000));
                    assert_eq!(model.gradients().len(), 6400);
                };
                pool.install(|| (0..200).into_par_iter().for_each(asked));
            }
            done.send(()).unwrap();
        });
        waiting.recv_timeout(std::time::Duration::from_secs(100)).expect("tasks do not wait for each other");
    }
}
