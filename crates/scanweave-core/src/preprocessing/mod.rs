//! From a scan to its surface: own frame, working scale, thinning, normals, viewpoint.
//!
//! ```text
//! Scan ─ local_frame::localize ─▶ Scan in its own frame, scan_from_local
//! PointCloud ─ scale::choose ─▶ WorkingScale
//! PointCloud ─ surface::Thinned, viewpoint::ViewpointStudy ─▶ Surface
//! ```

pub(crate) mod local_frame;
pub(crate) mod scale;
pub(crate) mod surface;
pub(crate) mod viewpoint;

pub use local_frame::{file_zero, localize};
pub use scale::{ScaleChoice, ScaleConfig, ScaleWarning, choose as choose_scale};
pub use surface::{Thinned, normals, thin};
pub use viewpoint::{SeenFrom, ViewpointStudy};
