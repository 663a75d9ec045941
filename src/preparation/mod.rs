//! From a user's posed scans and depth camera walks to data sets: fragments fused from depth
//! images, samples of a walk whose order is forgotten, and the ground truth of benchmarks.
//!
//! Everything written is in the layouts that [`crate::io::read_scene`] reads.

pub(crate) mod fragments;
pub(crate) mod sample;
pub(crate) mod truth;

pub use fragments::{Fragment, FragmentConfig, Notes, fuse, write_fragments};
pub use sample::{SampleConfig, write_sample};
pub use truth::{GroundTruth, OVERLAP_RADIUS_VOXELS, TruthConfig};
