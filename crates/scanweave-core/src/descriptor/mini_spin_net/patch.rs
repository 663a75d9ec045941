//! Points around a keypoint, turned into the keypoint's own frame.

use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::spread::Spread;
use crate::geometry::{Direction, Point};
use nalgebra::{Matrix3, Vector3};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Points of a patch, at most.
pub const MOST_POINTS: usize = 512;
/// Radius of the points that fix the axis, in patch radii: 0.15 m of 0.3 m.
const AXIS_SHARE: f32 = 0.5;
/// Stream of the seed for the order of points.
const ORDER_STREAM: u64 = 0x7061_7463;
/// A coordinate that is near no cell.
const NOWHERE: f32 = 1e9;

/// Points around a keypoint: the axis is z, the radius 1.
#[derive(Debug, Clone)]
pub struct Patch {
    /// Coordinates; beyond `count` they are far outside.
    pub x: [f32; MOST_POINTS],
    /// As `x`.
    pub y: [f32; MOST_POINTS],
    /// As `x`.
    pub z: [f32; MOST_POINTS],
    /// Number of points.
    pub count: usize,
}

impl Default for Patch {
    fn default() -> Self {
        let nowhere = [NOWHERE; MOST_POINTS];
        Self { x: nowhere, y: nowhere, z: nowhere, count: 0 }
    }
}

impl Patch {
    /// Replaces the points; those beyond `MOST_POINTS` are left out.
    pub fn fill(&mut self, points: impl IntoIterator<Item = [f32; 3]>) {
        self.count = 0;
        for [x, y, z] in points.into_iter().take(MOST_POINTS) {
            (self.x[self.count], self.y[self.count], self.z[self.count]) = (x, y, z);
            self.count += 1;
        }
        // A block of lanes may reach beyond the last point.
        for coordinates in [&mut self.x, &mut self.y, &mut self.z] {
            coordinates[self.count..].fill(NOWHERE);
        }
    }
}

/// The points of a scan in the order in which patches take them: at random, so that a patch of
/// more points than it holds is thinned evenly, and a cell sees no preferred side.
pub fn in_patch_order(points: &[Point], seed: u64) -> Vec<Point> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(ORDER_STREAM);
    let mut ordered = points.to_vec();
    ordered.shuffle(&mut rng);
    ordered
}

/// What finds the points around a keypoint.
pub struct PatchSource<'a> {
    grid: RadiusGrid<'a>,
    viewpoint: Point,
}

impl<'a> PatchSource<'a> {
    /// Patches of `radius_m` from points [`in_patch_order`], seen from `viewpoint`.
    pub fn new(points: &'a [Point], viewpoint: Point, radius_m: f32) -> Self {
        Self { grid: RadiusGrid::new(points, radius_m), viewpoint }
    }

    /// Fills `patch` with the surroundings of `keypoint`; `false`, and `patch` is of no use, when
    /// they fix no axis. `nearby` is a buffer.
    pub fn gather(&self, keypoint: &Point, nearby: &mut Vec<u32>, patch: &mut Patch) -> bool {
        let radius_m = self.grid.radius_m();
        let axis_square = (AXIS_SHARE * radius_m).powi(2);
        nearby.clear();
        let mut spread = Spread::default();
        self.grid.for_each_within(keypoint, |i, square| {
            nearby.push(i as u32);
            if square <= axis_square {
                spread.add((self.grid.points()[i] - keypoint).cast());
            }
        });
        let Some(axis) = spread.least_direction() else { return false };
        let axis = if (self.viewpoint - keypoint).dot(&axis) < 0.0 { -axis } else { axis };
        let turn = onto_z(&axis);
        nearby.sort_unstable();
        patch.fill(nearby.iter().map(|&i| {
            let p = turn * ((self.grid.points()[i as usize] - keypoint) / radius_m);
            [p.x, p.y, p.z]
        }));
        true
    }
}

/// The shortest rotation that takes a unit vector to the z axis: I + K + K²/(1 + cos) with K the
/// cross product matrix of axis × z (Rodrigues).
fn onto_z(axis: &Direction) -> Matrix3<f32> {
    let cos = axis.z;
    // Opposite vectors have no shortest rotation: half a turn about x is as good as any.
    if cos < -0.999_999 {
        return Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    }
    let k = axis.cross(&Vector3::z()).cross_matrix();
    Matrix3::identity() + k + k * k / (1.0 + cos)
}
