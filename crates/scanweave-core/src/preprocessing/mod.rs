//! From a scan to its surface: working scale, thinning, normals.
//!
//! ```text
//! PointCloud ─ scale::choose ─▶ WorkingScale
//! PointCloud ─ surface::thin ─▶ Surface
//! ```

pub mod scale;
pub mod surface;

pub use scale::{ScaleChoice, ScaleConfig, ScaleWarning};
