//! Fused surfaces against the closed form of what the depth camera saw.

use nalgebra::{Isometry3, Vector3};
use scanweave::fusion::{FusedSurface, FusionConfig, Volume};
use scanweave::geometry::motion;
use scanweave::geometry::{Direction, Point, RigidMotion};
use scanweave::synthetic::{Intrinsics, Primitive, Scene, Shape, render_depth};

const VOXEL_M: f64 = 0.01;
const BALL_M: f64 = 0.4;

fn config() -> FusionConfig {
    FusionConfig { voxel_m: VOXEL_M, truncation_m: 5.0 * VOXEL_M, ..FusionConfig::default() }
}

/// A ball half a metre before a wall that is tilted by 0.3 rad about x, both about z = 2 m.
fn scene(ball: bool) -> Scene {
    let wall = Primitive::new(
        Shape::Box { half: Vector3::new(9.0, 9.0, 0.1) },
        &(Isometry3::rotation(Vector3::x() * 0.3) * Isometry3::translation(0.0, 0.0, 2.6)),
        [0; 3],
    );
    let mut solids = vec![wall];
    if ball {
        solids.push(Primitive::new(
            Shape::Sphere { radius: BALL_M },
            &Isometry3::from(ball_center().coords),
            [0; 3],
        ));
    }
    Scene::new(solids)
}

fn ball_center() -> nalgebra::Point3<f64> {
    nalgebra::Point3::new(0.05, 0.0, 1.7)
}

/// Normal of the wall's front, and its distance from the origin along it.
fn wall() -> (Vector3<f64>, f64) {
    // The rotation turns e_z; the front face is 0.1 m before the centre plane.
    (Vector3::new(0.0, -(0.3f64.sin()), 0.3f64.cos()), 2.5)
}

/// Cameras on an arc about the ball, all looking at it.
fn cameras(count: usize) -> Vec<RigidMotion> {
    (0..count)
        .map(|k| {
            let angle = 0.12 * (k as f64 - 0.5 * (count as f64 - 1.0));
            let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), angle);
            motion(turn, Vector3::new(-1.7 * angle.sin(), 0.05 * k as f64, 1.7 - 1.7 * angle.cos()))
        })
        .collect()
}

fn fused(scene: &Scene, config: &FusionConfig, count: usize) -> Volume {
    let k = Intrinsics::from_fov(320, 240, 57.0);
    let mut volume = Volume::new(config).unwrap();
    for pose in cameras(count) {
        volume.integrate(&render_depth(scene, &pose, &k, 9.0), &pose).unwrap();
    }
    volume
}

/// Signed distances of points and angles of normals (degrees) to the surface they lie next to.
fn errors(surface: &FusedSurface) -> (Vec<[f64; 2]>, Vec<[f64; 2]>) {
    let (front, distance) = wall();
    let (mut on_wall, mut on_ball) = (Vec::new(), Vec::new());
    for (p, n) in surface.points.iter().zip(&surface.normals) {
        let (p, n) = (p.cast::<f64>(), n.cast::<f64>());
        let from_center = p - ball_center();
        let to_ball = from_center.norm() - BALL_M;
        let angle = |truth: Vector3<f64>| n.dot(&truth).clamp(-1.0, 1.0).acos().to_degrees();
        if to_ball.abs() < 0.1 {
            on_ball.push([to_ball, angle(from_center.normalize())]);
        } else {
            on_wall.push([front.dot(&p.coords) - distance, angle(-front)]);
        }
    }
    (on_wall, on_ball)
}

fn worst(errors: &[[f64; 2]], of: usize) -> f64 {
    errors.iter().map(|e| e[of].abs()).fold(0.0, f64::max)
}

fn rms(errors: &[[f64; 2]], of: usize) -> f64 {
    (errors.iter().map(|e| e[of] * e[of]).sum::<f64>() / errors.len() as f64).sqrt()
}

