//! The way a person with a camera takes through a building.

use super::building::{Building, WALK_INSET_M};
use crate::geometry::RigidMotion;
use crate::geometry::motion;
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Way and turn that count as one unit of effort.
const UNIT_M: f64 = 0.6;
const UNIT_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;

#[derive(Debug, Clone, Copy)]
struct Key {
    /// Effort since the start.
    at: f64,
    position: Vector3<f64>,
    yaw: f64,
    pitch: f64,
}

/// A camera path: pose as a function of effort (a step of 0.6 m or a turn of 30° is one unit).
#[derive(Debug, Clone)]
pub(super) struct Walk {
    keys: Vec<Key>,
    /// Phases of the hand's shake.
    phases: [f64; 7],
    sweep_rad: f64,
    start: usize,
}

impl Walk {
    /// Starts in a random room; each room is looked around by about `sweep_deg` a lap.
    pub fn new(building: &Building, sweep_deg: f64, rng: &mut ChaCha8Rng) -> Self {
        let phases = std::array::from_fn(|_| rng.random_range(0.0..TAU));
        let start = rng.random_range(0..building.rooms.len());
        let mut walk = Self { keys: Vec::new(), phases, sweep_rad: sweep_deg.to_radians(), start };
        let yaw = rng.random_range(0.0..TAU);
        walk.push(stand(building, start, yaw, rng), yaw, -0.15);
        walk
    }

    /// Effort of the whole path so far.
    pub fn end(&self) -> f64 {
        self.keys[self.keys.len() - 1].at
    }

    /// One more lap: every room once, depth first, back to the start through the doors.
    pub fn add_lap(&mut self, building: &Building, rng: &mut ChaCha8Rng) {
        let mut seen = vec![false; building.rooms.len()];
        seen[self.start] = true;
        self.sweep(building, self.start, rng);
        // Rooms on the way back to the start, and the door each was entered by.
        let mut trail: Vec<(usize, Option<usize>)> = vec![(self.start, None)];
        while let Some(&(room, entry)) = trail.last() {
            let beyond = |d: usize| building.doors[d].rooms[usize::from(building.doors[d].rooms[0] == room)];
            let open: Vec<usize> =
                building.rooms[room].doors.iter().copied().filter(|&d| !seen[beyond(d)]).collect();
            if open.is_empty() {
                trail.pop();
                if let Some(door) = entry {
                    self.pass(building, door, room, rng);
                }
            } else {
                let door = open[rng.random_range(0..open.len())];
                let next = beyond(door);
                seen[next] = true;
                self.pass(building, door, room, rng);
                self.sweep(building, next, rng);
                trail.push((next, Some(door)));
            }
        }
    }

    /// Camera pose `world_from_camera` at an effort (clamped to the path), with a hand's shake.
    pub fn pose(&self, at: f64) -> RigidMotion {
        let after = self.keys.partition_point(|k| k.at < at).clamp(1, self.keys.len() - 1);
        let (a, b) = (&self.keys[after - 1], &self.keys[after]);
        let f = ((at - a.at) / (b.at - a.at).max(1e-9)).clamp(0.0, 1.0);
        let shake = |k: usize, rate: f64| (rate * at + self.phases[k]).sin();
        let sway = Vector3::new(shake(0, 2.1), shake(1, 2.7), shake(2, 1.3)) * 0.02;
        let position = a.position.lerp(&b.position, f) + sway;
        let yaw = a.yaw + f * (b.yaw - a.yaw) + 0.03 * shake(3, 3.1);
        let pitch = a.pitch + f * (b.pitch - a.pitch) + 0.06 * shake(4, 1.7) + 0.03 * shake(5, 4.3);
        camera_pose(position, yaw, pitch, 0.06 * shake(6, 1.1))
    }

    fn push(&mut self, position: Vector3<f64>, yaw: f64, pitch: f64) {
        let at = self.keys.last().map_or(0.0, |k| {
            let (way, turn) = ((position - k.position).norm() / UNIT_M, (yaw - k.yaw).abs() / UNIT_RAD);
            k.at + way.hypot(turn).max(1e-6)
        });
        self.keys.push(Key { at, position, yaw, pitch });
    }

    /// The yaw next to the current one that looks along `direction`.
    fn yaw_toward(&self, direction: &Vector2<f64>) -> f64 {
        let now = self.keys[self.keys.len() - 1].yaw;
        let turn = (direction.y.atan2(direction.x) - now).rem_euclid(TAU);
        now + if turn > 0.5 * TAU { turn - TAU } else { turn }
    }

