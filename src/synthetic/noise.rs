//! What a real structured-light camera does to the depth of a scene.

use super::scene::Scene;
use crate::geometry::RigidMotion;
use crate::scan::{DepthImage, Intrinsics};
use nalgebra::Point3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Noise of a depth camera of the first Kinect's kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorNoise {
    /// Factor on every random error and on the step of the depth scale; 0 gives exact depth
    /// with the same range limits.
    pub scale: f64,
    /// Nearest depth, metres.
    pub min_range_m: f64,
    /// Farthest depth, metres.
    pub max_range_m: f64,
}

/// Step of inverse depth, 1/m: an eighth of a pixel of disparity at a focal length of 580
/// pixels and a baseline of 75 mm.
const INVERSE_DEPTH_STEP: f64 = 0.125 / (580.0 * 0.075);
/// Standard deviation of the place a pixel looks at, pixels of a 640-pixel row (Nguyen: 0.8).
const LATERAL_SIGMA_OF_640: f64 = 0.8;
/// Angle between ray and surface normal from which returns begin to fail, degrees.
const GRAZING_FROM_DEG: f64 = 68.0;
/// Angle from which no return is left, degrees.
const GRAZING_TO_DEG: f64 = 86.0;
/// Blobs without depth in a frame: at most this many at noise scale 1.
const MOST_BLOBS: f64 = 7.0;

/// One frame of the camera.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthFrame {
    /// Depth with noise.
    pub image: DepthImage,
    /// For every pixel the index of the solid it sees in the scene (meaningless without depth).
    pub solid: Vec<u32>,
}

impl SensorNoise {
    /// Standard deviation of depth at `z_m` under `angle_rad` between ray and normal, metres.
    ///
    /// Nguyen, Izadi, Lovell 2012, equations 2 and 3, their angular term for more than 10°.
    pub fn axial_sigma_m(&self, z_m: f64, angle_rad: f64) -> f64 {
        let straight = 0.0012 + 0.0019 * (z_m - 0.4).powi(2);
        let slope = if angle_rad > 10f64.to_radians() {
            let rest = (std::f64::consts::FRAC_PI_2 - angle_rad).max(0.1);
            0.0001 / z_m.max(0.1).sqrt() * (angle_rad / rest).powi(2)
        } else {
            0.0
        };
        self.scale * (straight + slope)
    }

    /// Depth on the camera's scale: equal steps of inverse depth.
    pub fn quantised_m(&self, z_m: f64) -> f64 {
        let step = INVERSE_DEPTH_STEP * self.scale;
        if step <= 0.0 { z_m } else { 1.0 / ((1.0 / z_m / step).round() * step).max(step) }
    }

    /// Probability that a surface seen under `angle_rad` returns nothing.
    pub fn grazing_dropout(&self, angle_rad: f64) -> f64 {
        if self.scale <= 0.0 {
            return 0.0;
        }
        let x = (angle_rad.to_degrees() - GRAZING_FROM_DEG) / (GRAZING_TO_DEG - GRAZING_FROM_DEG);
        x.clamp(0.0, 1.0).powf(1.0 / self.scale.max(0.1))
    }
}

/// A frame of `scene` from `world_from_camera` with the camera's errors: jitter of the place
/// a pixel looks at (ragged edges), depth-dependent noise, a stepped depth scale, missing
/// returns on dark, glossy and grazing surfaces and out of range, and blobs without depth.
///
/// All randomness is drawn from `rng`, pixel by pixel in row order.
pub fn observe(
    scene: &Scene,
    world_from_camera: &RigidMotion,
    intrinsics: &Intrinsics,
    noise: &SensorNoise,
    rng: &mut ChaCha8Rng,
) -> DepthFrame {
    let k = intrinsics;
    let rotation = world_from_camera.rotation.to_rotation_matrix();
    let origin = Point3::from(world_from_camera.translation.vector);
    let lateral = noise.scale * LATERAL_SIGMA_OF_640 * k.width as f64 / 640.0;
    let mut depth_m = vec![0.0f32; k.width * k.height];
    let mut solid = vec![0u32; k.width * k.height];
    for i in 0..depth_m.len() {
        let (u, v) = ((i % k.width) as f64, (i / k.width) as f64);
        let (du, dv) = normal_pair(rng);
        let (dz, _) = normal_pair(rng);
        let chance: f64 = rng.random();
        let direction = rotation * k.ray(u + lateral * du, v + lateral * dv);
        let Some(hit) = scene.cast(&origin, &direction, noise.max_range_m * 1.2) else { continue };
        let angle = (-hit.normal.dot(&direction) / direction.norm()).clamp(0.0, 1.0).acos();
        let absent = f64::from(scene.primitives()[hit.primitive].dropout);
        if chance < 1.0 - (1.0 - absent) * (1.0 - noise.grazing_dropout(angle)) {
            continue;
        }
        let z = hit.t + noise.axial_sigma_m(hit.t, angle) * dz;
        if z < noise.min_range_m || z > noise.max_range_m {
            continue;
        }
        depth_m[i] = noise.quantised_m(z) as f32;
        solid[i] = hit.primitive as u32;
    }
    punch_blobs(&mut depth_m, k, noise.scale, rng);
    DepthFrame { image: DepthImage { intrinsics: *k, depth_m }, solid }
}

