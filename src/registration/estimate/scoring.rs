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
        // Padding pairs are infinitely far apart under every motion.
        let lay = |points: &[Point], padding: f32| -> [Vec<f32>; 3] {
            std::array::from_fn(|axis| {
                let mut values: Vec<f32> = points.iter().map(|p| p[axis]).collect();
                values.resize(padded, padding);
                values
            })
        };
        Self { len: source.len(), source: lay(source, 0.0), target: lay(target, f32::INFINITY) }
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
        let mut count = 0;
        self.scan(target_from_source, radius_m, |_, hits| {
            count += hits.iter().map(|&h| u32::from(h)).sum::<u32>() as usize;
        });
        count
    }

    /// The matches that `target_from_source` brings within `radius_m`, ascending.
    pub fn inliers(&self, target_from_source: &RigidMotion, radius_m: f64) -> Vec<usize> {
        let mut found = Vec::new();
        self.scan(target_from_source, radius_m, |start, hits| {
            found.extend(hits.iter().enumerate().filter(|h| *h.1).map(|h| start + h.0));
        });
        found
    }

    /// Calls `visit(first match, which of the next 16 are within the radius)`.
    fn scan(&self, motion: &RigidMotion, radius_m: f64, mut visit: impl FnMut(usize, &[bool; LANES])) {
        let r = motion.rotation.to_rotation_matrix().into_inner().cast::<f32>();
        let t = motion.translation.vector.cast::<f32>();
        let limit = (radius_m * radius_m) as f32;
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                for start in (0..self.source[0].len()).step_by(LANES) {
                    let chunk = start..start + LANES;
                    let [sx, sy, sz] = [0, 1, 2].map(|a| &self.source[a][chunk.clone()]);
                    let mut squared = [0.0f32; LANES];
                    for axis in 0..3 {
                        let target = &self.target[axis][chunk.clone()];
                        let (rx, ry, rz, shift) = (r[(axis, 0)], r[(axis, 1)], r[(axis, 2)], t[axis]);
                        for l in 0..LANES {
                            let d = rx * sx[l] + ry * sy[l] + rz * sz[l] + shift - target[l];
                            squared[l] += d * d;
                        }
                    }
                    visit(start, &std::array::from_fn(|l| squared[l] <= limit));
                }
            },
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

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
