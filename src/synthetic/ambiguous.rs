//! Scans of places that look alike from one place to another, and of some that hardly do not: bare
//! corridors, tunnels and rooms, objects that repeat themselves, scans of few points.
//!
//! What a registration makes of them shows whether it knows what it cannot know. Every scene is a
//! handful of boxes or one tube, scanned by rays in random directions from a sensor that states
//! nothing about itself.

use crate::geometry::RigidMotion;
use crate::scan::{Scan, ScanId};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What is scanned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Place {
    /// A straight corridor with nothing in it, longer than any scan sees.
    BareCorridor,
    /// The same with cabinets and door frames at random.
    FurnishedCorridor,
    /// A straight round tunnel with nothing in it.
    BareTunnel,
    /// Sectors of a rectangular room with nothing in it.
    BareRoom,
    /// Sectors of a rectangular room with furniture.
    FurnishedRoom,
    /// Whole views of a furnished room, of three to five hundred points each.
    FewPoints,
    /// A six-sided column, seen from around it.
    SixSidedColumn,
    /// An L-shaped block, seen from around it.
    LopsidedBlock,
}

impl Place {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::BareCorridor,
        Self::FurnishedCorridor,
        Self::BareTunnel,
        Self::BareRoom,
        Self::FurnishedRoom,
        Self::FewPoints,
        Self::SixSidedColumn,
        Self::LopsidedBlock,
    ];

    /// Its name, as recipes spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::BareCorridor => "bare-corridor",
            Self::FurnishedCorridor => "furnished-corridor",
            Self::BareTunnel => "bare-tunnel",
            Self::BareRoom => "bare-room",
            Self::FurnishedRoom => "furnished-room",
            Self::FewPoints => "few-points",
            Self::SixSidedColumn => "six-sided-column",
            Self::LopsidedBlock => "lopsided-block",
        }
    }

    /// Whether its shape tells one pose from another.
    pub fn is_distinct(self) -> bool {
        matches!(self, Self::FurnishedCorridor | Self::FurnishedRoom | Self::FewPoints | Self::LopsidedBlock)
    }
}

/// Scans of one place with their true poses.
#[derive(Debug, Clone)]
pub struct AmbiguousSet {
    /// The scans, in frames of the sensor.
    pub scans: Vec<Scan>,
    /// True `world_from_scan` of each.
    pub world_from_scan: Vec<RigidMotion>,
}

/// What rays meet.
enum Solid {
    /// An axis-aligned box, seen from inside or from outside.
    Box { low: Point3<f64>, high: Point3<f64> },
    /// A round tube along x, seen from inside.
    Tube { radius_m: f64 },
    /// A column with six sides along z, by the distance of its sides from the axis and its half height.
    Column { side_m: f64, half_height_m: f64 },
}

impl Solid {
    /// Distance along a ray to the surface, if it meets it ahead.
    fn meets(&self, from: &Point3<f64>, along: &Vector3<f64>) -> Option<f64> {
        const NEAR: f64 = 1e-6;
        match self {
            Solid::Tube { radius_m } => {
                let (a, b, c) = (
                    along.y.powi(2) + along.z.powi(2),
                    from.y * along.y + from.z * along.z,
                    from.y.powi(2) + from.z.powi(2) - radius_m.powi(2),
                );
                Some((-b + (b * b - a * c).max(0.0).sqrt()) / a).filter(|t| t.is_finite() && *t > NEAR)
            }
            Solid::Box { low, high } => {
                let axes = [0, 1, 2].map(|a| (Vector3::ith(a, 1.0), low[a], high[a]));
                slabs(&axes, from, along)
            }
            Solid::Column { side_m, half_height_m } => {
                let side = |k: usize| {
                    let angle = k as f64 * std::f64::consts::FRAC_PI_3;
                    (Vector3::new(angle.cos(), angle.sin(), 0.0), -side_m, *side_m)
                };
                let axes = [side(0), side(1), side(2), (Vector3::z(), -half_height_m, *half_height_m)];
                slabs(&axes, from, along)
            }
        }
        .filter(|t| *t > NEAR)
    }
}

