//! The solids a synthetic scene is made of, and where a ray meets them.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

/// A solid about the origin of its own frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// A box with these half edge lengths.
    Box {
        /// Half edge lengths along x, y and z.
        half: Vector3<f64>,
    },
    /// A closed cylinder about the z axis.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Half of the height.
        half_height: f64,
    },
    /// A sphere.
    Sphere {
        /// Radius.
        radius: f64,
    },
}

/// A solid with a pose and a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Primitive {
    shape: Shape,
    /// Rotation part of `world_from_shape`.
    rotation: Matrix3<f64>,
    center: Vector3<f64>,
    /// sRGB colour of its surface.
    pub color: [u8; 3],
    /// Probability that the depth camera gets no return from it (glass, black gloss), in `[0, 1]`.
    pub dropout: f32,
}

/// Where a ray enters a solid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entry {
    /// Ray parameter: the point is `origin + t · direction`.
    pub t: f64,
    /// Outward unit normal there, in the frame of the ray.
    pub normal: Vector3<f64>,
}

impl Primitive {
    /// A solid at `world_from_shape`.
    pub fn new(shape: Shape, world_from_shape: &Isometry3<f64>, color: [u8; 3]) -> Self {
        Self {
            shape,
            rotation: world_from_shape.rotation.to_rotation_matrix().into_inner(),
            center: world_from_shape.translation.vector,
            color,
            dropout: 0.0,
        }
    }

    /// The same solid with a surface that returns nothing with probability `dropout`.
    pub fn with_dropout(self, dropout: f32) -> Self {
        Self { dropout, ..self }
    }

    /// Corners of the axis-aligned box around it, metres.
    pub fn bounds(&self) -> (Vector3<f64>, Vector3<f64>) {
        let reach = match self.shape {
            Shape::Box { half } => self.rotation.abs() * half,
            Shape::Sphere { radius } => Vector3::repeat(radius),
            Shape::Cylinder { radius, half_height } => {
                // A disc of radius r with axis a reaches r·√(1 − a_k²) along axis k.
                let a = self.rotation.column(2);
                a.map(|v| v.abs() * half_height + radius * (1.0 - v * v).max(0.0).sqrt())
            }
        };
        (self.center - reach, self.center + reach)
    }

    /// First point where the ray `origin + t·direction` (`t` in `(t_min, t_max)`) enters the
    /// solid. A ray that starts inside meets nothing: cameras stand outside of things.
    pub fn enter(
        &self,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        t_min: f64,
        t_max: f64,
    ) -> Option<Entry> {
        let o = self.rotation.tr_mul(&(origin.coords - self.center));
        let d = self.rotation.tr_mul(direction);
        let (t, normal) = match self.shape {
            Shape::Box { half } => enter_box(&o, &d, &half)?,
            Shape::Sphere { radius } => enter_sphere(&o, &d, radius)?,
            Shape::Cylinder { radius, half_height } => enter_cylinder(&o, &d, radius, half_height)?,
        };
        (t > t_min && t < t_max).then(|| Entry { t, normal: self.rotation * normal })
    }

    /// Distance of a point to the surface, negative inside, metres.
    pub fn signed_distance(&self, point: &Point3<f64>) -> f64 {
        let p = self.rotation.tr_mul(&(point.coords - self.center));
        let outside = |q: &[f64]| -> f64 {
            let deepest = q.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            q.iter().map(|v| v.max(0.0).powi(2)).sum::<f64>().sqrt() + deepest.min(0.0)
        };
        match self.shape {
            Shape::Box { half } => outside((p.abs() - half).as_slice()),
            Shape::Sphere { radius } => p.norm() - radius,
            Shape::Cylinder { radius, half_height } => {
                outside(&[p.x.hypot(p.y) - radius, p.z.abs() - half_height])
            }
        }
    }
}

/// Interval of `t` within `|o + t d| ≤ half`, or `None` when the slab is missed.
fn slab(o: f64, d: f64, half: f64) -> Option<(f64, f64)> {
    if d == 0.0 {
        return (o.abs() <= half).then_some((f64::NEG_INFINITY, f64::INFINITY));
    }
    let (a, b) = ((-half - o) / d, (half - o) / d);
    Some((a.min(b), a.max(b)))
}

