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
    /// How far the shape of the scan bears that out, in `[0, 1]`.
    pub viewpoint_confidence: f32,
    /// `[n]` brightness of each point in `[0, 1]`; empty where the scan has no colour.
    pub intensities: Vec<f32>,
}

impl Surface {
    /// Whether the side that normals turn to says something: where the viewpoint is in doubt they may
    /// all, or in parts, turn to the wrong one.
    pub fn is_oriented(&self) -> bool {
        self.viewpoint_confidence >= 0.5
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// True when there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}
