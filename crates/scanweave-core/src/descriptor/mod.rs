//! From a scan to its local features: working scale, normals, keypoints, descriptors.
//!
//! ```text
//! PointCloud ─ scale::choose ─▶ WorkingScale
//! PointCloud ─ surface::thin ─▶ Surface ─ keypoints::choose ─▶ rows ─ describe ─▶ Features
//! ```

mod config;
pub mod fpfh;
pub mod keypoints;
pub mod mini_spin_net;

pub use config::{Describer, DescriptorConfig, DescriptorKind, PatchPoints, describe};
pub use keypoints::KeypointConfig;
