//! Rigid motions and the neighbourhood structures everything else stands on.
//!
//! Poses are [`RigidMotion`]s named `target_from_source`: they take source
//! coordinates to target coordinates. Lengths are metres, angles radians.

pub mod averaging;
pub mod fit;
pub mod nearest_map;
pub mod neighbours;
pub mod overlap;
pub mod rigid;
pub mod sparse;
pub mod voxel;

pub use neighbours::PointIndex;
pub use rigid::RigidMotion;

/// A point, metres.
pub type Point = nalgebra::Point3<f32>;
/// A direction, unit length unless said otherwise.
pub type Direction = nalgebra::Vector3<f32>;
