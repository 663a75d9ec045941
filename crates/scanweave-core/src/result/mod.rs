//! The files of a registration: poses, merged clouds, overlap, report.

mod check;
mod identity;
mod merged;
mod overlaps;
mod pose_graph;
mod poses;
mod run;
mod scans;
mod trajectory;

pub use identity::{
    PAGE_MARK, RunIdentity, check_folder, check_pages, check_report, digests_of_files, run_id,
};
pub use merged::{MergedCloud, points_of_scans};
pub use overlaps::{read_predicted_overlaps, ten_thousandths, write_overlaps_csv};
pub use pose_graph::pose_graph_of_component;
pub use poses::{Component, Document, Entry, EntryOutcome, POSES_FORMAT, POSES_VERSION, Pose};
pub use run::{Row, RunReport, ScanSize, StageTime, peak_memory_bytes, reset_peak_memory, rows};
pub use scans::{Exported, ScanFormat, export_scans};
pub use trajectory::{placed_scans, scan_names};