/// Where a ray enters what lies between pairs of parallel planes, or from inside where it leaves it.
fn slabs(axes: &[(Vector3<f64>, f64, f64)], from: &Point3<f64>, along: &Vector3<f64>) -> Option<f64> {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for (axis, low, high) in axes {
        let (at, speed) = (axis.dot(&from.coords), axis.dot(along));
        let (a, b) = ((low - at) / speed, (high - at) / speed);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    if enter > leave || leave <= 0.0 {
        return None;
    }
    Some(if enter > 0.0 { enter } else { leave })
}

/// A sensor and what it sees.
struct Sensor {
    world_from_scan: RigidMotion,
    rays: usize,
    /// Half the angle about its x axis that it sees, radians; π sees all around.
    half_angle: f64,
    range_m: f64,
    noise_m: f64,
}

/// The place of a seed.
pub fn ambiguous_scans(place: Place, seed: u64) -> AmbiguousSet {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(place as u64);
    let (solids, sensors) = match place {
        Place::BareCorridor => (corridor(0, &mut rng), along(9, 2.5, 6.0, &mut rng)),
        Place::FurnishedCorridor => (corridor(40, &mut rng), along(9, 2.5, 6.0, &mut rng)),
        Place::BareTunnel => (vec![Solid::Tube { radius_m: 3.0 }], along(8, 3.0, 9.0, &mut rng)),
        Place::BareRoom => (room(0, &mut rng), inside(8, 20_000, 1.0, &mut rng)),
        Place::FurnishedRoom => (room(10, &mut rng), inside(8, 20_000, 1.0, &mut rng)),
        Place::FewPoints => {
            let rays = rng.random_range(300..500);
            (room(10, &mut rng), inside(6, rays, std::f64::consts::PI, &mut rng))
        }
        Place::SixSidedColumn => {
            let column = Solid::Column { side_m: 0.1, half_height_m: 0.15 };
            (vec![column], around(9, &mut rng))
        }
        Place::LopsidedBlock => {
            let part = |low: [f64; 3], high: [f64; 3]| Solid::Box { low: low.into(), high: high.into() };
            let size = |rng: &mut ChaCha8Rng| rng.random_range(0.04..0.1);
            let first = part([-0.1, -0.06, -0.08], [0.1, 0.02, 0.0]);
            let second = part([-0.1, 0.02, -0.08], [-0.1 + size(&mut rng), 0.02 + size(&mut rng), 0.06]);
            let third = part([0.02, -0.06, 0.0], [0.02 + 0.6 * size(&mut rng), 0.0, size(&mut rng)]);
            (vec![first, second, third], around(9, &mut rng))
        }
    };
    let scans = sensors.iter().enumerate().map(|(k, sensor)| Scan {
        id: ScanId(k),
        ..Scan::from_points(format!("scan_{k}"), &seen(sensor, &solids, &mut rng))
    });
    AmbiguousSet {
        scans: scans.collect(),
        world_from_scan: sensors.iter().map(|s| s.world_from_scan).collect(),
    }
}

/// Points of random rays, in the frame of the sensor.
fn seen(sensor: &Sensor, solids: &[Solid], rng: &mut ChaCha8Rng) -> Vec<[f64; 3]> {
    let from = Point3::from(sensor.world_from_scan.translation.vector);
    let mut points = Vec::new();
    for _ in 0..sensor.rays {
        let along = loop {
            let v = Vector3::from_fn(|_, _| rng.random_range(-1.0f64..1.0));
            let inside = (0.01..1.0).contains(&v.norm_squared());
            if inside && v.angle(&Vector3::x()) <= sensor.half_angle {
                break v.normalize();
            }
        };
        let in_world = sensor.world_from_scan.rotation * along;
        let met = solids.iter().filter_map(|s| s.meets(&from, &in_world)).fold(f64::INFINITY, f64::min);
        if met <= sensor.range_m {
            // The sum of three even errors is near enough to a normal one.
            let noise: f64 = (0..3).map(|_| rng.random_range(-1.0..1.0)).sum();
            points.push((along * (met + sensor.noise_m * noise)).into());
        }
    }
    points
}

fn corridor(things: usize, rng: &mut ChaCha8Rng) -> Vec<Solid> {
    let part = |low: [f64; 3], high: [f64; 3]| Solid::Box { low: low.into(), high: high.into() };
    let mut solids = vec![part([-40.0, -1.0, 0.0], [60.0, 1.0, 2.5])];
    for _ in 0..things {
        let (x, side) = (rng.random_range(-5.0..30.0), if rng.random_bool(0.5) { 1.0 } else { -1.0 });
        let (long, deep, high) =
            (rng.random_range(0.1..1.5), rng.random_range(0.05..0.4), rng.random_range(0.3..2.3));
        let (a, b): (f64, f64) = (side * 1.0, side * (1.0 - deep));
        solids.push(part([x, a.min(b), 0.0], [x + long, a.max(b), high]));
    }
    solids
}

fn room(things: usize, rng: &mut ChaCha8Rng) -> Vec<Solid> {
    let part = |low: [f64; 3], high: [f64; 3]| Solid::Box { low: low.into(), high: high.into() };
    let mut solids = vec![part([-4.0, -3.0, 0.0], [4.0, 3.0, 2.8])];
    for _ in 0..things {
        // Along the walls: the sensors stand in the middle.
        let size =
            Vector3::new(rng.random_range(0.3..1.6), rng.random_range(0.3..0.9), rng.random_range(0.3..2.2));
        let x = rng.random_range(-4.0..4.0 - size.x);
        let y = if rng.random_bool(0.5) { -3.0 } else { 3.0 - size.y };
        solids.push(part([x, y, 0.0], [x + size.x, y + size.y, size.z]));
    }
    solids
}

/// Any turn about the vertical and a little tilt.
fn turn(rng: &mut ChaCha8Rng) -> UnitQuaternion<f64> {
    let tilt = Vector3::new(rng.random_range(-0.1..0.1), rng.random_range(-0.1..0.1), 0.0);
    UnitQuaternion::from_euler_angles(0.0, 0.0, rng.random_range(0.0..std::f64::consts::TAU))
        * UnitQuaternion::from_scaled_axis(tilt)
}

fn along(scans: usize, step_m: f64, range_m: f64, rng: &mut ChaCha8Rng) -> Vec<Sensor> {
    let sensor = |k: usize| {
        let at = Vector3::new(
            k as f64 * step_m + rng.random_range(-0.3..0.3),
            rng.random_range(-0.3..0.3),
            1.4 + rng.random_range(-0.1..0.1),
        );
        let at = if range_m > 6.0 { at - Vector3::new(0.0, 0.0, 2.0) } else { at };
        let world_from_scan = RigidMotion::from_parts(at.into(), turn(rng));
        Sensor { world_from_scan, rays: 15_000, half_angle: std::f64::consts::PI, range_m, noise_m: 0.004 }
    };
    (0..scans).map(sensor).collect()
}

fn inside(scans: usize, rays: usize, half_angle: f64, rng: &mut ChaCha8Rng) -> Vec<Sensor> {
    let sensor = |_: usize| {
        let at = Vector3::new(
            rng.random_range(-1.5..1.5),
            rng.random_range(-1.0..1.0),
            rng.random_range(1.2..1.7),
        );
        let world_from_scan = RigidMotion::from_parts(at.into(), turn(rng));
        Sensor { world_from_scan, rays, half_angle, range_m: 20.0, noise_m: 0.004 }
    };
    (0..scans).map(sensor).collect()
}

fn around(scans: usize, rng: &mut ChaCha8Rng) -> Vec<Sensor> {
    let sensor = |k: usize| {
        let angle = (k as f64 + rng.random_range(-0.1..0.1)) * std::f64::consts::TAU / scans as f64;
        let at = Vector3::new(0.7 * angle.cos(), 0.7 * angle.sin(), 0.35);
        let towards = UnitQuaternion::face_towards(&-at, &Vector3::z());
        // The view is along x of the sensor.
        let turn = towards * UnitQuaternion::face_towards(&Vector3::x(), &Vector3::y()).inverse();
        let world_from_scan = RigidMotion::from_parts(at.into(), turn);
        Sensor { world_from_scan, rays: 40_000, half_angle: 0.35, range_m: 2.0, noise_m: 0.0003 }
    };
    (0..scans).map(sensor).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn true_poses_bring_every_scan_onto_the_solids() {
        for place in Place::ALL {
            let set = ambiguous_scans(place, 3);
            for (scan, pose) in set.scans.iter().zip(&set.world_from_scan) {
                let least = if place == Place::FewPoints { 200 } else { 1000 };
                assert!(scan.cloud.len() > least, "{place:?}: {}", scan.cloud.len());
                for p in scan.cloud.points.iter().step_by(37) {
                    let world = pose * p.cast::<f64>();
                    let off = match place {
                        Place::BareTunnel => (world.y.hypot(world.z) - 3.0).abs(),
                        Place::BareCorridor => [world.y - 1.0, world.y + 1.0, world.z, world.z - 2.5]
                            .map(f64::abs)
                            .into_iter()
                            .fold(9.0, f64::min),
                        Place::SixSidedColumn => {
                            let side = |k: usize| {
                                let a = k as f64 * std::f64::consts::FRAC_PI_3;
                                (world.x * a.cos() + world.y * a.sin()).abs()
                            };
                            let outermost = (0..3).map(side).fold(0.0, f64::max);
                            (outermost - 0.1).abs().min((world.z.abs() - 0.15).abs())
                        }
                        _ => continue,
                    };
                    assert!(off < 0.03, "{place:?}: {off} at {world}");
                }
            }
            assert_eq!(set.scans[0].cloud.points, ambiguous_scans(place, 3).scans[0].cloud.points);
        }
    }
}
