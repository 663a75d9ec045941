//! From a scan to its surface: working scale, thinning, normals.
//!
//! ```text
//! PointCloud ─ scale::choose ─▶ WorkingScale
//! PointCloud ─ surface::thin ─▶ Surface
//! ```

pub(crate) mod scale;
pub(crate) mod surface;

pub use scale::{ScaleChoice, ScaleConfig, ScaleWarning, choose as choose_scale};
pub use surface::{normals, thin};
