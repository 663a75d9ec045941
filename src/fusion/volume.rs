//! A truncated signed distance field in sparse blocks.

use super::FusionConfig;
use crate::geometry::PointMover;
use crate::geometry::{Direction, Point, RigidMotion};
use crate::scan::DepthImage;
use crate::{Error, Result};
use rayon::prelude::*;
use std::collections::HashMap;

/// Voxels along the edge of a block.
pub(super) const EDGE: i32 = 8;
const VOXELS: usize = (EDGE * EDGE * EDGE) as usize;

/// Position of a block, or of a voxel, on its grid.
pub(super) type Cell = [i32; 3];

/// Weighted mean distance at the centre of a voxel along the lines of sight through it.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Voxel {
    /// Truncated to [−1, 1] and in units of the truncation; positive on the camera's side.
    pub distance: f32,
    /// Sum of the images' weights: the number of them, for what lies before the surface.
    pub weight: f32,
}

#[derive(Debug)]
pub(super) struct Block {
    pub cell: Cell,
    pub voxels: Box<[Voxel]>,
}

/// Signed distances to the surface that a set of depth images shows, in a frame of the caller's
/// choice.
///
/// Blocks are made in an order that follows from the images alone and every voxel belongs to one
/// task, so the result does not depend on the number of threads.
#[derive(Debug)]
pub struct Volume {
    pub(super) config: FusionConfig,
    pub(super) blocks: Vec<Block>,
    /// Place of every block in `blocks`.
    places: HashMap<Cell, u32>,
}

impl Volume {
    /// An empty volume.
    ///
    /// # Errors
    /// [`Error::Setting`] for settings that cannot be used.
    pub fn new(config: &FusionConfig) -> Result<Self> {
        config.validate()?;
        Ok(Self { config: config.clone(), blocks: Vec::new(), places: HashMap::new() })
    }

    /// Averages an image into the volume: d = (z(u,v) − z)/truncation for every voxel centre at
    /// depth z that projects to (u,v), at most 1, and nothing below −1 (hidden by the surface).
    ///
    /// The weight is 1 up to a voxel behind the surface and falls to 0 at the truncation (Bylow et
    /// al. 2013, linear weight): what is hidden from one image may be free for all it knows, and must
    /// not outweigh another image that saw through it, or thin things grow shadows.
    ///
    /// # Errors
    /// [`Error::Setting`] when the surfaces seen take more than the memory allowed.
    pub fn integrate(&mut self, image: &DepthImage, volume_from_camera: &RigidMotion) -> Result<()> {
        let view = View::new(image, &self.config);
        self.add_blocks(&view.blocks(volume_from_camera, &self.config))?;
        let voxel_m = self.config.voxel_m as f32;
        let camera = PointMover::new(&volume_from_camera.inverse());
        let steps =
            [Direction::x(), Direction::y(), Direction::z()].map(|a| camera.direction(&(a * voxel_m)));
        self.blocks.par_iter_mut().for_each(|block| {
            let corner = camera.point(&center(block.cell.map(|c| c * EDGE), voxel_m));
            if view.may_see(&corner, &steps) {
                view.observe(&mut block.voxels, &corner, &steps);
            }
        });
        Ok(())
    }

    /// Number of voxels that exist.
    pub fn voxels(&self) -> usize {
        self.blocks.len() * VOXELS
    }

    fn add_blocks(&mut self, sorted: &[Cell]) -> Result<()> {
        let limit = self.config.memory_mib * (1 << 20) / (VOXELS * size_of::<Voxel>());
        for &cell in sorted {
            if self.places.contains_key(&cell) {
                continue;
            }
            if self.blocks.len() >= limit {
                return Err(Error::setting(
                    "fusion.memory_mib",
                    format!("{}, which is full", self.config.memory_mib),
                    "room for the voxels along all surfaces seen",
                    "use larger voxels, fewer frames in a fragment, a smaller max_depth_m, or allow more",
                ));
            }
            self.places.insert(cell, self.blocks.len() as u32);
            self.blocks.push(Block { cell, voxels: vec![Voxel::default(); VOXELS].into_boxed_slice() });
        }
        Ok(())
    }

