//! Fusion of depth images with known poses into surfaces, as the fragments of 3DMatch were made.
//!
//! A [`Volume`] holds the truncated signed distance to the surface (Curless and Levoy 1996) in
//! blocks of voxels, which exist only near what was seen. Depth images are averaged into it one
//! after the other; [`Volume::surface`] reads off where the distance is zero.

mod config;
mod surface;
mod volume;

pub use config::FusionConfig;
pub use surface::FusedSurface;
pub use volume::Volume;
