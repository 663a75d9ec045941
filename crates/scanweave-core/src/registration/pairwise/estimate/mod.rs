//! Robust rigid motions from matches with many outliers.

mod ransac;
mod spatial_compatibility;

use crate::geometry::fit::fit_rigid;
use crate::geometry::rigid::{RigidMotion, same_motion};
use crate::registration::config::EstimatorConfig;
use crate::registration::pairwise::correspondences::Correspondences;
use crate::registration::pairwise::matching::Matches;
use nalgebra::Point3;

/// Distinct proposals that are refined.
const PROPOSALS: usize = 20;
/// Distinct refined hypotheses that are returned.
const HYPOTHESES: usize = 5;

/// A motion supported by matches.
#[derive(Debug, Clone, PartialEq)]
pub struct Hypothesis {
    /// The motion.
    pub target_from_source: RigidMotion,
    /// Matches within the inlier radius under it.
    pub inliers: usize,
}

/// Distinct hypotheses for the motion that takes the matches' sources to their targets,
/// best supported first; empty when fewer than three matches agree on one.
///
/// Every hypothesis is refined by closed-form fits to its matches within twice the
/// radius, then within it.
pub fn estimate(matches: &Matches, config: &EstimatorConfig, radius_m: f64, seed: u64) -> Vec<Hypothesis> {
    if matches.len() < 3 {
        return Vec::new();
    }
    let correspondences = Correspondences::new(&matches.source, &matches.target);
    let nearest = matches.nearest_in_descriptor_space(config.max_matches());
    let nearest = Correspondences::new(
        &nearest.iter().map(|&m| matches.source[m]).collect::<Vec<_>>(),
        &nearest.iter().map(|&m| matches.target[m]).collect::<Vec<_>>(),
    );
    let proposals = match config {
        EstimatorConfig::Ransac(config) => ransac::propose(&nearest, config, radius_m, seed),
        EstimatorConfig::SpatialCompatibility(config) => {
            spatial_compatibility::propose(&nearest, config.hypotheses, radius_m)
        }
    };
    let refined = distinct(proposals, PROPOSALS, radius_m)
        .into_iter()
        .filter_map(|p| refine(&correspondences, &p, radius_m))
        .collect();
    distinct(refined, HYPOTHESES, radius_m)
}

/// Fits on the matches within 2τ, then within τ, of the present motion.
fn refine(correspondences: &Correspondences, start: &Hypothesis, radius_m: f64) -> Option<Hypothesis> {
    let mut current = start.target_from_source;
    for factor in [2.0, 1.0] {
        let near = correspondences.inliers(&current, factor * radius_m);
        current = fit_rigid(near.iter().map(|&i| {
            let (s, t) = correspondences.pair(i);
            (s, t, 1.0)
        }))?;
    }
    let inliers = correspondences.count(&current, radius_m);
    (inliers >= 3).then_some(Hypothesis { target_from_source: current, inliers })
}

/// Best-supported first, without repetitions of nearly the same motion.
fn distinct(mut hypotheses: Vec<Hypothesis>, at_most: usize, radius_m: f64) -> Vec<Hypothesis> {
    // A stable sort: equal evidence keeps the order of proposal, which is deterministic.
    hypotheses.sort_by_key(|h| std::cmp::Reverse(h.inliers));
    let mut kept: Vec<Hypothesis> = Vec::new();
    for h in hypotheses {
        let repeats = kept
            .iter()
            .any(|k| same_motion(&k.target_from_source, &h.target_from_source, &Point3::origin(), radius_m));
        if !repeats {
            kept.push(h);
        }
        if kept.len() == at_most {
            break;
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use crate::geometry::rigid::rotation_error_rad;
    use crate::geometry::rigid::translation_error_m;
    use crate::registration::config::RansacConfig;
    use nalgebra::Vector3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// `n` matches of a 4 m scene, a share of them right up to 1 cm noise, the rest random.
    pub(crate) fn scene(n: usize, inlier_ratio: f64, seed: u64) -> (Matches, RigidMotion) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut point =
            |scale: f32| Point::from(nalgebra::Vector3::from_fn(|_, _| rng.random_range(-scale..scale)));
        let truth = RigidMotion::new(Vector3::new(1.0, -0.5, 0.3), Vector3::new(0.4, -2.0, 0.9));
        let right = (n as f64 * inlier_ratio) as usize;
        let mut matches = Matches::default();
        for i in 0..n {
            let s = point(2.0);
            let exact = (truth * s.cast::<f64>()).cast::<f32>();
            let t = if i < right { exact + point(0.01).coords } else { point(2.0) };
            matches.pairs.push((i as u32, i as u32));
            matches.source.push(s);
            matches.target.push(t);
            matches.scores.push(0.0);
        }
        (matches, truth)
    }

    fn both() -> [EstimatorConfig; 2] {
        [EstimatorConfig::Ransac(RansacConfig::default()), EstimatorConfig::default()]
    }

    fn assert_found(config: &EstimatorConfig, inlier_ratio: f64) {
        for seed in 0..5 {
            let (matches, truth) = scene(1000, inlier_ratio, seed);
            let found = estimate(&matches, config, 0.07, seed);
            let best = &found[0];
            let right = (1000.0 * inlier_ratio) as usize;
            assert!(best.inliers >= right, "{} of {right} inliers", best.inliers);
            assert!(rotation_error_rad(&best.target_from_source, &truth) < 0.01);
            assert!(translation_error_m(&best.target_from_source, &truth) < 0.01);
        }
    }

    #[test]
    fn ransac_finds_the_motion_among_three_quarters_outliers() {
        assert_found(&both()[0], 0.25);
    }

    #[test]
    fn spatial_compatibility_finds_the_motion_among_95_percent_outliers() {
        assert_found(&both()[1], 0.05);
    }

    #[test]
    fn two_motions_in_one_set_both_come_out() {
        let (mut a, truth_a) = scene(300, 0.3, 1);
        let (b, _) = scene(300, 0.0, 2);
        let truth_b = RigidMotion::new(Vector3::new(-1.0, 0.0, 0.0), Vector3::new(0.0, 0.0, 3.0));
        for (i, s) in b.source.iter().enumerate() {
            a.pairs.push((300 + i as u32, 300 + i as u32));
            a.source.push(*s);
            a.scores.push(0.0);
            a.target.push(if i < 60 { (truth_b * s.cast::<f64>()).cast() } else { b.target[i] });
        }
        let found = estimate(&a, &EstimatorConfig::default(), 0.07, 0);
        assert!(rotation_error_rad(&found[0].target_from_source, &truth_a) < 0.01);
        assert!(rotation_error_rad(&found[1].target_from_source, &truth_b) < 0.01);
        assert!(found[0].inliers > found[1].inliers);
    }

    #[test]
    fn fewer_than_three_matches_give_nothing() {
        let (mut m, _) = scene(2, 1.0, 0);
        for config in both() {
            assert!(estimate(&m, &config, 0.07, 0).is_empty());
        }
        // Three copies of one match fix no motion either.
        m.source = vec![m.source[0]; 3];
        m.target = vec![m.target[0]; 3];
        m.pairs = vec![(0, 0), (1, 1), (2, 2)];
        m.scores = vec![0.0; 3];
        for config in both() {
            assert!(estimate(&m, &config, 0.07, 0).is_empty());
        }
    }
}
