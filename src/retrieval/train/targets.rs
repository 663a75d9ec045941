//! True overlap of many posed point sets at once.

use crate::error::Result;
use crate::geometry::Point;
use crate::geometry::neighbours::RadiusGrid;
use crate::scan::SimilarityMatrix;
use rayon::prelude::*;

/// Two-way overlap of all pairs of point sets in one frame: (points of i near j + points of j near
/// i) / (|i| + |j|), near meaning within `radius_m`; empty sets overlap nothing.
///
/// One grid holds the points of all sets, and every point looks around once and marks the sets it
/// finds: N grids less and N queries a point less than going pair by pair.
///
/// # Errors
/// None for finite points.
pub fn overlap_matrix(sets: &[Vec<Point>], radius_m: f32) -> Result<SimilarityMatrix> {
    let n = sets.len();
    let points: Vec<Point> = sets.concat();
    let owner: Vec<u32> =
        sets.iter().enumerate().flat_map(|(i, s)| std::iter::repeat_n(i as u32, s.len())).collect();
    let grid = RadiusGrid::new(&points, radius_m);
    let near: Vec<Vec<u32>> = sets
        .par_iter()
        .map(|set| {
            let mut counts = vec![0u32; n];
            // Number of the last query that found the set, counted from 1.
            let mut seen = vec![0u32; n];
            for (q, point) in (1u32..).zip(set) {
                grid.for_each_within(point, |at, _| {
                    let j = owner[at] as usize;
                    counts[j] += u32::from(seen[j] != q);
                    seen[j] = q;
                });
            }
            counts
        })
        .collect();
    let mut values = vec![0.0f32; n * n];
    for i in 0..n {
        for j in (0..n).filter(|&j| j != i) {
            let total = (sets[i].len() + sets[j].len()).max(1);
            values[i * n + j] = (f64::from(near[i][j] + near[j][i]) / total as f64) as f32;
        }
    }
    SimilarityMatrix::new(n, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::RigidMotion;
    use crate::geometry::overlap::two_way_overlap;
    use crate::retrieval::generator;
    use rand::RngExt;

    #[test]
    fn all_pairs_at_once_equal_the_pairwise_overlap() {
        let mut rng = generator(3, "test", 0);
        let sets: Vec<Vec<Point>> = (0..7)
            .map(|i| {
                let mut draw = |from: f32| rng.random_range(from..from + 1.0);
                (0..i * 60).map(|_| Point::new(draw(0.2 * i as f32), draw(0.0), draw(0.0))).collect()
            })
            .collect();
        let all = overlap_matrix(&sets, 0.1).unwrap();
        let mut positive = 0;
        for i in 0..7 {
            for j in (0..7).filter(|&j| j != i) {
                let (a, b) = (RadiusGrid::new(&sets[i], 0.1), RadiusGrid::new(&sets[j], 0.1));
                let pair = two_way_overlap(&a, &b, &RigidMotion::identity()).ratio;
                assert!((f64::from(all.get(i, j)) - pair).abs() < 1e-6, "{i} {j}");
                positive += usize::from(pair > 0.0);
            }
        }
        assert!(positive > 10);
    }
}
