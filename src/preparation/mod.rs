//! From a user's posed scans and depth camera walks to data sets: fragments fused from depth
//! images, samples of a walk whose order is forgotten, and the ground truth of benchmarks.
//!
//! Everything written is in the layouts that [`crate::io::read_scene`] reads.

pub mod fragments;
pub mod sample;
pub mod truth;
