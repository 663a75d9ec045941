//! Reading scans, features, poses and data sets; writing clouds and poses.
//!
//! One file per format. [`read_cloud`] reads any cloud, [`discover`] finds the
//! files, [`read_scans`] reads many; everything that is written goes through
//! [`atomic::write`].

mod bin;
mod blocks;
mod cloud;
mod colors;
pub mod dataset;
pub mod depth;
mod discover;
mod e57;
pub(crate) mod exported;
pub mod features;
mod fields;
pub mod initial_poses;
mod las;
mod lzf;
mod merged;
mod mesh;
mod named_file;
mod npy;
mod npy_header;
mod npz;
mod overlaps;
mod packed;
pub mod pairs;
mod pcd;
mod pcd_header;
mod pcd_viewpoint;
mod ply;
pub mod pose_graphs;
pub mod poses;
mod ptx;
mod scalar;
mod scan_file;
mod scanner;
mod scans;
mod text;
mod text_columns;
pub mod trajectories;
mod unpack_limit;
mod vertices;
pub mod write_dataset;
mod write_e57;
mod write_las;
mod write_pcd;
mod write_ply;

pub use crate::atomic;
pub use blocks::{BLOCK_POINTS, Held, PointBlocks, Summary, TakeBlock, move_block, open_blocks};
pub use cloud::{read_cloud, read_file};
pub use discover::{Discovered, FoundFile, LeftOut, discover, discover_with, scan_files};
pub use merged::{merged_run, read_merged};
pub use named_file::check_named_scan;
pub use overlaps::read_overlaps;
pub use scan_file::{Note, ReadOptions, ScanFile, StoredScan, unit_m};
pub use scans::{Inputs, read_inputs, read_scans, read_scans_with, unique_names};
pub use text_columns::TextColumns;
pub use write_e57::{E57Scan, write_e57};
pub use write_las::write_las;
pub use write_pcd::write_pcd;
pub use write_ply::{PlyCloud, write_ply, write_ply_blocks};
