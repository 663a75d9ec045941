//! A scan thinned to the working resolution, with normals.

use crate::geometry::{Direction, Point};

/// Points of one scan at the working voxel size with unit normals turned to the viewpoint.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Surface {
    /// `[n,3]`, metres, in the scan's frame.
    pub points: Vec<Point>,
    /// `[n,3]` unit normals; the zero vector where the neighbourhood fixes none.
    pub normals: Vec<Direction>,
    /// Where the sensor stood, or can have stood, in the scan's frame.
    pub viewpoint: Point,
    /// Share of the surface that is hidden from there, in `[0, 1]`.
    pub hidden_share: f32,
    /// `[n]` brightness of each point in `[0, 1]`; empty where the scan has no colour.
    pub intensities: Vec<f32>,
}

impl Surface {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// True when there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}
