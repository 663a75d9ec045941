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
mod e57;
pub mod features;
pub mod initial_poses;
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
pub mod pose_graphs;
pub mod poses;
mod scalar;
mod scan_file;
mod scans;
mod text;
mod text_columns;
pub mod trajectories;
pub mod write_dataset;
mod write_ply;

pub use crate::atomic;
pub use cloud::{read_cloud, read_file};
pub use discover::{Discovered, FoundFile, LeftOut, discover, discover_with, scan_files};
pub use merged::read_merged;
pub use overlaps::read_overlaps;
pub use scan_file::{Note, ReadOptions, ScanFile, StoredScan, unit_m};
pub use scans::{Inputs, read_inputs, read_scans, unique_names};
pub use text_columns::TextColumns;
pub use write_ply::{PlyCloud, write_ply};
