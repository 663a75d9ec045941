//! Depth images of a scene, seen by a pinhole camera. Its frame: x right, y down, z forward.

use super::scene::Scene;
use crate::geometry::RigidMotion;
use crate::scan::{DepthImage, Intrinsics};
use nalgebra::Point3;
use rayon::prelude::*;

/// Depth of a scene seen from `world_from_camera`, free of noise and up to `max_range_m`
/// along the optical axis.
///
/// Parallel over rows.
pub fn render_depth(
    scene: &Scene,
    world_from_camera: &RigidMotion,
    intrinsics: &Intrinsics,
    max_range_m: f64,
) -> DepthImage {
    let rotation = world_from_camera.rotation.to_rotation_matrix();
    let origin = Point3::from(world_from_camera.translation.vector);
    let row = |v: usize| {
        let pixel = move |u: usize| {
            let direction = rotation * intrinsics.ray(u as f64, v as f64);
            scene.cast(&origin, &direction, max_range_m).map_or(0.0, |hit| hit.t as f32)
        };
        (0..intrinsics.width).map(pixel)
    };
    let depth_m = (0..intrinsics.height).into_par_iter().flat_map_iter(row).collect();
    DepthImage { intrinsics: *intrinsics, depth_m }
}

#[cfg(test)]
mod tests {
    use super::super::shape::{Primitive, Shape};
    use super::*;
    use crate::geometry::rotation_error_rad;
    use approx::assert_relative_eq;
    use nalgebra::{Isometry3, Vector3};

    #[test]
    fn a_wall_across_the_axis_has_one_depth() {
        let wall = Primitive::new(
            Shape::Box { half: Vector3::new(9.0, 9.0, 0.1) },
            &Isometry3::translation(0.0, 0.0, 2.1),
            [0; 3],
        );
        let k = Intrinsics::from_fov(32, 24, 57.0);
        let image = render_depth(&Scene::new(vec![wall]), &RigidMotion::identity(), &k, 9.0);
        assert!(image.depth_m.iter().all(|z| (z - 2.0).abs() < 1e-6));
        // The outermost pixel borders span the field of view: tan(57°/2) at depth one.
        assert_relative_eq!(k.ray(31.5, 0.0).x, 28.5f64.to_radians().tan(), epsilon = 1e-12);
        assert_eq!(image.points().count(), 32 * 24);
        let far = render_depth(&Scene::new(vec![wall]), &RigidMotion::identity(), &k, 1.9);
        assert!(far.depth_m.iter().all(|&z| z == 0.0));
    }

    #[test]
    fn a_sphere_has_the_depth_of_its_quadratic() {
        let (radius, distance) = (0.5, 2.0);
        // The camera stands somewhere and looks along world x.
        let look = nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::new(
            0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0,
        ));
        let pose = crate::geometry::motion(look, Vector3::new(1.0, 2.0, 3.0));
        assert!(rotation_error_rad(&pose, &RigidMotion::identity()) > 1.0);
        let ball = Primitive::new(
            Shape::Sphere { radius },
            &Isometry3::translation(1.0 + distance, 2.0, 3.0),
            [0; 3],
        );
        let k = Intrinsics::from_fov(65, 49, 57.0);
        let image = render_depth(&Scene::new(vec![ball]), &pose, &k, 9.0);
        let mut seen = 0;
        for v in 0..k.height {
            for u in 0..k.width {
                let r = k.ray(u as f64, v as f64);
                // ‖z·r − (0,0,D)‖² = R² solved for the smaller z.
                let (a, c) = (r.norm_squared(), distance * distance - radius * radius);
                let d = distance * distance - a * c;
                let expected = if d < 0.0 { 0.0 } else { (distance - d.sqrt()) / a };
                let z = f64::from(image.depth_m[v * k.width + u]);
                assert!((z - expected).abs() < 1e-6, "({u},{v}): {z} against {expected}");
                seen += usize::from(z > 0.0);
            }
        }
        assert_relative_eq!(f64::from(image.depth_m[24 * 65 + 32]), 1.5, epsilon = 1e-6);
        // The outline is a circle of tangent rays: tan = R/√(D² − R²).
        let outline = std::f64::consts::PI * (k.fx * radius / (distance * distance - 0.25).sqrt()).powi(2);
        assert!((seen as f64 / outline - 1.0).abs() < 0.05, "{seen} pixels, outline {outline}");
        for (i, p) in image.points() {
            let (u, v) = k.project(&p.cast::<f64>()).unwrap();
            assert_eq!(v.round() as usize * k.width + u.round() as usize, i);
        }
    }
}
