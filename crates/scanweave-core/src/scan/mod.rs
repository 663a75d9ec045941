//! The types that flow between stages.

pub(crate) mod assemble;
mod cloud;
mod depth;
mod features;
mod pose_graph;
mod reconstruction;
mod similarity;
pub(crate) mod strays;
mod surface;
mod truth;
mod working_scale;

pub use cloud::{PointCloud, Scan, ScanId};
pub use depth::{DepthImage, Intrinsics};
pub use features::{Descriptors, Features};
pub use pose_graph::{PairKey, PairRegistration, PoseEdge, PoseGraph};
pub use reconstruction::{
    DeclineReason, Doubt, Evidence, NeighbourEvidence, Outcome, Placement, PoseUncertainty, Reconstruction,
    ScanEdge,
};
pub use similarity::SimilarityMatrix;
pub use strays::{STRAY, middle_and_size};
pub use surface::Surface;
pub use truth::PairTruth;
pub use working_scale::WorkingScale;
pub(crate) use working_scale::{length, rounded};