/// Two independent standard normal numbers (Box and Muller).
pub(super) fn normal_pair(rng: &mut ChaCha8Rng) -> (f64, f64) {
    let (a, b): (f64, f64) = (rng.random(), rng.random());
    let r = (-2.0 * (1.0 - a).ln()).sqrt();
    let (s, c) = (std::f64::consts::TAU * b).sin_cos();
    (r * c, r * s)
}

/// Clears a few blobs with wavy outlines.
fn punch_blobs(depth_m: &mut [f32], k: &Intrinsics, scale: f64, rng: &mut ChaCha8Rng) {
    let most = (MOST_BLOBS * scale).round().min(100.0) as usize;
    let blobs = if most == 0 { 0 } else { rng.random_range(0..=most) };
    for _ in 0..blobs {
        let (u, v) = (rng.random_range(0.0..k.width as f64), rng.random_range(0.0..k.height as f64));
        let radius = k.width as f64 * rng.random_range(0.008..0.045);
        let (phase, waves) =
            (rng.random_range(0.0..std::f64::consts::TAU), f64::from(rng.random_range(2u8..6)));
        let stretch: f64 = rng.random_range(0.6..1.6);
        let reach = radius * 2.2;
        let range =
            |c: f64, end: usize| (c - reach).max(0.0) as usize..((c + reach).max(0.0) as usize).min(end);
        for y in range(v, k.height) {
            for x in range(u, k.width) {
                let (dx, dy) = ((x as f64 - u) * stretch, (y as f64 - v) / stretch);
                let outline = radius * (1.0 + 0.35 * (waves * dy.atan2(dx) + phase).sin());
                if dx.hypot(dy) < outline {
                    depth_m[y * k.width + x] = 0.0;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::shape::{Primitive, Shape};
    use super::*;
    use nalgebra::{Isometry3, Vector3};
    use rand::SeedableRng;

    fn wall_at(z: f64, turned_deg: f64, dropout: f32) -> Scene {
        let pose = Isometry3::translation(0.0, 0.0, z)
            * Isometry3::rotation(Vector3::y() * turned_deg.to_radians())
            * Isometry3::translation(0.0, 0.0, 0.5);
        let half = Vector3::new(50.0, 50.0, 0.5);
        Scene::new(vec![Primitive::new(Shape::Box { half }, &pose, [9; 3]).with_dropout(dropout)])
    }

    fn frame(scene: &Scene, scale: f64, fov_deg: f64) -> Vec<f64> {
        let noise = SensorNoise { scale, min_range_m: 0.4, max_range_m: 4.0 };
        let k = Intrinsics::from_fov(200, 150, fov_deg);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let f = observe(scene, &RigidMotion::identity(), &k, &noise, &mut rng);
        f.image.depth_m.iter().map(|&z| f64::from(z)).collect()
    }

    #[test]
    fn spread_on_a_wall_is_axial_noise_plus_quantisation() {
        for (z, scale) in [(1.0, 1.0), (2.0, 1.0), (3.2, 1.0), (2.0, 0.5)] {
            // A narrow view keeps every ray within 2° of the normal.
            let seen: Vec<f64> =
                frame(&wall_at(z, 0.0, 0.0), scale, 3.0).into_iter().filter(|z| *z > 0.0).collect();
            let n = seen.len() as f64;
            let mean = seen.iter().sum::<f64>() / n;
            let variance = seen.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
            let sigma = scale * (0.0012 + 0.0019 * (z - 0.4f64).powi(2));
            // A uniform error of one step h has variance h²/12; the step of z is z² times that of 1/z.
            let step = scale * z * z * 0.125 / (580.0 * 0.075);
            let expected = sigma * sigma + step * step / 12.0;
            // Quantisation and noise are not independent where the step is wide: 10 %.
            assert!((variance / expected - 1.0).abs() < 0.1, "z {z}: {variance} against {expected}");
            assert!((mean - z).abs() < 0.1 * sigma + 0.1 * step, "mean {mean} at {z}");
            let levels = seen.iter().map(|z| 1.0 / z / (scale * 0.125 / 43.5));
            assert!(levels.into_iter().all(|l| (l - l.round()).abs() < 1e-2), "depth off the scale");
        }
    }

    #[test]
    fn without_noise_depth_is_exact_and_complete() {
        assert!(frame(&wall_at(2.0, 0.0, 0.0), 0.0, 57.0).iter().all(|z| (z - 2.0).abs() < 1e-6));
        assert!(frame(&wall_at(4.1, 0.0, 0.0), 0.0, 57.0).iter().all(|z| *z == 0.0));
        assert!(frame(&wall_at(0.3, 0.0, 0.0), 0.0, 57.0).iter().all(|z| *z == 0.0));
    }

    #[test]
    fn returns_fail_on_gloss_and_at_grazing_angles() {
        let share =
            |s: &Scene| frame(s, 1.0, 2.0).iter().filter(|z| **z > 0.0).count() as f64 / (200.0 * 150.0);
        let full = share(&wall_at(2.0, 0.0, 0.0));
        assert!(full > 0.9 && full < 1.0, "blobs take a few percent: {full}");
        // Same seed, same blobs: the ratio is the return probability, 30 000 pixels: ±1.5 %.
        let glossy = share(&wall_at(2.0, 0.0, 0.7)) / full;
        assert!((glossy - 0.3).abs() < 0.015, "{glossy}");
        let grazing = share(&wall_at(2.0, 77.0, 0.0)) / full;
        assert!((grazing - 0.5).abs() < 0.06, "half way from 68° to 86°: {grazing}");
        assert_eq!(share(&wall_at(2.0, 88.0, 0.0)), 0.0);
    }
}
