//! Random sample consensus over triples of matches.

use super::Hypothesis;
use crate::geometry::fit::fit_triangle;
use crate::registration::config::RansacConfig;
use crate::registration::pairwise::correspondences::Correspondences;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The best triple's motion (Fischler & Bolles 1981).
///
/// A drawn triple is scored only when its three edges have nearly the same length in
/// source and target; drawing stops after `config.hypotheses` scored triples or
/// `config.max_draws` drawn ones. No early stop, as in the paper's setting.
pub fn propose(
    correspondences: &Correspondences,
    config: &RansacConfig,
    radius_m: f64,
    seed: u64,
) -> Vec<Hypothesis> {
    let n = correspondences.len();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut best: Option<Hypothesis> = None;
    let mut scored = 0;
    for _ in 0..config.max_draws {
        let triple: [usize; 3] = std::array::from_fn(|_| rng.random_range(0..n));
        let source = triple.map(|i| correspondences.source(i));
        let target = triple.map(|i| correspondences.target(i));
        if !edges_agree(&source, &target, config.edge_ratio) {
            continue;
        }
        let Some(motion) = fit_triangle(source, target) else { continue };
        let inliers = correspondences.count(&motion, radius_m);
        if best.as_ref().is_none_or(|b| inliers > b.inliers) {
            best = Some(Hypothesis { target_from_source: motion, inliers });
        }
        scored += 1;
        if scored == config.hypotheses {
            break;
        }
    }
    best.into_iter().collect()
}

/// Whether every edge of one triangle is at least `ratio` times as long as its counterpart.
fn edges_agree(a: &[nalgebra::Point3<f64>; 3], b: &[nalgebra::Point3<f64>; 3], ratio: f64) -> bool {
    [(0, 1), (1, 2), (2, 0)].iter().all(|&(i, j)| {
        let (x, y) = ((a[i] - a[j]).norm(), (b[i] - b[j]).norm());
        x > 0.0 && y > 0.0 && x.min(y) >= ratio * x.max(y)
    })
}
