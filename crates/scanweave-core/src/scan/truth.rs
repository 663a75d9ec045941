//! Ground truth, where a data set has it.

use super::ScanId;
use crate::geometry::RigidMotion;
use nalgebra::Matrix6;

/// True relative pose of two scans, one entry of a `gt.log` (and of its `gt.info`).
#[derive(Debug, Clone, PartialEq)]
pub struct PairTruth {
    /// The scan whose frame is the target.
    pub i: ScanId,
    /// The scan whose frame is the source.
    pub j: ScanId,
    /// True pose taking coordinates of `j` to coordinates of `i`.
    pub i_from_j: RigidMotion,
    /// Information matrix of the pair over `[t; q_xyz]`, where the set has one.
    pub information: Option<Matrix6<f64>>,
}
