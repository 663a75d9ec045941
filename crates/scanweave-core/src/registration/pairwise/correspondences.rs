//! Counting the matches that a motion explains, many at a time.

use crate::geometry::{Point, RigidMotion};
use nalgebra::Point3;

const LANES: usize = 16;

/// Matches laid out coordinate by coordinate.
#[derive(Debug, Clone)]
pub struct Correspondences {
    len: usize,
    source: [Vec<f32>; 3],
    target: [Vec<f32>; 3],
}

impl Correspondences {
    /// Lays out `source[i] ↔ target[i]` (equal lengths, finite, metres).
    pub fn new(source: &[Point], target: &[Point]) -> Self {
        let padded = source.len().next_multiple_of(LANES);
        // Padding is near nothing under any motion.
        let lay = |points: &[Point]| -> [Vec<f32>; 3] {
            std::array::from_fn(|axis| {
                let mut values: Vec<f32> = points.iter().map(|p| p[axis]).collect();
                values.resize(padded, f32::NAN);
                values
            })
        };
        Self { len: source.len(), source: lay(source), target: lay(target) }
    }

    /// Number of matches.
    pub fn len(&self) -> usize {
        self.len
    }

    /// True when there is none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Source of match `i`.
    pub fn source(&self, i: usize) -> Point3<f64> {
        Point3::new(self.source[0][i].into(), self.source[1][i].into(), self.source[2][i].into())
    }

    /// Target of match `i`.
    pub fn target(&self, i: usize) -> Point3<f64> {
        Point3::new(self.target[0][i].into(), self.target[1][i].into(), self.target[2][i].into())
    }

    /// Both ends of match `i`.
    pub fn pair(&self, i: usize) -> (Point3<f64>, Point3<f64>) {
        (self.source(i), self.target(i))
    }

    /// Number of matches that `target_from_source` brings within `radius_m`.
    pub fn count(&self, target_from_source: &RigidMotion, radius_m: f64) -> usize {
        self.count_paired(target_from_source, radius_m, &[0])
    }

    /// Number of matches that `target_from_source` would bring within `radius_m` if sources and
    /// targets were paired at random: the mean over some pairings of every source with the target
    /// of a match further on.
    pub fn count_by_chance(&self, target_from_source: &RigidMotion, radius_m: f64) -> f64 {
        /// Pairings that are counted.
        const PAIRINGS: usize = 8;
        let chunks = self.source[0].len() / LANES;
        let shifts: Vec<usize> =
            (1..=PAIRINGS).map(|k| k * chunks / (PAIRINGS + 1)).filter(|&shift| shift > 0).collect();
        self.count_paired(target_from_source, radius_m, &shifts) as f64 / shifts.len().max(1) as f64
    }

    /// Matches within the radius, over all pairings of every 16 sources with the targets of those so
    /// many sixteens further on.
    fn count_paired(&self, motion: &RigidMotion, radius_m: f64, shifts: &[usize]) -> usize {
        let len = self.source[0].len();
        let limit = (radius_m * radius_m) as f32;
        let moved = Moved::new(motion);
        let mut count = 0;
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                for start in (0..len).step_by(LANES) {
                    let moved = moved.sources(&self.source, start);
                    let mut hits = [0u32; LANES];
                    for shift in shifts {
                        let squared = self.squared_distances(&moved, (start + shift * LANES) % len);
                        for l in 0..LANES {
                            hits[l] += u32::from(squared[l] <= limit);
                        }
                    }
                    count += hits.iter().sum::<u32>() as usize;
                }
            },
        );
        count
    }

    /// Squared distances of 16 moved sources from the targets of as many matches.
    #[inline(always)]
    fn squared_distances(&self, moved: &[[f32; LANES]; 3], first: usize) -> [f32; LANES] {
        let mut squared = [0.0f32; LANES];
        for (moved, target) in moved.iter().zip(&self.target) {
            let target = &target[first..first + LANES];
            for l in 0..LANES {
                let d = moved[l] - target[l];
                squared[l] += d * d;
            }
        }
        squared
    }

    /// The matches that `target_from_source` brings within `radius_m`, ascending.
    pub fn inliers(&self, target_from_source: &RigidMotion, radius_m: f64) -> Vec<usize> {
        let len = self.source[0].len();
        let limit = (radius_m * radius_m) as f32;
        let moved = Moved::new(target_from_source);
        let mut found = Vec::new();
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                for start in (0..len).step_by(LANES) {
                    let squared = self.squared_distances(&moved.sources(&self.source, start), start);
                    let near = squared.map(|d| d <= limit);
                    if near.contains(&true) {
                        found.extend((0..LANES).filter(|&l| near[l]).map(|l| start + l));
                    }
                }
            },
        );
        found
    }
}

