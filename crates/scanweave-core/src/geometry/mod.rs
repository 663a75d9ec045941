//! Rigid motions and the neighbourhood structures everything else stands on.
//!
//! Poses are [`RigidMotion`]s named `target_from_source`: they take source
//! coordinates to target coordinates. Lengths are metres, angles radians.

pub(crate) mod averaging;
pub(crate) mod fit;
pub(crate) mod nearest_map;
pub(crate) mod neighbours;
pub(crate) mod occupancy;
pub(crate) mod overlap;
pub(crate) mod rigid;
pub(crate) mod sparse;
pub(crate) mod spread;
pub(crate) mod voxel;

pub use averaging::*;
pub use fit::*;
pub use nearest_map::*;
pub use neighbours::*;
pub use occupancy::*;
pub use overlap::*;
pub use rigid::*;
pub use sparse::*;
pub use spread::*;
pub use voxel::*;

/// A point, metres.
pub type Point = nalgebra::Point3<f32>;
/// A direction, unit length unless said otherwise.
pub type Direction = nalgebra::Vector3<f32>;
/// Normals further apart than 45° do not belong to the same surface.
pub const MIN_NORMAL_COSINE: f32 = std::f32::consts::FRAC_1_SQRT_2;