#[test]
fn points_lie_on_the_surface_that_was_seen() {
    let (on_wall, on_ball) = errors(&fused(&scene(true), &config(), 7).surface());
    eprintln!(
        "wall: {} points, rms {:.4} worst {:.4} voxels, normals rms {:.2}°; ball: {} points, rms {:.4} worst {:.4}, normals {:.2}°",
        on_wall.len(),
        rms(&on_wall, 0) / VOXEL_M,
        worst(&on_wall, 0) / VOXEL_M,
        rms(&on_wall, 1),
        on_ball.len(),
        rms(&on_ball, 0) / VOXEL_M,
        worst(&on_ball, 0) / VOXEL_M,
        rms(&on_ball, 1)
    );
    assert!(on_wall.len() > 100_000 && on_ball.len() > 8000);
    // Both are exact in the limit: a plane but for where a line of sight grazes it, a ball but for
    // the curvature within a voxel and its outline.
    assert!(rms(&on_wall, 0) < 0.02 * VOXEL_M && worst(&on_wall, 0) < 0.6 * VOXEL_M);
    assert!(rms(&on_ball, 0) < 0.15 * VOXEL_M && worst(&on_ball, 0) < 0.75 * VOXEL_M);
    assert!(rms(&on_wall, 1) < 1.5 && rms(&on_ball, 1) < 10.0);
}

#[test]
fn what_later_images_see_through_is_gone() {
    let mut volume = fused(&scene(true), &config(), 1);
    assert!(!errors(&volume.surface()).1.is_empty());
    let k = Intrinsics::from_fov(320, 240, 57.0);
    for pose in cameras(5) {
        volume.integrate(&render_depth(&scene(false), &pose, &k, 9.0), &pose).unwrap();
    }
    assert!(errors(&volume.surface()).1.is_empty());
}

#[test]
fn a_place_must_be_seen_often_enough() {
    let once = fused(&scene(true), &FusionConfig { min_observations: 1, ..config() }, 7).surface();
    let often = fused(&scene(true), &FusionConfig { min_observations: 7, ..config() }, 7).surface();
    let (once, often) = (once.points.len(), often.points.len());
    assert!(often < once && often > once / 10, "{often} of {once}");
    let never = fused(&scene(true), &FusionConfig { min_observations: 8, ..config() }, 7).surface();
    assert!(never.points.is_empty());
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let surface = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| fused(&scene(true), &config(), 3).surface())
    };
    let one = surface(1);
    assert!(one == surface(3));
    // One point a voxel: no two share the cell between voxel centres.
    let mut cells: Vec<[i32; 3]> = one
        .points
        .iter()
        .map(|p: &Point| [p.x, p.y, p.z].map(|c| (f64::from(c) / VOXEL_M - 0.5 + 1e-3).floor() as i32))
        .collect();
    let n = cells.len();
    cells.sort_unstable();
    cells.dedup();
    // A crossing that comes within a thousandth of the next centre counts there.
    assert!(cells.len() as f64 > 0.99 * n as f64, "{} of {n}", cells.len());
    assert!(one.normals.iter().all(|n: &Direction| (n.norm() - 1.0).abs() < 1e-5));
}

#[test]
fn more_surface_than_memory_and_bad_settings_are_errors() {
    let k = Intrinsics::from_fov(320, 240, 57.0);
    let pose = RigidMotion::identity();
    let image = render_depth(&scene(true), &pose, &k, 9.0);
    let mut small = Volume::new(&FusionConfig { memory_mib: 1, ..config() }).unwrap();
    let message = small.integrate(&image, &pose).unwrap_err().to_string();
    assert!(message.starts_with("fusion.memory_mib: found 1, which is full"), "{message}");
    let refused = |c: FusionConfig| Volume::new(&c).unwrap_err().to_string();
    assert!(refused(FusionConfig { truncation_m: 0.015, ..config() }).contains("at least two voxels"));
    assert!(refused(FusionConfig { voxel_m: f64::NAN, ..config() }).contains("fusion.voxel_m"));
    assert!(refused(FusionConfig { memory_mib: 0, ..config() }).contains("fusion.memory_mib"));
}
