//! The surface in a volume: where the signed distance is zero.

use super::volume::{Block, Cell, EDGE, Volume, Voxel, center};
use crate::geometry::{Direction, Point};
use rayon::prelude::*;

/// Points on a fused surface.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FusedSurface {
    /// `[n,3]`, metres, in the frame of the volume.
    pub points: Vec<Point>,
    /// `[n,3]` unit normals, towards the side the cameras were on.
    pub normals: Vec<Direction>,
}

impl Volume {
    /// At most one point a voxel: the mean of the zero crossings on the edges from its centre to
    /// the next centres along x, y and z, each placed by linear interpolation (the vertices
    /// marching cubes would have there). Ordered by block, then by voxel.
    ///
    /// Only distances that were not cut off count, so that no surface appears between what is
    /// known to be free and what is hidden far behind.
    pub fn surface(&self) -> FusedSurface {
        let mut order: Vec<&Block> = self.blocks.iter().collect();
        order.sort_unstable_by_key(|b| b.cell);
        let parts: Vec<Vec<(Point, Direction)>> = order.par_iter().map(|b| self.surface_of(b)).collect();
        let (points, normals) = parts.into_iter().flatten().unzip();
        FusedSurface { points, normals }
    }

    fn surface_of(&self, block: &Block) -> Vec<(Point, Direction)> {
        let mut found = Vec::new();
        let corner = block.cell.map(|c| c * EDGE);
        for x in 0..EDGE {
            for y in 0..EDGE {
                for z in 0..EDGE {
                    let at = [corner[0] + x, corner[1] + y, corner[2] + z];
                    found.extend(self.point_at(block, at));
                }
            }
        }
        found
    }

    fn point_at(&self, block: &Block, at: Cell) -> Option<(Point, Direction)> {
        let known = |at: Cell| self.voxel(block, at).filter(|v| v.distance.abs() < 1.0);
        let here = known(at)?;
        let enough = self.config.min_observations as f32;
        let voxel_m = self.config.voxel_m as f32;
        let (mut offset, mut normal, mut crossings) = (Direction::zeros(), Direction::zeros(), 0.0f32);
        for axis in 0..3 {
            let mut next = at;
            next[axis] += 1;
            let crosses = |v: &Voxel| (v.distance > 0.0) != (here.distance > 0.0);
            let Some(there) = known(next).filter(crosses) else { continue };
            // The one before the surface has a weight of one an image.
            if here.weight.max(there.weight) < enough {
                continue;
            }
            let share = here.distance / (here.distance - there.distance);
            offset[axis] += share * voxel_m;
            normal += self.slope(block, at) * (1.0 - share) + self.slope(block, next) * share;
            crossings += 1.0;
        }
        let normal = normal.try_normalize(0.0)?;
        Some((center(at, voxel_m) + offset / crossings, normal))
    }

    /// Gradient of the distance at a voxel from the neighbours that are known; its scale has no
    /// meaning.
    fn slope(&self, block: &Block, at: Cell) -> Direction {
        let distance = |at: Cell| self.voxel(block, at).map(|v| v.distance);
        let Some(here) = distance(at) else { return Direction::zeros() };
        Direction::from_fn(|axis, _| {
            let beside = |step: i32| {
                let mut next = at;
                next[axis] += step;
                distance(next)
            };
            match (beside(-1), beside(1)) {
                (Some(before), Some(after)) => 0.5 * (after - before),
                (Some(before), None) => here - before,
                (None, Some(after)) => after - here,
                (None, None) => 0.0,
            }
        })
    }
}
