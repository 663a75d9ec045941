//! Rigid motions and the neighbourhood structures everything else stands on.
//!
//! Poses are [`RigidMotion`]s named `target_from_source`: they take source
//! coordinates to target coordinates. Lengths are metres, angles radians.

pub mod averaging;
pub mod fit;
pub mod nearest_map;
pub mod occupancy;
pub mod neighbours;
pub mod overlap;
pub mod rigid;
pub mod sparse;
pub mod spread;
pub mod voxel;

pub use neighbours::PointIndex;
pub use rigid::RigidMotion;

/// A point, metres.
pub type Point = nalgebra::Point3<f32>;
/// A direction, unit length unless said otherwise.
pub type Direction = nalgebra::Vector3<f32>;
/// Normals further apart than 45° do not belong to the same surface.
pub const MIN_NORMAL_COSINE: f32 = std::f32::consts::FRAC_1_SQRT_2;
