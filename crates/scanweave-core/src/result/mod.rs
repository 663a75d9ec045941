//! The files of a registration: poses, merged clouds, overlap, report.

mod check;
pub mod identity;
pub mod merged;
pub mod overlaps;
pub mod pose_graph;
pub mod poses;
pub mod run;
pub mod scans;
pub mod trajectory;