/// A motion in single precision.
struct Moved {
    rotation: [[f32; 3]; 3],
    translation: [f32; 3],
}

impl Moved {
    fn new(motion: &RigidMotion) -> Self {
        let r = motion.rotation.to_rotation_matrix().into_inner().cast::<f32>();
        let t = motion.translation.vector.cast::<f32>();
        let axes = [0, 1, 2];
        Self { rotation: axes.map(|i| axes.map(|j| r[(i, j)])), translation: axes.map(|i| t[i]) }
    }

    /// Sixteen sources from `start`, moved, coordinate by coordinate.
    #[inline(always)]
    fn sources(&self, source: &[Vec<f32>; 3], start: usize) -> [[f32; LANES]; 3] {
        let [sx, sy, sz] = [0, 1, 2].map(|a| &source[a][start..start + LANES]);
        let mut moved = [[0.0f32; LANES]; 3];
        for ((moved, [rx, ry, rz]), t) in moved.iter_mut().zip(&self.rotation).zip(&self.translation) {
            for l in 0..LANES {
                moved[l] = rx * sx[l] + ry * sy[l] + rz * sz[l] + t;
            }
        }
        moved
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};

    /// Targets fill a unit cube and sources stay away from its faces: by chance a source has the share of
    /// the targets near it that a ball has of the cube.
    #[test]
    fn chance_is_the_volume_of_a_ball() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let mut points = |low: f32, high: f32| -> Vec<Point> {
            (0..20_000).map(|_| Point::from([(); 3].map(|()| rng.random_range(low..high)))).collect()
        };
        let (source, target) = (points(0.3, 0.7), points(0.0, 1.0));
        let expected = 20_000.0 * 4.0 / 3.0 * std::f64::consts::PI * 0.2f64.powi(3);
        let found = Correspondences::new(&source, &target).count_by_chance(&RigidMotion::identity(), 0.2);
        assert!((found / expected - 1.0).abs() < 0.03, "{found} {expected}");
        // Right matches are no chance, and one chunk has no other to pair with.
        let right = Correspondences::new(&source, &source);
        let by_chance = right.count_by_chance(&RigidMotion::identity(), 0.01);
        assert!(by_chance < 20.0, "{by_chance}");
        let few = Correspondences::new(&source[..10], &source[..10]);
        assert_eq!(few.count_by_chance(&RigidMotion::identity(), 10.0), 0.0);
    }

    proptest! {
        #[test]
        fn counts_agree_with_one_by_one_double_precision(
            pairs in prop::collection::vec(prop::array::uniform6(-2.0f32..2.0), 0..70),
            v in prop::array::uniform6(-2.0f64..2.0),
        ) {
            let source: Vec<Point> = pairs.iter().map(|p| Point::new(p[0], p[1], p[2])).collect();
            let target: Vec<Point> = pairs.iter().map(|p| Point::new(p[3], p[4], p[5])).collect();
            let motion = RigidMotion::new(Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]));
            let distances: Vec<f64> = source.iter().zip(&target)
                .map(|(s, t)| (motion * s.cast::<f64>() - t.cast::<f64>()).norm()).collect();
            // A radius that no distance comes near, so that rounding cannot decide.
            let radius = 1.5;
            prop_assume!(distances.iter().all(|d| (d - radius).abs() > 1e-4));
            let expected: Vec<usize> = (0..distances.len()).filter(|&i| distances[i] <= radius).collect();
            let c = Correspondences::new(&source, &target);
            prop_assert_eq!(c.count(&motion, radius), expected.len());
            prop_assert_eq!(c.inliers(&motion, radius), expected);
        }
    }
}
