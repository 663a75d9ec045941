//! Where along a walk the scans are taken, so that neighbours overlap as wanted.

use super::SynthConfig;
use super::building::{Building, build};
use super::fragment::fuse;
use super::noise::{SensorNoise, observe};
use super::scene::Scene;
use super::walk::Walk;
use crate::geometry::RigidMotion;
use crate::scan::{Intrinsics, PointCloud};
use nalgebra::{Point3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Effort (see [`Walk`]) that the frames of one scan span.
const SPAN: f64 = 1.4;
/// Turn from one scan to the next at the default overlap, degrees, as measured.
const TURN_PER_SCAN_DEG: f64 = 38.0;
/// Scans that the way to the next room takes.
const SCANS_PER_DOOR: f64 = 2.5;
/// Largest step between two scans, effort.
const LONGEST_STEP: f64 = 5.0;
/// Distance up to which two depths are the same surface, metres.
const SAME_SURFACE_M: f64 = 0.04;
/// Rays of the coarse image that overlaps are foreseen with.
const COARSE: (usize, usize) = (24, 18);
/// Cosine between ray and normal below which a surface does not count as seen.
const LEAST_COSINE: f64 = 0.21;

/// A building and the camera poses of every scan in it; scans are made one by one on demand.
pub struct Site {
    scene: Scene,
    intrinsics: Intrinsics,
    noise: SensorNoise,
    voxel_m: f32,
    seed: u64,
    /// Per scan the `world_from_camera` of its frames.
    frames: Vec<Vec<RigidMotion>>,
}

impl Site {
    /// Builds `rooms` rooms from `seed` and plans `scans` scans along a walk through them.
    pub fn new(config: &SynthConfig, seed: u64, rooms: usize, scans: usize) -> Self {
        let mut rng = generator(seed, 0);
        let building = build(rooms, &mut rng);
        let scene = Scene::new(building.solids.clone());
        let intrinsics = Intrinsics::from_fov(config.width, config.height, config.horizontal_fov_deg);
        let noise = SensorNoise { scale: config.noise, min_range_m: 0.4, max_range_m: config.max_range_m };
        let frames = plan(config, &building, &scene, scans, &mut rng);
        Self { scene, intrinsics, noise, voxel_m: config.voxel_m as f32, seed, frames }
    }

    /// The solids.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The camera.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// The camera's errors.
    pub fn noise(&self) -> &SensorNoise {
        &self.noise
    }

    /// Number of planned scans.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// True when no scan is planned.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// `world_from_camera` of every frame of a scan.
    pub fn camera_poses(&self, scan: usize) -> &[RigidMotion] {
        &self.frames[scan]
    }

    /// Scan `scan` of the walk in a frame of its own (turned at random, the middle camera at
    /// its origin), and its true `world_from_scan`.
    pub fn scan(&self, scan: usize) -> (PointCloud, RigidMotion) {
        let poses = &self.frames[scan];
        let mut rng = generator(self.seed, 1 + scan as u64);
        let middle = poses[poses.len() / 2];
        let turn = RigidMotion::from_parts(
            Vector3::zeros().into(),
            nalgebra::UnitQuaternion::from_rotation_matrix(&random_rotation(&mut rng)),
        );
        let world_from_scan = middle * turn;
        let frames: Vec<_> = poses
            .iter()
            .map(|pose| observe(&self.scene, pose, &self.intrinsics, &self.noise, &mut rng))
            .collect();
        let scan_from_camera: Vec<_> = poses.iter().map(|pose| world_from_scan.inverse() * pose).collect();
        (fuse(&self.scene, &frames, &scan_from_camera, self.voxel_m), world_from_scan)
    }
}

/// Generator of one item of one seed; items never share random numbers.
pub(super) fn generator(seed: u64, item: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(item);
    rng
}

/// A rotation drawn evenly from SO(3) (Shoemake 1992).
fn random_rotation(rng: &mut ChaCha8Rng) -> Rotation3<f64> {
    let (a, b, c): (f64, f64, f64) = (rng.random(), rng.random_range(0.0..TAU), rng.random_range(0.0..TAU));
    let (r, s) = ((1.0 - a).sqrt(), a.sqrt());
    let q = nalgebra::Quaternion::new(s * c.cos(), r * b.sin(), r * b.cos(), s * c.sin());
    nalgebra::UnitQuaternion::from_quaternion(q).to_rotation_matrix()
}

/// Poses of the frames of a scan that starts at effort `at`.
fn span(walk: &Walk, at: f64, frames: usize) -> Vec<RigidMotion> {
    let step = if frames > 1 { SPAN / (frames - 1) as f64 } else { 0.0 };
    (0..frames).map(|k| walk.pose(at + step * k as f64)).collect()
}

/// Steps along the walk until the foreseen overlap with the scan before falls to the target.
fn plan(
    config: &SynthConfig,
    building: &Building,
    scene: &Scene,
    scans: usize,
    rng: &mut ChaCha8Rng,
) -> Vec<Vec<RigidMotion>> {
    let per_room = scans as f64 / building.rooms.len() as f64 - SCANS_PER_DOOR;
    let mut walk = Walk::new(building, (TURN_PER_SCAN_DEG * per_room).clamp(140.0, 380.0), rng);
    let mut planned = Vec::with_capacity(scans);
    let (mut at, mut last): (f64, Option<View>) = (0.0, None);
    while planned.len() < scans {
        while walk.end() < at + LONGEST_STEP + SPAN {
            walk.add_lap(building, rng);
        }
        if let Some(before) = &last {
            let target = config.overlap + rng.random_range(-0.06..0.06);
            let view = |step: f64| View::new(scene, &span(&walk, at + step, 3), config);
            let enough = |step: f64| before.overlap(&view(step), scene, config) >= target;
            let (mut low, mut high) = (0.0, 0.25);
            while high < LONGEST_STEP && enough(high) {
                (low, high) = (high, high + 0.25);
            }
            for _ in 0..4 {
                let middle = 0.5 * (low + high);
                if enough(middle) { low = middle } else { high = middle }
            }
            at += 0.5 * (low + high);
        }
        last = Some(View::new(scene, &span(&walk, at, 3), config));
        planned.push(span(&walk, at, config.frames_per_scan));
    }
    planned
}

/// What a scan will cover, coarsely.
struct View {
    camera_from_world: Vec<RigidMotion>,
    eyes: Vec<Point3<f64>>,
    image: Intrinsics,
    /// Surface points and the area each stands for.
    points: Vec<(Point3<f64>, f64)>,
}

impl View {
    fn new(scene: &Scene, poses: &[RigidMotion], config: &SynthConfig) -> Self {
        let mut view = Self {
            camera_from_world: Vec::new(),
            eyes: Vec::new(),
            image: Intrinsics::from_fov(COARSE.0, COARSE.1, config.horizontal_fov_deg),
            points: Vec::new(),
        };
        for pose in poses {
            let eye = Point3::from(pose.translation.vector);
            let mut fresh = Vec::new();
            for i in 0..COARSE.0 * COARSE.1 {
                let ray = pose.rotation * view.image.ray((i % COARSE.0) as f64, (i / COARSE.0) as f64);
                let Some(hit) = scene.cast(&eye, &ray, config.max_range_m) else { continue };
                let cosine = -hit.normal.dot(&ray) / ray.norm();
                let p = eye + ray * hit.t;
                let glass = scene.primitives()[hit.primitive].dropout > 0.5;
                // A place that an earlier frame of this scan sees is counted once.
                if hit.t > 0.4 && cosine > LEAST_COSINE && !glass && !view.sees(&p, scene, config) {
                    fresh.push((p, hit.t * hit.t / cosine));
                }
            }
            view.points.extend(fresh);
            view.camera_from_world.push(pose.inverse());
            view.eyes.push(eye);
        }
        view
    }

    fn sees(&self, p: &Point3<f64>, scene: &Scene, config: &SynthConfig) -> bool {
        self.camera_from_world.iter().zip(&self.eyes).any(|(camera, eye)| {
            let local = camera * p;
            if local.z < 0.4 || local.z > config.max_range_m || self.image.project(&local).is_none() {
                return false;
            }
            let ray = p - eye;
            let length = ray.norm();
            scene.cast(eye, &ray, 1.0 + 0.1 / length).is_some_and(|hit| {
                (hit.t - 1.0).abs() * length < SAME_SURFACE_M && -hit.normal.dot(&ray) > LEAST_COSINE * length
            })
        })
    }

    /// Foreseen two-way overlap: area that the other sees, over all area.
    fn overlap(&self, other: &Self, scene: &Scene, config: &SynthConfig) -> f64 {
        let shared = |a: &Self, b: &Self| {
            let seen = a.points.iter().filter(|(p, _)| b.sees(p, scene, config));
            (seen.map(|x| x.1).sum::<f64>(), a.points.iter().map(|x| x.1).sum::<f64>())
        };
        let ((a, all_a), (b, all_b)) = (shared(self, other), shared(other, self));
        if all_a + all_b > 0.0 { (a + b) / (all_a + all_b) } else { 0.0 }
    }
}
