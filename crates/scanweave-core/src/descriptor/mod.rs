//! From a scan to its local features: working scale, normals, keypoints, descriptors.
//!
//! ```text
//! PointCloud ─ scale::choose ─▶ WorkingScale
//! PointCloud ─ surface::thin ─▶ Surface ─ keypoints::choose ─▶ rows ─ describe ─▶ Features
//! ```

mod config;
pub(crate) mod fpfh;
pub(crate) mod keypoints;
pub mod mini_spin_net;

pub use config::{Describer, DescriptorConfig, DescriptorKind, PatchPoints, describe};
pub use fpfh::{DIMENSION as FPFH_DIMENSION, descriptors as fpfh_descriptors};
pub use keypoints::{KeypointConfig, choose as choose_keypoints, subsample as subsample_features};
