//! MiniSpinNet: a learned local descriptor of 32 numbers.
//!
//! Ao, Hu, Wang, Xu, Guo, "BUFFER: Balancing accuracy, efficiency, and generalizability in point
//! cloud registration", CVPR 2023, after Ao, Hu, Yang, Markham, Guo, "SpinNet: Learning a general
//! surface descriptor for 3D point cloud registration", CVPR 2021,
//! <https://arxiv.org/abs/2011.12149>.
//!
//! ```text
//! points ─ patch ─▶ at most 512 in the keypoint's frame ─ sphere ─▶ at most 10 in each of 3×7×20 cells
//!   ─ point layer, maximum ─▶ [16, 3, 7, 20] ─ eight 3×3 convolutions ─▶ [32, 7, 20]
//!   ─ attention, mean over the cells, unit length ─▶ [32]
//! ```
//!
//! That is the published network; the built-in one has six convolutions of 32 channels.
//!
//! The frame's z axis is the direction of least spread within half the patch radius, turned to the
//! scan's viewpoint; turns about it go round in azimuth, which convolutions and mean do not see.
//! Where the published network learns that axis, this is fixed. The first convolution is 3×3×3
//! there and collapses the radius; here the three shells are channels, which is the same sum.
//!
//! The published radius is 0.3 m for clouds of one point every 2.5 cm. Here it is the feature
//! radius of the working scale, 12 voxels: the same for such clouds, and for an object of 25 cm or
//! a facade of 50 m what the network would see had they been scaled to a room.

mod checkpoint;
mod inference;
mod patch;
mod product;
mod sphere;
mod weights;
mod winograd;

pub use checkpoint::{Checkpoint, DESCRIPTOR, FORMAT_VERSION, LoadedNetwork, Meta, shipped};
pub use inference::{Network, Workspace};
pub use patch::{MOST_POINTS, Patch, PatchSource, in_patch_order};
pub use product::GROUP;
pub use sphere::{CELLS, NEIGHBOURS, Sphere};
pub use weights::{Architecture, Layer, LayerShape, Norm, Weights};

use crate::geometry::Point;
use rayon::prelude::*;

/// Shells of the spherical grid.
pub const RADII: usize = 3;
/// Cells of a meridian.
pub const ELEVATIONS: usize = 7;
/// Cells of a parallel.
pub const AZIMUTHS: usize = 20;

/// Keypoints handled by one task.
const CHUNK: usize = 64;
/// Patches that go through the network together: few enough to stay in the second-level cache.
const BATCH: usize = 2;

/// Unit descriptors `[n · D]` of `keypoints` `[n]` on the surface that `points` sample, seen from
/// `viewpoint`: patches of `radius_m`, the order of points within them by `seed`.
///
/// A keypoint whose surroundings fix no axis (fewer than three points, or all on one line) has a
/// row of zeros, and so has one, on a perfect plane say, where the network attends to no cell.
pub fn descriptors(
    network: &Network,
    points: &[Point],
    viewpoint: &Point,
    keypoints: &[Point],
    radius_m: f32,
    seed: u64,
) -> Vec<f32> {
    let points = in_patch_order(points, seed);
    let source = PatchSource::new(&points, *viewpoint, radius_m);
    let dim = network.dim();
    let mut values = vec![0.0; keypoints.len() * dim];
    values.par_chunks_mut(CHUNK * dim).zip(keypoints.par_chunks(CHUNK)).for_each_init(
        || (Workspace::default(), vec![Patch::default(); BATCH], Vec::new()),
        |(workspace, patches, nearby), (values, keypoints)| {
            for (values, keypoints) in values.chunks_mut(BATCH * dim).zip(keypoints.chunks(BATCH)) {
                let mut found = [false; BATCH];
                for ((keypoint, patch), found) in keypoints.iter().zip(patches.iter_mut()).zip(&mut found) {
                    *found = source.gather(keypoint, nearby, patch);
                }
                network.describe(&patches[..keypoints.len()], workspace, values);
                for (row, found) in values.chunks_exact_mut(dim).zip(found) {
                    if !found {
                        row.fill(0.0);
                    }
                }
            }
        },
    );
    values
}

#[cfg(test)]
mod tests;