    /// Looks around in a room from changing places.
    fn sweep(&mut self, building: &Building, room: usize, rng: &mut ChaCha8Rng) {
        let turn = self.sweep_rad * rng.random_range(0.95..1.1);
        let sign = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let steps = (turn / 40f64.to_radians()).ceil();
        let from = self.keys[self.keys.len() - 1].yaw;
        for k in 1..=steps as usize {
            let yaw = from + sign * turn * k as f64 / steps + rng.random_range(-0.12..0.12);
            let pitch = rng.random_range(-0.45..0.02);
            self.push(stand(building, room, yaw, rng), yaw, pitch);
        }
    }

    /// Walks from `room` through a door, looking ahead, to the free space behind it.
    fn pass(&mut self, building: &Building, door: usize, room: usize, rng: &mut ChaCha8Rng) {
        let d = &building.doors[door];
        let ahead = if d.rooms[0] == room { d.toward } else { -d.toward };
        let reach = WALK_INSET_M + 0.15;
        let mut way = |k: f64| (d.center + ahead * (k * reach)).push(rng.random_range(1.3..1.5));
        let (before, middle, behind) = (way(-1.0), way(0.0), way(1.0));
        let yaw = self.yaw_toward(&ahead);
        self.push(before, yaw, -0.2);
        self.push(middle, yaw, -0.15);
        self.push(behind, yaw, -0.2);
    }
}

/// A place in the room's free space from which there is much to see toward `yaw`: across the middle.
fn stand(building: &Building, room: usize, yaw: f64, rng: &mut ChaCha8Rng) -> Vector3<f64> {
    let room = &building.rooms[room];
    let free = 0.5 * room.size() - Vector2::repeat(WALK_INSET_M + 0.05);
    let back = -Vector2::new(yaw.cos(), yaw.sin()) * rng.random_range(0.3..0.9);
    let aside = Vector2::new(rng.random_range(-0.35..0.35), rng.random_range(-0.35..0.35));
    let off = (back + aside).map(|v: f64| v.clamp(-1.0, 1.0)).component_mul(&free);
    (room.center() + off).push(rng.random_range(1.25..1.6))
}

/// `world_from_camera` of a camera at `position` that looks along `yaw` and `pitch` (up is positive).
fn camera_pose(position: Vector3<f64>, yaw: f64, pitch: f64, roll: f64) -> RigidMotion {
    let forward = Vector3::new(yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), pitch.sin());
    let right = Vector3::new(yaw.sin(), -yaw.cos(), 0.0);
    let axes = Matrix3::from_columns(&[right, forward.cross(&right), forward]);
    let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), roll);
    motion(Rotation3::from_matrix_unchecked(axes) * roll, position)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use rand::SeedableRng;

    #[test]
    fn camera_axes_are_right_down_forward() {
        // Looking along +y from the origin: right is +x, down is −z.
        let pose = camera_pose(Vector3::zeros(), 0.25 * TAU, 0.0, 0.0);
        assert!((pose * Vector3::z() - Vector3::y()).norm() < 1e-12);
        assert!((pose * Vector3::x() - Vector3::x()).norm() < 1e-12);
        assert!((pose * Vector3::y() + Vector3::z()).norm() < 1e-12);
        let up = camera_pose(Vector3::zeros(), 0.3, 0.2, 0.0) * Vector3::z();
        assert!((up.z - 0.2f64.sin()).abs() < 1e-12);
    }

    #[test]
    fn the_camera_never_enters_a_solid_and_visits_every_room() {
        for seed in 0..8 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let building = super::super::building::build(5, &mut rng);
            let mut walk = Walk::new(&building, 300.0, &mut rng);
            walk.add_lap(&building, &mut rng);
            walk.add_lap(&building, &mut rng);
            let mut visited = [false; 5];
            let steps = (walk.end() * 10.0) as usize;
            for k in 0..=steps {
                let eye = Point3::from(walk.pose(0.1 * k as f64).translation.vector);
                let nearest =
                    building.solids.iter().map(|s| s.signed_distance(&eye)).fold(f64::INFINITY, f64::min);
                assert!(nearest > 0.03, "seed {seed}: {nearest} m from a solid at {eye}");
                for (i, r) in building.rooms.iter().enumerate() {
                    let p = eye.xy().coords;
                    visited[i] |= p.x > r.low.x && p.y > r.low.y && p.x < r.high.x && p.y < r.high.y;
                }
            }
            assert_eq!(visited, [true; 5], "seed {seed}");
        }
    }
}