fn enter_box(o: &Vector3<f64>, d: &Vector3<f64>, half: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
    let (mut enter, mut leave, mut axis) = (f64::NEG_INFINITY, f64::INFINITY, 0);
    for k in 0..3 {
        let (a, b) = slab(o[k], d[k], half[k])?;
        if a > enter {
            enter = a;
            axis = k;
        }
        leave = leave.min(b);
    }
    if enter > leave || !enter.is_finite() {
        return None;
    }
    let mut normal = Vector3::zeros();
    normal[axis] = -d[axis].signum();
    Some((enter, normal))
}

fn enter_sphere(o: &Vector3<f64>, d: &Vector3<f64>, radius: f64) -> Option<(f64, Vector3<f64>)> {
    let (a, b, c) = (d.norm_squared(), o.dot(d), o.norm_squared() - radius * radius);
    let discriminant = b * b - a * c;
    if discriminant < 0.0 {
        return None;
    }
    let t = (-b - discriminant.sqrt()) / a;
    Some((t, (o + d * t) / radius))
}

fn enter_cylinder(o: &Vector3<f64>, d: &Vector3<f64>, radius: f64, half: f64) -> Option<(f64, Vector3<f64>)> {
    let (cap_enter, cap_leave) = slab(o.z, d.z, half)?;
    let a = d.x * d.x + d.y * d.y;
    let b = o.x * d.x + o.y * d.y;
    let c = o.x * o.x + o.y * o.y - radius * radius;
    let (side_enter, side_leave) = if a == 0.0 {
        if c > 0.0 {
            return None;
        }
        (f64::NEG_INFINITY, f64::INFINITY)
    } else {
        let discriminant = b * b - a * c;
        if discriminant < 0.0 {
            return None;
        }
        let root = discriminant.sqrt();
        ((-b - root) / a, (-b + root) / a)
    };
    let t = cap_enter.max(side_enter);
    if t > cap_leave.min(side_leave) || !t.is_finite() {
        return None;
    }
    let normal = if cap_enter > side_enter {
        Vector3::new(0.0, 0.0, -d.z.signum())
    } else {
        Vector3::new((o.x + t * d.x) / radius, (o.y + t * d.y) / radius, 0.0)
    };
    Some((t, normal))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn shapes() -> [Shape; 3] {
        [
            Shape::Box { half: Vector3::new(0.5, 0.2, 0.8) },
            Shape::Cylinder { radius: 0.4, half_height: 0.7 },
            Shape::Sphere { radius: 0.6 },
        ]
    }

    proptest! {
        /// Sphere tracing along the independent distance function finds the same entry.
        #[test]
        fn entry_is_the_first_point_at_distance_zero(
            which in 0usize..3,
            pose in prop::array::uniform6(-1.0f64..1.0),
            from in prop::array::uniform3(-1.0f64..1.0),
            aim in prop::array::uniform3(-0.5f64..0.5),
        ) {
            let pose = Isometry3::new(
                Vector3::new(pose[0], pose[1], pose[2]),
                Vector3::new(pose[3], pose[4], pose[5]),
            );
            let solid = Primitive::new(shapes()[which], &pose, [0; 3]);
            let origin = Point3::from(Vector3::from(from).normalize() * 6.0);
            let direction = (pose * Point3::from(aim) - origin).normalize();
            let (mut t, mut closest) = (0.0, f64::INFINITY);
            for _ in 0..4000 {
                let d = solid.signed_distance(&(origin + direction * t));
                closest = closest.min(d);
                t += d;
                if d < 1e-10 || t > 20.0 { break; }
            }
            let hit = solid.enter(&origin, &direction, 0.0, 100.0);
            // Rays that pass within a hair of the surface may go either way.
            prop_assume!(!(1e-10..1e-6).contains(&closest));
            prop_assert_eq!(hit.is_some(), closest < 1e-10);
            if let Some(hit) = hit {
                prop_assert!((hit.t - t).abs() < 1e-6, "{} against {t}", hit.t);
                // The normal is the gradient of the distance, and faces the ray.
                let p = origin + direction * hit.t;
                let outside = solid.signed_distance(&(p + hit.normal * 1e-3));
                prop_assert!((outside - 1e-3).abs() < 1e-9);
                prop_assert!(hit.normal.dot(&direction) <= 1e-9);
                let (low, high) = solid.bounds();
                for k in 0..3 {
                    prop_assert!(p[k] >= low[k] - 1e-9 && p[k] <= high[k] + 1e-9);
                }
            }
        }
    }
}
