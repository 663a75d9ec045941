//! Depth frames with known poses fused into one scan.

use super::noise::DepthFrame;
use super::scene::Scene;
use crate::geometry::PointMover;
use crate::geometry::VoxelGroups;
use crate::geometry::{Point, RigidMotion};
use crate::scan::{DepthImage, PointCloud};
use nalgebra::Vector3;

/// Depth difference up to which a neighbouring pixel helps to smooth is this times
/// `1 + z²`, metres: three to four standard deviations of the camera's noise.
const SMOOTHING_GATE_M: f32 = 0.006;

/// Fuses frames of `scene` into one cloud of voxel means (`voxel_m` wide) with mean colours.
///
/// `scan_from_camera` gives the pose of every frame's camera in the frame of the scan.
/// Each image is smoothed first, as KinectFusion does with its bilateral filter.
pub fn fuse(
    scene: &Scene,
    frames: &[DepthFrame],
    scan_from_camera: &[RigidMotion],
    voxel_m: f32,
) -> PointCloud {
    let mut points: Vec<Point> = Vec::new();
    let mut colors: Vec<[u8; 3]> = Vec::new();
    for (frame, pose) in frames.iter().zip(scan_from_camera) {
        let mover = PointMover::new(pose);
        for (pixel, p) in smoothed(&frame.image).points() {
            points.push(mover.point(&p));
            colors.push(scene.primitives()[frame.solid[pixel] as usize].color);
        }
    }
    let groups = VoxelGroups::new(&points, voxel_m);
    let mut cloud = PointCloud::from_points(Vec::with_capacity(groups.len()));
    let mut mean_colors = Vec::with_capacity(groups.len());
    for group in groups.iter() {
        let (mut sum, mut color) = (Vector3::<f64>::zeros(), [0u32; 3]);
        for &i in group {
            sum += points[i as usize].coords.cast::<f64>();
            for (c, v) in color.iter_mut().zip(colors[i as usize]) {
                *c += u32::from(v);
            }
        }
        let n = group.len();
        cloud.points.push(Point::from((sum / n as f64).cast::<f32>()));
        mean_colors.push(color.map(|c| (c / n as u32) as u8));
    }
    cloud.colors = Some(mean_colors);
    cloud
}

/// The image with every pixel replaced by the mean inverse depth of its 5×5 neighbourhood;
/// missing pixels stay missing.
///
/// Opposite neighbours are taken in pairs, and only if their mean is within the gate: inverse
/// depth is linear on planes, so that slanted ones keep their place, and steps stay sharp.
fn smoothed(image: &DepthImage) -> DepthImage {
    // One of each two opposite offsets of the 5×5 window.
    const PAIRS: [(isize, isize); 12] =
        [(1, 0), (2, 0), (-2, 1), (-1, 1), (0, 1), (1, 1), (2, 1), (-2, 2), (-1, 2), (0, 2), (1, 2), (2, 2)];
    let (w, h) = (image.intrinsics.width as isize, image.intrinsics.height as isize);
    let inverse: Vec<f32> = image.depth_m.iter().map(|&z| if z > 0.0 { 1.0 / z } else { 0.0 }).collect();
    let mut out = image.clone();
    for y in 0..h {
        for x in 0..w {
            let at = y * w + x;
            let (z, here) = (image.depth_m[at as usize], inverse[at as usize]);
            if z <= 0.0 {
                continue;
            }
            // A gate on depth, expressed in inverse depth around this pixel.
            let gate = SMOOTHING_GATE_M * (1.0 + z * z) * here * here;
            let (mut sum, mut count) = (here, 1.0f32);
            for (dx, dy) in PAIRS {
                if x < dx.abs() || x + dx.abs() >= w || y < dy || y + dy >= h {
                    continue;
                }
                let off = dy * w + dx;
                let (a, b) = (inverse[(at + off) as usize], inverse[(at - off) as usize]);
                if a > 0.0 && b > 0.0 && (0.5 * (a + b) - here).abs() < gate {
                    sum += a + b;
                    count += 2.0;
                }
            }
            out.depth_m[at as usize] = count / sum;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::camera::render_depth;
    use super::super::noise::{SensorNoise, observe};
    use super::super::shape::{Primitive, Shape};
    use super::*;
    use crate::scan::Intrinsics;
    use nalgebra::Isometry3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn slanted() -> Scene {
        let pose = Isometry3::new(Vector3::new(0.0, 0.0, 2.0), Vector3::y() * 0.6)
            * Isometry3::translation(0.0, 0.0, 0.1);
        let shape = Shape::Box { half: Vector3::new(9.0, 9.0, 0.1) };
        Scene::new(vec![Primitive::new(shape, &pose, [10, 20, 30])])
    }

    #[test]
    fn smoothing_leaves_an_exact_plane_alone_and_calms_a_noisy_one() {
        let (scene, k) = (slanted(), Intrinsics::from_fov(80, 60, 57.0));
        let exact = render_depth(&scene, &RigidMotion::identity(), &k, 9.0);
        for (a, b) in exact.depth_m.iter().zip(&smoothed(&exact).depth_m) {
            assert!((a - b).abs() < 1e-5 * a, "{a} became {b}");
        }
        let noise = SensorNoise { scale: 1.0, min_range_m: 0.4, max_range_m: 9.0 };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let frame = observe(&scene, &RigidMotion::identity(), &k, &noise, &mut rng);
        let spread = |image: &DepthImage| {
            let e: Vec<f64> = image
                .depth_m
                .iter()
                .zip(&exact.depth_m)
                .filter(|(a, b)| **a > 0.0 && **b > 0.0)
                .map(|(a, b)| f64::from(a - b).powi(2))
                .collect();
            (e.iter().sum::<f64>() / e.len() as f64).sqrt()
        };
        let (before, after) = (spread(&frame.image), spread(&smoothed(&frame.image)));
        assert!(after < 0.6 * before, "{before} to {after}");
    }

    #[test]
    fn fused_points_lie_on_the_surface_and_keep_its_colour() {
        let (scene, k) = (slanted(), Intrinsics::from_fov(160, 120, 57.0));
        let poses = [RigidMotion::identity(), RigidMotion::new(Vector3::x() * 0.2, Vector3::y() * 0.3)];
        let noise = SensorNoise { scale: 0.0, min_range_m: 0.4, max_range_m: 9.0 };
        let frames: Vec<DepthFrame> =
            poses.iter().map(|p| observe(&scene, p, &k, &noise, &mut ChaCha8Rng::seed_from_u64(0))).collect();
        let cloud = fuse(&scene, &frames, &poses, 0.02);
        assert!(cloud.len() > 1000);
        for p in &cloud.points {
            // Means of points of one plane lie in the plane, whatever is averaged.
            assert!(scene.primitives()[0].signed_distance(&p.cast::<f64>()).abs() < 5e-3);
        }
        assert!(cloud.colors.unwrap().iter().all(|c| *c == [10, 20, 30]));
    }
}
