//! Registration of two scans with each other.

pub(super) mod config;
pub(crate) mod correspondences;
pub(crate) mod edge;
pub(crate) mod estimate;
pub(crate) mod matching;
pub(crate) mod nearest;
pub(crate) mod registrar;
