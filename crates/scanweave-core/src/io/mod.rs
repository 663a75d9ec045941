//! Reading scans, features, poses and data sets; writing clouds and poses.
//!
//! One file per format. [`read_cloud`] reads any cloud, [`discover`] finds the
//! files, [`read_scans`] reads many; everything that is written goes through
//! [`files::write`](fn@crate::files::write).

mod bin;
mod blocks;
mod cloud;
mod colors;
pub(crate) mod dataset;
pub(crate) mod depth;
mod discover;
mod e57;
pub(crate) mod exported;
pub(crate) mod features;
mod fields;
pub(crate) mod initial_poses;
pub(crate) mod kept_surfaces;
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
mod pair_shards;
pub(crate) mod pairs;
mod pcd;
mod pcd_header;
mod pcd_viewpoint;
mod ply;
pub(crate) mod pose_graphs;
pub(crate) mod poses;
mod ptx;
mod scalar;
mod scan_file;
mod scanner;
mod scans;
mod text;
mod text_columns;
pub(crate) mod trajectories;
mod unpack_limit;
mod vertices;
pub(crate) mod write_dataset;
mod write_e57;
mod write_las;
mod write_pcd;
mod write_ply;

pub use blocks::{BLOCK_POINTS, Held, PointBlocks, Summary, TakeBlock, move_block, open_blocks};
pub use cloud::{read_cloud, read_file};
pub use dataset::{Benchmark, Scene, read_benchmark, read_scene};
pub use depth::{
    CameraMatrix, StoredDepth, UNITS_PER_M, find_intrinsics, read_depth_png, read_frame, read_intrinsics,
};
pub use discover::{Discovered, FoundFile, LeftOut, discover, discover_with, scan_files};
pub use features::{
    holds_features, holds_these_features, read_features, read_features_with, read_sghr_features,
    read_sghr_scan, write_features,
};
pub use initial_poses::read_initial_poses;
pub use merged::{merged_run, read_merged};
pub use named_file::check_named_scan;
pub use overlaps::read_overlaps;
pub use pair_shards::{
    PairShard, PairShardHeader, ShardHypothesis, ShardPair, pair_shard_name, pair_shard_of_name,
    read_pair_shard, write_pair_shard,
};
pub use pairs::{Pairs, read_pairs, write_pairs};
pub use pose_graphs::{GraphEdge, GraphNode, PoseGraphFile, write_g2o, write_open3d_pose_graph};
pub use poses::{
    InfoEntry, LogEntry, ORTHONORMAL_TOLERANCE, Repaired, read_conf, read_info, read_kitti, read_log,
    read_matrix, read_tum, write_info, write_kitti, write_log, write_log_trajectory, write_tum,
};
pub use scan_file::{Note, ReadOptions, ScanFile, StoredScan, unit_m};
pub use scans::{Inputs, read_inputs, read_scans, read_scans_with, unique_names};
pub use text_columns::TextColumns;
pub use trajectories::{
    PlacedScan, TRAJECTORY_CSV_HEAD, trajectory_names_file, write_csv_trajectory, write_images_trajectory,
    write_kitti_trajectory, write_tum_trajectory,
};
pub use write_dataset::{SceneWriter, write_benchmark, write_overlaps};
pub use write_e57::{E57Scan, write_e57};
pub use write_las::write_las;
pub use write_pcd::write_pcd;
pub use write_ply::{PlyCloud, write_ply, write_ply_blocks};
