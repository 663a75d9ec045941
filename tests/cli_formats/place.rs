//! A room, and what a scanner in it measures: points with known poses.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use scanweave::geometry::RigidMotion;
use scanweave::synthetic::{Primitive, Scene, Shape};

/// Zero of the coordinates in which a surveyor would have the room, metres.
pub const SURVEY: [f64; 3] = [694_386.0, 5_155_487.0, 381.0];

/// What one scan measured.
#[derive(Clone)]
pub struct View {
    /// The truth: takes the coordinates of the file to those of the room.
    pub world_from_file: RigidMotion,
    /// Points in the coordinates of the file, metres.
    pub points: Vec<[f64; 3]>,
}

impl View {
    /// The same measurements in other coordinates.
    pub fn moved(&self, new_from_old: &RigidMotion) -> Self {
        let moved = |p: &[f64; 3]| (new_from_old * Point3::from(*p)).coords.into();
        Self {
            world_from_file: self.world_from_file * new_from_old.inverse(),
            points: self.points.iter().map(moved).collect(),
        }
    }

    /// Rows with three decimals, which end in `rest`.
    pub fn text(&self, separator: &str, rest: &str) -> String {
        let row = |[x, y, z]: &[f64; 3]| format!("{x:.3}{separator}{y:.3}{separator}{z:.3}{rest}\n");
        self.points.iter().map(row).collect()
    }
}

/// Rotation about the vertical, degrees, after tilts about x and y, and translation.
pub fn pose(position: [f64; 3], yaw: f64, tilt: [f64; 2]) -> RigidMotion {
    let [a, b, c] = [tilt[0], tilt[1], yaw].map(f64::to_radians);
    let turn = |axis: Vector3<f64>, angle| UnitQuaternion::new(axis * angle);
    let rotation = turn(Vector3::z(), c) * turn(Vector3::y(), b) * turn(Vector3::x(), a);
    Isometry3::from_parts(Vector3::from(position).into(), rotation)
}

/// A translation.
pub fn shift(by: [f64; 3]) -> RigidMotion {
    RigidMotion::translation(by[0], by[1], by[2])
}

fn block(low: [f64; 3], high: [f64; 3]) -> Primitive {
    let (low, high) = (Vector3::from(low), Vector3::from(high));
    let at = Isometry3::translation((low.x + high.x) / 2.0, (low.y + high.y) / 2.0, (low.z + high.z) / 2.0);
    Primitive::new(Shape::Box { half: (high - low) / 2.0 }, &at, [128; 3])
}

/// Floor, ceiling and walls around `[0, x] × [0, y] × [0, 2.8]`, and solids in it, as corners.
fn enclosed([x, y]: [f64; 2], solids: &[([f64; 3], [f64; 3])]) -> Scene {
    let (z, t) = (2.8, 0.2);
    let mut all = vec![
        block([-t, -t, -t], [x + t, y + t, 0.0]),
        block([-t, -t, z], [x + t, y + t, z + t]),
        block([-t, -t, 0.0], [0.0, y + t, z]),
        block([x, -t, 0.0], [x + t, y + t, z]),
        block([0.0, -t, 0.0], [x, 0.0, z]),
        block([0.0, y, 0.0], [x, y + t, z]),
    ];
    all.extend(solids.iter().map(|(low, high)| block(*low, *high)));
    Scene::new(all)
}

/// A furnished room that looks like itself from no other side.
pub fn room() -> Scene {
    let furniture = [
        ([0.0, 3.6, 0.0], [1.1, 5.0, 2.0]),
        ([2.6, 0.0, 0.0], [4.0, 0.7, 0.9]),
        ([5.1, 1.9, 0.0], [6.0, 3.3, 1.4]),
        ([3.7, 3.4, 0.0], [4.4, 4.1, 0.5]),
        ([0.0, 0.6, 1.7], [0.5, 1.8, 2.8]),
        ([4.2, 4.6, 0.8], [5.2, 5.0, 2.1]),
    ];
    enclosed([6.0, 5.0], &furniture)
}

/// A room that is the same when it is turned by half about its middle `(3, 2)`.
pub fn symmetric_room() -> Scene {
    let furniture = [
        ([0.0, 0.0, 0.0], [1.2, 0.8, 2.0]),
        ([4.8, 3.2, 0.0], [6.0, 4.0, 2.0]),
        ([2.0, 3.4, 0.0], [2.9, 4.0, 0.9]),
        ([3.1, 0.0, 0.0], [4.0, 0.6, 0.9]),
    ];
    enclosed([6.0, 4.0], &furniture)
}

/// What turns [`symmetric_room`] into itself.
pub fn half_turn() -> RigidMotion {
    pose([6.0, 4.0, 0.0], 180.0, [0.0; 2])
}

/// A view all around from a pose, `columns` by `rows`.
pub fn view(scene: &Scene, world_from_file: RigidMotion, [columns, rows]: [usize; 2]) -> View {
    /// Highest ray above and lowest below the horizon, degrees.
    const STEEPEST: f64 = 60.0;
    let origin = Point3::from(world_from_file.translation.vector);
    let mut points = Vec::with_capacity(columns * rows);
    for column in 0..columns {
        for row in 0..rows {
            let azimuth = (column as f64 / columns as f64 * 360.0).to_radians();
            let height = ((row as f64 + 0.5) / rows as f64 * 2.0 - 1.0) * STEEPEST.to_radians();
            let ray = Vector3::new(azimuth.cos() * height.cos(), azimuth.sin() * height.cos(), height.sin());
            let hit = scene.cast(&origin, &(world_from_file.rotation * ray), 20.0).expect("a closed room");
            points.push((ray * hit.t).into());
        }
    }
    View { world_from_file, points }
}

/// Three views of the furnished room, 2560 points each; the scanner is tilted.
pub fn views() -> Vec<View> {
    let tilts = [[4.0, -7.0], [-9.0, 3.0], [6.0, 8.0]];
    let at = [[1.8, 1.5, 1.4], [3.4, 2.4, 1.6], [2.3, 3.1, 1.3]];
    let yaw = [20.0, 145.0, 260.0];
    (0..3).map(|i| view(&room(), pose(at[i], yaw[i], tilts[i]), [80, 32])).collect()
}

/// Three views of a scene from a levelled scanner.
pub fn levelled(scene: &Scene, size: [usize; 2]) -> Vec<View> {
    let at = [[1.8, 1.5, 1.4], [3.4, 2.4, 1.6], [2.3, 2.8, 1.3]];
    let yaw = [20.0, 145.0, 260.0];
    (0..3).map(|i| view(scene, pose(at[i], yaw[i], [0.0; 2]), size)).collect()
}

/// The levelled views in a surveyor's coordinates, as roughly as `rough` says: where each scan is beside
/// where it belongs, in the room.
pub fn surveyed(rough: &[RigidMotion; 3]) -> Vec<View> {
    let to_survey = |(v, rough): (View, &RigidMotion)| v.moved(&(shift(SURVEY) * rough * v.world_from_file));
    levelled(&room(), [80, 32]).into_iter().zip(rough).map(to_survey).collect()
}
