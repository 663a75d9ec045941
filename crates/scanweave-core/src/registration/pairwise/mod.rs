//! Registration of two scans with each other.

pub mod correspondences;
pub mod edge;
pub mod estimate;
pub mod matching;
pub mod nearest;
