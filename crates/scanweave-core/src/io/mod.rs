//! Reading scans, features, poses and data sets; writing clouds and poses.
//!
//! One file per format. [`read_cloud`] reads any cloud, [`discover`] finds the
//! files, [`read_scans`] reads many; everything that is written goes through
//! [`atomic::write`].

mod cloud;
mod colors;
pub mod dataset;
pub mod depth;
mod discover;
#[cfg(feature = "e57")]
mod e57;
pub mod features;
#[cfg(feature = "las")]
mod las;
mod lzf;
mod merged;
mod npy;
mod overlaps;
pub mod pairs;
mod pcd;
mod pcd_header;
mod ply;
mod ply_header;
pub mod poses;
mod scalar;
mod scans;
mod text;
pub mod write_dataset;
mod write_ply;

pub use crate::atomic;
pub use cloud::read_cloud;
pub use discover::{discover, scan_files};
pub use merged::read_merged;
pub use overlaps::read_overlaps;
pub use scans::{read_scans, unique_names};
pub use write_ply::{PlyCloud, write_ply};