    /// The voxel at `at`, where an image saw it; `block` is where it is looked for first.
    pub(super) fn voxel(&self, block: &Block, at: Cell) -> Option<Voxel> {
        let cell = at.map(|c| c.div_euclid(EDGE));
        let block =
            if cell == block.cell { block } else { self.blocks.get(*self.places.get(&cell)? as usize)? };
        let voxel = block.voxels.get(index(at.map(|c| c.rem_euclid(EDGE))))?;
        (voxel.weight > 0.0).then_some(*voxel)
    }
}

/// Place of a voxel in its block: x runs slowest.
fn index([x, y, z]: Cell) -> usize {
    ((x * EDGE + y) * EDGE + z) as usize
}

/// Centre of a voxel.
pub(super) fn center(voxel: Cell, voxel_m: f32) -> Point {
    let [x, y, z] = voxel.map(|c| (c as f32 + 0.5) * voxel_m);
    Point::new(x, y, z)
}

/// A depth image as the volume looks at it.
struct View<'a> {
    image: &'a DepthImage,
    /// 1/z of every pixel, 1/m; 0 where there is no depth within reach.
    inverse: Vec<f32>,
    focal: [f32; 2],
    middle: [f32; 2],
    truncation_m: f32,
    /// Slope of the weight behind the surface: it is 1 a voxel behind, 0 at the truncation.
    falloff: f32,
    farthest_m: f32,
}

impl<'a> View<'a> {
    fn new(image: &'a DepthImage, config: &FusionConfig) -> Self {
        let k = image.intrinsics;
        let (max_depth_m, truncation_m) = (config.max_depth_m as f32, config.truncation_m as f32);
        let inverse = |z: &f32| if *z > 0.0 && *z <= max_depth_m { 1.0 / z } else { 0.0 };
        Self {
            image,
            inverse: image.depth_m.iter().map(inverse).collect(),
            focal: [k.fx as f32, k.fy as f32],
            middle: [k.cx as f32, k.cy as f32],
            truncation_m,
            falloff: truncation_m / (truncation_m - config.voxel_m as f32),
            farthest_m: max_depth_m + truncation_m,
        }
    }

    /// Blocks within the truncation of the surface along the line of sight of a pixel, sorted.
    fn blocks(&self, volume_from_camera: &RigidMotion, config: &FusionConfig) -> Vec<Cell> {
        let k = self.image.intrinsics;
        let mover = PointMover::new(volume_from_camera);
        let block_m = config.voxel_m as f32 * EDGE as f32;
        // Half a block apart, a line of sight cannot pass through more than a corner unnoticed;
        // the voxels of that corner belong to the lines beside it.
        let samples = (4.0 * self.truncation_m / block_m).ceil().max(1.0) as usize;
        let row = |v: usize| {
            let mut cells: Vec<Cell> = Vec::new();
            for u in 0..k.width {
                let z = self.inverse[v * k.width + u].recip();
                if !z.is_finite() {
                    continue;
                }
                let ray = k.ray(u as f64, v as f64).cast::<f32>();
                for s in 0..=samples {
                    let offset = self.truncation_m * (2.0 * s as f32 / samples as f32 - 1.0);
                    let p = mover.point(&Point::from(ray * (z + offset)));
                    cells.push([p.x, p.y, p.z].map(|c| (c / block_m).floor() as i32));
                }
            }
            cells.sort_unstable();
            cells.dedup();
            cells
        };
        let mut cells: Vec<Cell> = (0..k.height).into_par_iter().flat_map_iter(row).collect();
        cells.par_sort_unstable();
        cells.dedup();
        cells
    }

