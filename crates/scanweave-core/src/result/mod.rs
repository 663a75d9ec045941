//! The files of a registration: poses, merged clouds, overlap, report.

pub mod merged;
pub mod overlaps;
pub mod poses;
pub mod run;
pub mod scans;
