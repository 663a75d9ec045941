//! Keypoints spread evenly over a surface.

use crate::error::{Error, Result};
use crate::geometry::occupancy::size_for_occupancy;
use crate::geometry::voxel::VoxelGroups;
use crate::geometry::{Direction, Point};
use crate::scan::{Features, Surface};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How many keypoints a scan gets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct KeypointConfig {
    /// Keypoints a scan; a scan with fewer usable points gives all of them.
    pub count: usize,
}

impl Default for KeypointConfig {
    fn default() -> Self {
        Self { count: 2500 }
    }
}

impl KeypointConfig {
    /// So many keypoints a scan.
    pub fn new(count: usize) -> Self {
        Self { count }
    }

    /// Checks the count.
    ///
    /// # Errors
    /// [`Error::Setting`] when it is below three, the fewest that fix a pose.
    pub fn validate(&self) -> Result<()> {
        if self.count < 3 {
            return Err(Error::setting(
                "descriptor.keypoints.count",
                self.count.to_string(),
                "at least 3",
                "leave it out for the default of 2500",
            ));
        }
        Ok(())
    }
}

/// Streams of the seed, so that the choice of keypoints and of their subsamples differ.
const CHOICE_STREAM: u64 = 0x6b65_7970;
const SUBSAMPLE_STREAM: u64 = 0x7375_6273;

fn generator(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    rng
}

/// Indices of up to `count` surface points with a normal, ascending: one at random in
/// every cell of a grid that has about `count` occupied cells, then chance drops or adds
/// what is missing to `count`.
///
/// The result depends on the surface, `count` and `seed` alone, not on the scan's place in
/// the input, so that cached features stay valid when scans are added.
pub fn choose(surface: &Surface, count: usize, seed: u64) -> Vec<usize> {
    let usable: Vec<usize> =
        (0..surface.len()).filter(|&i| surface.normals[i] != Direction::zeros()).collect();
    if usable.len() <= count {
        return usable;
    }
    let points: Vec<Point> = usable.iter().map(|&i| surface.points[i]).collect();
    let mut rng = generator(seed, CHOICE_STREAM);
    let cell_m = size_for_occupancy(&points, count, first_guess(&points, count));
    let mut order = Vec::with_capacity(points.len());
    let mut rest = Vec::new();
    for cell in VoxelGroups::new(&points, cell_m as f32).iter() {
        let pick = rng.random_range(0..cell.len());
        for (at, &i) in cell.iter().enumerate() {
            if at == pick { order.push(i) } else { rest.push(i) }
        }
    }
    order.shuffle(&mut rng);
    if order.len() < count {
        let missing = count - order.len();
        order.extend_from_slice(rest.partial_shuffle(&mut rng, missing).0);
    }
    order.truncate(count);
    let mut chosen: Vec<usize> = order.into_iter().map(|i| usable[i as usize]).collect();
    chosen.sort_unstable();
    chosen
}

/// Cell size that would fit if the points covered the diagonal of their box as a square.
fn first_guess(points: &[Point], count: usize) -> f64 {
    let corner = |pick: fn(f32, f32) -> f32| {
        points
            .iter()
            .skip(1)
            .fold(points[0], |c, p| Point::new(pick(c.x, p.x), pick(c.y, p.y), pick(c.z, p.z)))
    };
    let diagonal = f64::from((corner(f32::max) - corner(f32::min)).norm());
    (diagonal / (count as f64).sqrt()).max(f64::MIN_POSITIVE)
}

/// A seeded random subsample of `count` of the keypoints, in their order; everything when
/// there are no more. Smaller samples of the same seed are parts of larger ones.
pub fn subsample(features: &Features, count: usize, seed: u64) -> Features {
    if features.len() <= count {
        return features.clone();
    }
    let mut rows: Vec<usize> = (0..features.len()).collect();
    rows.shuffle(&mut generator(seed, SUBSAMPLE_STREAM));
    rows.truncate(count);
    rows.sort_unstable();
    features.select(&rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Descriptors;
    use std::collections::BTreeSet;

    /// A 2 m × 1 m sheet, one half sampled sixteen times as densely as the other.
    fn uneven() -> Surface {
        let mut points = Vec::new();
        for (x0, n) in [(0.0f32, 160usize), (1.0, 40)] {
            let step = 1.0 / n as f32;
            points.extend(
                (0..n * n).map(|i| {
                    Point::new(x0 + (0.5 + (i % n) as f32) * step, (0.5 + (i / n) as f32) * step, 0.0)
                }),
            );
        }
        let normals = vec![Direction::z(); points.len()];
        Surface { points, normals, ..Surface::default() }
    }

    #[test]
    fn keypoints_spread_over_area_not_over_points() {
        let surface = uneven();
        let chosen = choose(&surface, 800, 7);
        assert_eq!(chosen.len(), 800);
        assert_eq!(chosen.iter().collect::<BTreeSet<_>>().len(), 800);
        let sparse = chosen.iter().filter(|&&i| surface.points[i].x > 1.0).count();
        // By area 400; choosing among points alone would give 800/17 = 47.
        assert!((340..=460).contains(&sparse), "{sparse}");
    }

    #[test]
    fn the_seed_decides_and_nothing_else() {
        let surface = uneven();
        assert_eq!(choose(&surface, 500, 3), choose(&surface, 500, 3));
        assert_ne!(choose(&surface, 500, 3), choose(&surface, 500, 4));
    }

    #[test]
    fn points_without_a_normal_are_skipped() {
        let mut surface = uneven();
        for i in 0..surface.len() / 2 {
            surface.normals[i] = Direction::zeros();
        }
        let usable = surface.len() - surface.len() / 2;
        assert!(choose(&surface, 300, 1).iter().all(|&i| i >= surface.len() / 2));
        assert_eq!(choose(&surface, 1_000_000, 1).len(), usable);
        assert!(choose(&Surface::default(), 10, 1).is_empty());
    }

    #[test]
    fn subsamples_of_one_seed_are_nested_and_keep_rows_together() {
        let keypoints: Vec<Point> = (0..100).map(|i| Point::new(i as f32, 0.0, 0.0)).collect();
        let rows = (0..100).flat_map(|i| [i as f32, -(i as f32)]).collect();
        let features = Features::new(keypoints, None, Descriptors::new(2, rows).unwrap()).unwrap();
        let (large, small) = (subsample(&features, 50, 9), subsample(&features, 10, 9));
        assert_eq!((large.len(), small.len()), (50, 10));
        for i in 0..large.len() {
            assert_eq!(large.descriptors.row(i), [large.keypoints[i].x, -large.keypoints[i].x]);
        }
        assert!(small.keypoints.iter().all(|p| large.keypoints.contains(p)));
        assert_eq!(subsample(&features, 100, 9), features);
    }
}