    /// Whether a block may lie in front of the camera and in the image; `corner` is its first
    /// voxel, `steps` lead to the next along each axis, all in the camera's frame.
    fn may_see(&self, corner: &Point, steps: &[Direction; 3]) -> bool {
        let half = 0.5 * (EDGE - 1) as f32;
        let middle = corner + (steps[0] + steps[1] + steps[2]) * half;
        let radius = half * steps.iter().map(|s| s.norm_squared()).sum::<f32>().sqrt();
        if middle.z + radius <= 0.0 || middle.z - radius > self.farthest_m {
            return false;
        }
        if middle.z <= radius {
            return true;
        }
        // Slopes of the planes through the image's borders; a sphere is outside one of them when
        // its centre is farther from it than its radius.
        let size = [self.image.intrinsics.width, self.image.intrinsics.height];
        (0..2).all(|a| {
            let (f, c) = (self.focal[a], self.middle[a]);
            let (low, high) = ((-0.5 - c) / f, (size[a] as f32 - 0.5 - c) / f);
            let beyond = |slope: f32, sign: f32| {
                sign * (middle[a] - slope * middle.z) > radius * (1.0 + slope * slope).sqrt()
            };
            !beyond(low, -1.0) && !beyond(high, 1.0)
        })
    }

    fn observe(&self, voxels: &mut [Voxel], corner: &Point, steps: &[Direction; 3]) {
        let rows = voxels.chunks_exact_mut(EDGE as usize).enumerate();
        for (row, voxels) in rows {
            let (x, y) = (row / EDGE as usize, row % EDGE as usize);
            let start = corner + steps[0] * x as f32 + steps[1] * y as f32;
            for (z, voxel) in voxels.iter_mut().enumerate() {
                let p = start + steps[2] * z as f32;
                let Some(depth) = self.depth_towards(&p) else { continue };
                let distance = (depth - p.z) / self.truncation_m;
                let weight = ((1.0 + distance) * self.falloff).min(1.0);
                if weight > 0.0 {
                    let sum = voxel.weight + weight;
                    voxel.distance = (voxel.distance * voxel.weight + distance.min(1.0) * weight) / sum;
                    voxel.weight = sum;
                }
            }
        }
    }

    /// Depth of the surface on the line of sight through `p`.
    ///
    /// Between four pixels of one surface 1/z is interpolated, which is linear in the image for a
    /// plane; at an edge, where they differ by more than the truncation, the nearest one counts.
    #[inline]
    fn depth_towards(&self, p: &Point) -> Option<f32> {
        if p.z <= 0.0 || p.z > self.farthest_m {
            return None;
        }
        let (width, height) = (self.image.intrinsics.width, self.image.intrinsics.height);
        let u = self.focal[0] * p.x / p.z + self.middle[0];
        let v = self.focal[1] * p.y / p.z + self.middle[1];
        if !(u >= -0.5 && v >= -0.5 && u < width as f32 - 0.5 && v < height as f32 - 0.5) {
            return None;
        }
        let (left, top) = (u.max(0.0) as usize, v.max(0.0) as usize);
        if left + 1 < width && top + 1 < height {
            let at = top * width + left;
            let four = [at, at + 1, at + width, at + width + 1].map(|i| self.inverse[i]);
            let (low, high) =
                (four.iter().fold(f32::MAX, |a, &b| a.min(b)), four.iter().fold(0.0f32, |a, &b| a.max(b)));
            // 1/low − 1/high ≤ truncation, without dividing by a missing depth.
            if low > 0.0 && high - low <= self.truncation_m * low * high {
                let (du, dv) = (u.max(0.0) - left as f32, v.max(0.0) - top as f32);
                let upper = four[0] + (four[1] - four[0]) * du;
                let lower = four[2] + (four[3] - four[2]) * du;
                return Some((upper + (lower - upper) * dv).recip());
            }
        }
        let nearest = (v + 0.5) as usize * width + (u + 0.5) as usize;
        self.inverse.get(nearest).filter(|&&i| i > 0.0).map(|i| i.recip())
    }
}
