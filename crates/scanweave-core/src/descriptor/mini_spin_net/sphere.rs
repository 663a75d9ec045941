//! The spherical grid around a keypoint and the points near each of its cells.

use super::patch::Patch;
use super::{AZIMUTHS, ELEVATIONS, RADII};
use std::f64::consts::PI;

/// Points that a cell looks at, at most.
pub const NEIGHBOURS: usize = 10;
/// Distance within which a point belongs to a cell, in patch radii.
const CELL_RADIUS: f32 = 0.8 / RADII as f32;
/// Cells of all shells.
pub const CELLS: usize = RADII * ELEVATIONS * AZIMUTHS;
/// Points compared at once.
const LANES: usize = 16;

/// Centres of the cells, in patch radii.
#[derive(Debug, Clone)]
pub struct Sphere {
    /// `[radius][elevation][azimuth]`: distance (r + ½)/3, polar angle π/7·(e + ½) from the axis,
    /// azimuth 2π/20·(a + ½).
    centres: Vec<[f32; 3]>,
    /// Cosine and sine of each azimuth index times 2π/20.
    turns: [(f32, f32); AZIMUTHS],
}

impl Default for Sphere {
    fn default() -> Self {
        let centre = |cell: usize| {
            let (radius, elevation, azimuth) = place(cell);
            let distance = (radius as f64 + 0.5) / RADII as f64;
            let polar = PI / ELEVATIONS as f64 * (elevation as f64 + 0.5);
            let angle = 2.0 * PI / AZIMUTHS as f64 * (azimuth as f64 + 0.5);
            let (sin, cos) = polar.sin_cos();
            [distance * sin * angle.cos(), distance * sin * angle.sin(), distance * cos].map(|v| v as f32)
        };
        let turn = |azimuth: usize| {
            let (sin, cos) = (2.0 * PI / AZIMUTHS as f64 * azimuth as f64).sin_cos();
            (cos as f32, sin as f32)
        };
        Self { centres: (0..CELLS).map(centre).collect(), turns: std::array::from_fn(turn) }
    }
}

/// Radius, elevation and azimuth index of a cell.
fn place(cell: usize) -> (usize, usize, usize) {
    (cell / (ELEVATIONS * AZIMUTHS), cell / AZIMUTHS % ELEVATIONS, cell % AZIMUTHS)
}

impl Sphere {
    /// The first points of the patch near a cell, turned about the axis so that every azimuth
    /// sees its surroundings alike; their number is the second value.
    ///
    /// Points are relative to the keypoint, not to the cell, as in the published network.
    #[inline(always)]
    pub fn neighbours(&self, patch: &Patch, cell: usize) -> ([[f32; 3]; NEIGHBOURS], usize) {
        let [cx, cy, cz] = self.centres[cell];
        let (cos, sin) = self.turns[cell % AZIMUTHS];
        let mut found = [[0.0; 3]; NEIGHBOURS];
        let mut count = 0;
        let blocks = patch.x.as_chunks::<LANES>().0.iter().zip(patch.y.as_chunks::<LANES>().0);
        for ((x, y), z) in blocks.zip(patch.z.as_chunks::<LANES>().0).take(patch.count.div_ceil(LANES)) {
            let mut near = 0u32;
            for lane in 0..LANES {
                let (dx, dy, dz) = (x[lane] - cx, y[lane] - cy, z[lane] - cz);
                let inside = dx * dx + dy * dy + dz * dz < CELL_RADIUS * CELL_RADIUS;
                near |= u32::from(inside) << lane;
            }
            while near != 0 {
                let lane = near.trailing_zeros() as usize % LANES;
                near &= near - 1;
                // By minus the azimuth's angle.
                found[count] = [cos * x[lane] + sin * y[lane], cos * y[lane] - sin * x[lane], z[lane]];
                count += 1;
                if count == NEIGHBOURS {
                    return (found, count);
                }
            }
        }
        (found, count)
    }
}
