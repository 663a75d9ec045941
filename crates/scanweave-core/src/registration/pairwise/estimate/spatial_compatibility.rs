//! Hypotheses from matches that preserve each other's distances.
//!
//! After Chen, Sun, Yang & Tao, "SC²-PCR" (CVPR 2022): two right matches keep the
//! distance between their points, and two right matches share many third matches with
//! which both do. That second-order count separates inliers at outlier rates where
//! triples drawn at random hardly ever hit. The graph is kept as bit rows, the
//! count is a population count, and no randomness is involved.

use super::Hypothesis;
use crate::geometry::fit::fit_rigid;
use crate::registration::pairwise::correspondences::Correspondences;

/// Matches that a seed's consensus set holds at most.
const CONSENSUS: usize = 30;

/// Motions of the consensus sets around so many of the best-connected matches.
pub fn propose(correspondences: &Correspondences, hypotheses: usize, radius_m: f64) -> Vec<Hypothesis> {
    let graph = CompatibilityGraph::new(correspondences, radius_m as f32);
    let seeds = seeds(&graph, correspondences, hypotheses, radius_m);
    seeds
        .into_iter()
        .filter_map(|seed| {
            let set = graph.consensus(seed);
            let motion = fit_rigid(set.iter().map(|&(i, weight)| {
                let (s, t) = correspondences.pair(i);
                (s, t, f64::from(weight))
            }))?;
            let inliers = correspondences.count(&motion, radius_m);
            Some(Hypothesis { target_from_source: motion, inliers })
        })
        .collect()
}

/// Which matches preserve the distance to which others, a bit a pair.
struct CompatibilityGraph {
    n: usize,
    words: usize,
    bits: Vec<u64>,
}

impl CompatibilityGraph {
    fn new(correspondences: &Correspondences, tolerance_m: f32) -> Self {
        let n = correspondences.len();
        let words = n.div_ceil(64);
        let mut bits = vec![0u64; n * words];
        let columns = Edges::new(correspondences, words * 64);
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                for (i, row) in bits.chunks_exact_mut(words.max(1)).enumerate().take(n) {
                    for (w, word) in row.iter_mut().enumerate() {
                        *word = columns.compatible(i, w * 64, tolerance_m);
                    }
                    row[i / 64] &= !(1 << (i % 64));
                }
            },
        );
        Self { n, words, bits }
    }

    #[inline(always)]
    fn row(&self, i: usize) -> &[u64] {
        &self.bits[i * self.words..(i + 1) * self.words]
    }

    /// Matches compatible with both `i` and `j`.
    #[inline(always)]
    fn shared(&self, i: usize, j: usize) -> u32 {
        self.row(i).iter().zip(self.row(j)).map(|(a, b)| (a & b).count_ones()).sum()
    }

    #[inline(always)]
    fn neighbours(&self, i: usize) -> impl Iterator<Item = usize> + '_ {
        self.row(i).iter().enumerate().flat_map(|(w, &word)| {
            std::iter::successors((word != 0).then_some(word), |&rest| {
                let rest = rest & (rest - 1);
                (rest != 0).then_some(rest)
            })
            .map(move |rest| w * 64 + rest.trailing_zeros() as usize)
        })
    }

    /// Of every match the sum over its neighbours of the second-order count: how well connected it is.
    fn member_evidence(&self) -> Vec<u64> {
        // Bits are counted by an instruction that not every processor has.
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                let evidence = |i| self.neighbours(i).map(|j| u64::from(self.shared(i, j))).sum();
                (0..self.n).map(evidence).collect()
            },
        )
    }

    /// The seed and the neighbours that share most with it, with their shares as weights.
    fn consensus(&self, seed: usize) -> Vec<(usize, u32)> {
        let mut set: Vec<(usize, u32)> = pulp::Arch::new().dispatch(
            #[inline(always)]
            || self.neighbours(seed).map(|j| (j, self.shared(seed, j))).collect(),
        );
        set.sort_by_key(|&(j, shared)| (std::cmp::Reverse(shared), j));
        set.truncate(CONSENSUS);
        let strongest = set.first().map_or(1, |s| s.1.max(1));
        set.push((seed, strongest));
        set
    }
}

/// Padded coordinates, for a vectorisable inner loop.
struct Edges {
    source: [Vec<f32>; 3],
    target: [Vec<f32>; 3],
}

impl Edges {
    fn new(correspondences: &Correspondences, padded: usize) -> Self {
        let lay = |of: &dyn Fn(usize) -> nalgebra::Point3<f64>, padding: f32| -> [Vec<f32>; 3] {
            std::array::from_fn(|axis| {
                let mut values: Vec<f32> = (0..correspondences.len()).map(|i| of(i)[axis] as f32).collect();
                values.resize(padded, padding);
                values
            })
        };
        Self {
            source: lay(&|i| correspondences.source(i), 0.0),
            target: lay(&|i| correspondences.target(i), f32::INFINITY),
        }
    }

    /// Bit `l`: match `start + l` keeps its distance to match `i` within the tolerance.
    #[inline(always)]
    fn compatible(&self, i: usize, start: usize, tolerance_m: f32) -> u64 {
        let length = |of: &[Vec<f32>; 3]| -> [f32; 64] {
            let mut squared = [0.0f32; 64];
            for axis in of {
                let here = axis[i];
                for (sum, &there) in squared.iter_mut().zip(&axis[start..start + 64]) {
                    *sum += (there - here) * (there - here);
                }
            }
            squared.map(f32::sqrt)
        };
        let (source, target) = (length(&self.source), length(&self.target));
        let mut flags = [0u64; 64];
        for l in 0..64 {
            flags[l] = u64::from((source[l] - target[l]).abs() <= tolerance_m) << l;
        }
        flags.iter().fold(0, |word, flag| word | flag)
    }
}

/// The best-connected matches, no two of them starting within the radius of each other.
fn seeds(graph: &CompatibilityGraph, c: &Correspondences, count: usize, radius_m: f64) -> Vec<usize> {
    let mut ranked: Vec<(u64, usize)> = graph.member_evidence().into_iter().zip(0..).collect();
    ranked.sort_by_key(|&(evidence, i)| (std::cmp::Reverse(evidence), i));
    let mut chosen: Vec<usize> = Vec::new();
    for (evidence, i) in ranked {
        if chosen.len() == count || evidence == 0 {
            break;
        }
        let p = c.source(i);
        if chosen.iter().all(|&k| (c.source(k) - p).norm() > radius_m) {
            chosen.push(i);
        }
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn bits_agree_with_distances_one_by_one() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut cloud = |n: usize| -> Vec<Point> {
            (0..n)
                .map(|_| Point::from(nalgebra::Vector3::from_fn(|_, _| rng.random_range(-1.0f32..1.0))))
                .collect()
        };
        let (source, target) = (cloud(150), cloud(150));
        let c = Correspondences::new(&source, &target);
        let graph = CompatibilityGraph::new(&c, 0.2);
        for i in 0..150 {
            let expected: Vec<usize> = (0..150)
                .filter(|&j| {
                    let (a, b) = ((source[i] - source[j]).norm(), (target[i] - target[j]).norm());
                    j != i && (a - b).abs() <= 0.2
                })
                .collect();
            assert_eq!(graph.neighbours(i).collect::<Vec<_>>(), expected);
            let j = (i + 1) % 150;
            let shared = expected.iter().filter(|&&k| graph.neighbours(j).any(|m| m == k)).count();
            assert_eq!(graph.shared(i, j) as usize, shared);
        }
    }
}
