//! Pairs of patches of one place seen in two scans.

use super::TrainConfig;
use crate::descriptor::mini_spin_net::{MOST_POINTS, Patch, PatchSource, in_patch_order};
use crate::geometry::PointMover;
use crate::geometry::{Point, RigidMotion};
use crate::geometry::{PointIndex, RadiusGrid};
use crate::scan::Surface;
use rand::seq::{IndexedRandom, SliceRandom};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// A thinned scan whose pose is known.
#[derive(Debug, Clone)]
pub struct PosedSurface {
    /// Its surface.
    pub surface: Surface,
    /// Its true pose.
    pub world_from_scan: RigidMotion,
}

/// Lengths of a scene.
#[derive(Debug, Clone, Copy)]
pub struct PairLengths {
    /// Patch radius, metres.
    pub radius_m: f32,
    /// Farthest counterpart of a keypoint, metres.
    pub match_m: f32,
}

/// One place, seen from two scans.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchPair {
    /// Points of both patches, each in its keypoint's frame; the radius is 1.
    pub points: [Vec<[f32; 3]>; 2],
    /// The place in the world, in patch radii.
    pub place: [f32; 3],
}

/// Pairs of one scene.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PairScene {
    /// Its name.
    pub name: String,
    /// Its pairs.
    pub pairs: Vec<PatchPair>,
}

/// Least inner product of the normals of counterparts: another side of a wall is another place.
const LEAST_NORMAL_PRODUCT: f32 = 0.7;
/// Root mean square height above the plane, in patch radii, below which a patch is flat.
const FLAT: f32 = 0.06;
/// Scans that a keypoint's counterpart is looked for in.
const TRIES: usize = 4;

/// Up to `config.pairs_per_scene` pairs of a scene, spread over its scans.
pub fn extract(scans: &[PosedSurface], lengths: PairLengths, config: &TrainConfig) -> Vec<PatchPair> {
    let per_scan = config.pairs_per_scene.div_ceil(scans.len().max(1));
    let ordered: Vec<Vec<Point>> =
        scans.iter().map(|s| in_patch_order(&s.surface.points, config.seed)).collect();
    let sources: Vec<PatchSource<'_>> = scans
        .iter()
        .zip(&ordered)
        .map(|(s, points)| PatchSource::new(points, s.surface.viewpoint, lengths.radius_m))
        .collect();
    let grids: Vec<RadiusGrid<'_>> =
        scans.iter().map(|s| RadiusGrid::new(&s.surface.points, lengths.match_m)).collect();
    let indices: Vec<PointIndex> = scans.par_iter().map(|s| PointIndex::new(&s.surface.points)).collect();
    let finder = Finder { scans, sources: &sources, grids: &grids, indices: &indices, lengths, config };
    (0..scans.len()).into_par_iter().flat_map_iter(|scan| finder.of_scan(scan, per_scan)).collect()
}

struct Finder<'a> {
    scans: &'a [PosedSurface],
    sources: &'a [PatchSource<'a>],
    grids: &'a [RadiusGrid<'a>],
    indices: &'a [PointIndex],
    lengths: PairLengths,
    config: &'a TrainConfig,
}

impl Finder<'_> {
    fn of_scan(&self, scan: usize, count: usize) -> Vec<PatchPair> {
        let own = &self.scans[scan];
        let mut rng = ChaCha8Rng::seed_from_u64(self.config.seed);
        rng.set_stream(scan as u64);
        // More than needed: some have no counterpart, some are flat.
        let mut rows = crate::descriptor::choose_keypoints(&own.surface, 6 * count, self.config.seed);
        rows.shuffle(&mut rng);
        let mut others: Vec<usize> = (0..self.scans.len()).filter(|&i| i != scan).collect();
        let to_world = PointMover::new(&own.world_from_scan);
        let (mut nearby, mut found) = (Vec::new(), Vec::new());
        let (mut patch, mut counterpart) = (Patch::default(), Patch::default());
        for row in rows {
            if found.len() == count {
                break;
            }
            others.shuffle(&mut rng);
            let keypoint = own.surface.points[row];
            let Some((other, match_row)) = self.counterpart(scan, row, &others, &mut rng) else { continue };
            if !self.sources[scan].gather(&keypoint, &mut nearby, &mut patch)
                || (is_flat(&patch) && rng.random_range(0.0..1.0) >= self.config.flat_share)
            {
                continue;
            }
            let there = self.scans[other].surface.points[match_row];
            if self.sources[other].gather(&there, &mut nearby, &mut counterpart) {
                let place = to_world.point(&keypoint).coords / self.lengths.radius_m;
                found.push(PatchPair { points: [points(&patch), points(&counterpart)], place: place.into() });
            }
        }
        found
    }

    /// Scan and row of a surface point, of the same side, in one of the other scans: one of those
    /// around the place that are within `config.keypoint_offset`, because keypoints of two scans
    /// never fall on the same spot.
    fn counterpart(
        &self,
        scan: usize,
        row: usize,
        others: &[usize],
        rng: &mut ChaCha8Rng,
    ) -> Option<(usize, usize)> {
        let own = &self.scans[scan];
        let offset_m = self.config.keypoint_offset as f32 * self.lengths.radius_m;
        let mut tries = 0;
        for &other in others {
            let there = &self.scans[other];
            let motion = there.world_from_scan.inverse() * own.world_from_scan;
            let moved = PointMover::new(&motion).point(&own.surface.points[row]);
            let Some((at, _)) = self.grids[other].nearest(&moved) else { continue };
            let normal = (motion.rotation * own.surface.normals[row].cast::<f64>()).cast::<f32>();
            let same_side = |at: usize| normal.dot(&there.surface.normals[at]) >= LEAST_NORMAL_PRODUCT;
            if same_side(at) {
                let around = self.indices[other].within(&moved, offset_m);
                let around: Vec<usize> =
                    around.into_iter().map(|(at, _)| at).filter(|&a| same_side(a)).collect();
                return Some((other, *around.choose(rng).unwrap_or(&at)));
            }
            tries += 1;
            if tries == TRIES {
                break;
            }
        }
        None
    }
}

fn points(patch: &Patch) -> Vec<[f32; 3]> {
    (0..patch.count.min(MOST_POINTS)).map(|i| [patch.x[i], patch.y[i], patch.z[i]]).collect()
}

fn is_flat(patch: &Patch) -> bool {
    let z = &patch.z[..patch.count];
    let n = patch.count.max(1) as f32;
    let mean = z.iter().sum::<f32>() / n;
    let square = z.iter().map(|z| (z - mean).powi(2)).sum::<f32>() / n;
    square.sqrt() < FLAT
}
