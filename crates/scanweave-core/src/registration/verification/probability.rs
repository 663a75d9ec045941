//! What a registration must show before it counts as right.
//!
//! Inlier counts alone cannot tell a right pose from a flip or a slide along repeated
//! structure. The evidence of a pose joins eight measurements in one logistic score: inlier
//! matches, how far they lead the next distinct hypothesis, how many of them chance explains, how
//! much surface touches, whether normals agree there, how far points lie off the tangent planes, how much lies in space that
//! was seen to be empty, and how firmly the touching surface fixes the pose.

use crate::registration::config::SurfaceVerification;
use crate::registration::scan_model::UNKNOWN_RELIABILITY;
use crate::registration::verification::noise_level::NoiseLevel;
use crate::scan::Evidence;

/// Free-space violation beyond which more of it counts besides by a term of its own.
const MOST_VIOLATION: f64 = 0.2;

/// Exponent k of the tail of the free-space violations of right poses: about the weight that was learned for the
/// logarithm, 2.7.
const TAIL: f64 = 2.5;

/// Perceptual aliasing at most: with so much nothing is told apart.
const MOST_ALIASING: f64 = 20.0;

/// Violation, with usual noise, that a right pose does not exceed where viewpoints are reliable: 9 of 3082 right proposals
/// did of those that were measured between groups of scans in four 3DMatch scenes and two
/// synthetic buildings, and three quarters of the wrong ones.
pub const MOST_VIOLATION_OF_CORRECT: f64 = 0.125;

/// What right poses usually show: it stands for a measurement that is switched off. The figures are
/// those at which the weighted term equals its mean over right proposals between groups of scans in four
/// 3DMatch scenes.
pub(super) const USUAL_VIOLATION: f64 = 0.02;
const USUAL_LOCALIZABILITY: f64 = 0.0787;
const USUAL_CHANCE_SHARE: f64 = 0.0092;

/// Probability at most where reliable viewpoints, matches of a pair or another pose contradict a pose.
pub const UNDECIDED: f64 = 0.5;

/// A pair of scans that is sure, whatever was seen to be empty, and what each scan saw through of the
/// other: [`SurfaceFit::seen_through`](super::surface_fit::SurfaceFit::seen_through) of the first and
/// of the second.
pub type SurePair = ((usize, usize), [f64; 2]);

/// Whether a pose is sure by all that was measured but free space.
pub fn is_sure_without_free_space(evidence: &Evidence, settings: &SurfaceVerification) -> bool {
    /// Probability from which it is.
    const SURE: f64 = 0.95;
    let evidence = Evidence { free_space_violation: USUAL_VIOLATION, ..*evidence };
    probability(&evidence, settings, &NoiseLevel::USUAL) >= SURE
}

/// How far the viewpoint of each of `scans` scans is reliable, in `[0, 1]`: as far as sure pairs show no
/// surface of other scans in the space that it saw to be empty.
///
/// A fifth of one scan's surface in the air of another means a wrong pose where the viewpoint is the
/// sensor's; where it is not it means nothing. Scans with few sure pairs are taken for as reliable as
/// all scans are; where there are hardly any such pairs nothing is known.
pub fn viewpoint_reliability(scans: usize, sure: &[SurePair], settings: &SurfaceVerification) -> Vec<f64> {
    /// Pairs below which there is nothing to conclude from.
    const FEWEST: usize = 5;
    /// Median violation of sure pairs up to which a viewpoint is fully reliable; it is not at all where
    /// that is as large as correct poses show nowhere, and none is where that of all pairs is larger.
    const RELIABLE: f64 = 0.05;
    /// Sure pairs of a scan that count as much as what is known of all scans.
    const PRIOR_PAIRS: f64 = 2.0;
    if !(settings.free_space && settings.viewpoint_reliability) {
        return vec![1.0; scans];
    }
    if sure.len() < FEWEST {
        return vec![UNKNOWN_RELIABILITY; scans];
    }
    let median = |violations: &mut Vec<f64>| {
        violations.sort_by(f64::total_cmp);
        violations.get(violations.len().saturating_sub(1) / 2).copied()
    };
    let mut of_scan: Vec<Vec<f64>> = vec![Vec::new(); scans];
    for &((i, j), [of_i_seen_by_j, of_j_seen_by_i]) in sure {
        for (scan, per_touching) in [(i, of_j_seen_by_i), (j, of_i_seen_by_j)] {
            of_scan[scan].push(per_touching / (1.0 + per_touching));
        }
    }
    let mut all: Vec<f64> = of_scan.iter().flatten().copied().collect();
    let of_all = median(&mut all).unwrap_or(0.0);
    // Whether files tell where the sensor stood is a habit of who wrote them; and near pairs, which are
    // the sure ones, show less than those that see a thing from opposite sides.
    let mut of_pairs: Vec<f64> = sure.iter().map(|(_, [a, b])| (a + b) / (1.0 + a + b)).collect();
    let of_pair = median(&mut of_pairs).unwrap_or(0.0);
    if of_pair > RELIABLE {
        return vec![0.0; scans];
    }
    let reliability = |own: &mut Vec<f64>| {
        let pairs = own.len() as f64;
        let own = median(own).unwrap_or(of_all);
        let violation = (pairs * own + PRIOR_PAIRS * of_all) / (pairs + PRIOR_PAIRS);
        let of_scan = (MOST_VIOLATION_OF_CORRECT - violation) / (MOST_VIOLATION_OF_CORRECT - RELIABLE);
        of_scan.clamp(0.0, 1.0)
    };
    of_scan.iter_mut().map(reliability).collect()
}

/// What the logistic model sees of evidence, in the order of [`crate::registration::config::EvidenceWeights::as_array`]:
/// 1, ln inliers, ln(inliers / inliers of the next hypothesis), ln normal agreement,
/// plane residual, ln overlap, ln free-space violation, ln localizability, free-space violation beyond a fifth,
/// ln(inliers by chance / inliers); the logarithms of shares with 0.01
/// added, 0.05 for the normals, 0.001 for the localizability, 0.02 for chance.
///
/// The plane residual counts as far as it differs from the collection's. What right poses violate of free space
/// is spread about the collection's level e with the heavy tail of a density e^(k−1)/(v+e)^k, what wrong ones
/// violate is spread whatever the sensor, so that the log odds hold −k ln(v+e) + (k−1) ln e: with k = 2.5, about the
/// weight learned, and r the ratio of e to what is usual, 0.01, that is −k times ln(v/r + 0.01) + ln(r)/k. Both are as without a
/// collection where its level is usual.
///
/// Fewer than three inliers of the next hypothesis count as three: any three matches
/// agree on some motion.
pub fn predictors(evidence: &Evidence, noise: &NoiseLevel) -> [f64; 10] {
    let inliers = evidence.inliers.max(1) as f64;
    let second_best_ratio = inliers / evidence.second_best_inliers.max(3) as f64;
    let violation = noise.scaled_violation(evidence.free_space_violation);
    [
        1.0,
        inliers.ln(),
        second_best_ratio.ln(),
        (evidence.normal_agreement + 0.05).ln(),
        evidence.plane_residual - noise.plane_residual + NoiseLevel::USUAL.plane_residual,
        (evidence.overlap + 0.01).ln(),
        (violation.min(MOST_VIOLATION) + 0.01).ln() + noise.violation_ratio().ln() / TAIL,
        (evidence.localizability + 1e-3).ln(),
        (violation - MOST_VIOLATION).max(0.0),
        (evidence.chance_inliers / inliers + 0.02).ln(),
    ]
}

/// Probability that a pose with this evidence is right, by the logistic model of the settings, in a collection
/// with this noise.
pub fn probability(evidence: &Evidence, settings: &SurfaceVerification, noise: &NoiseLevel) -> f64 {
    let x = predictors(&considered(evidence, settings), noise);
    let score: f64 = x.iter().zip(settings.weights.as_array()).map(|(x, w)| x * w).sum();
    1.0 / (1.0 + (-score).exp())
}

/// The evidence with what is usual in the place of what the settings switch off.
fn considered(evidence: &Evidence, settings: &SurfaceVerification) -> Evidence {
    let mut considered = *evidence;
    if !settings.free_space {
        considered.free_space_violation = USUAL_VIOLATION;
    }
    if !settings.localizability {
        considered.localizability = USUAL_LOCALIZABILITY;
    }
    if !settings.chance_inliers {
        considered.chance_inliers = USUAL_CHANCE_SHARE * evidence.inliers.max(1) as f64;
    }
    considered
}

/// Whether viewpoints, as far as they are reliable, speak against a pose so that no number of matches
/// makes up for it: two rooms furnished alike match as well as one seen twice.
pub fn exceeds_free_space_limit(
    evidence: &Evidence,
    settings: &SurfaceVerification,
    noise: &NoiseLevel,
) -> bool {
    let violation = noise.scaled_violation(evidence.free_space_violation);
    settings.free_space && violation > MOST_VIOLATION_OF_CORRECT
}

/// A probability by weights that were fitted to scenes of some sixty scans, in a collection of `scans` scans: a scan
/// meets as many neighbours in a larger collection but more that only look like it, so that the odds fall with
/// the number of scans.
pub fn with_scan_count_prior(probability: f64, scans: usize) -> f64 {
    /// Scans of the scenes that the weights were fitted to.
    const FITTED: f64 = 60.0;
    let odds = probability / (1.0 - probability) * (FITTED / scans as f64).min(1.0);
    if odds.is_finite() { odds / (1.0 + odds) } else { probability }
}

/// Perceptual aliasing: by how much the log odds of wrong hypotheses exceed what they usually are, at
/// least 0. `runner_ups` are the probabilities of the second-best hypothesis of each pair of scans, one of
/// which at most is right: where corridors, bare rooms or the sides of a column look alike, the wrong
/// ones look right, and evidence that is convincing elsewhere says that much less.
pub fn aliasing(runner_ups: impl Iterator<Item = f64>) -> f64 {
    /// Usual median of the log odds: −6.2 to −7.5 on the five RGB-D scenes of 3DMatch that the weights were
    /// fitted to, −5.1 to −5.6 in synthetic rooms with furniture; −0.7 to −2.8 in bare ones.
    const USUAL: f64 = -6.0;
    /// Pairs that count as much as what is usual.
    const PRIOR_PAIRS: f64 = 2.0;
    let mut log_odds: Vec<f64> = runner_ups.map(|p| (p / (1.0 - p)).ln()).collect();
    log_odds.sort_by(f64::total_cmp);
    let n = log_odds.len();
    let Some(median) = log_odds.get(n / 2) else { return 0.0 };
    (median - USUAL).clamp(0.0, MOST_ALIASING) * n as f64 / (n as f64 + PRIOR_PAIRS)
}

/// A probability with its log odds lowered.
pub fn with_aliasing(probability: f64, aliasing: f64) -> f64 {
    let odds = probability / (1.0 - probability) * (-aliasing).exp();
    if odds.is_finite() { odds / (1.0 + odds) } else { probability }
}

/// Probability of a pose that is right with `alone` if no other is, where others of which the same is
/// known contradict it: at most one of them is right, so that the odds of all share what there is. Where a
/// rival has more than a sixth of its odds the pose is ambiguous, and has no more than one half.
pub fn among_rivals(alone: f64, rivals: impl Iterator<Item = f64>) -> f64 {
    /// Odds against the best rival from which that is ruled out. Of 4, 6 and 9 the first joins the halves of
    /// furnished rooms turned by 180°, the last leaves a right join of two large objects open; the
    /// five RGB-D scenes are the same with 6 and 9.
    const RULED_OUT: f64 = 6.0;
    // An odds of ten to the fifteen tells no more than the last digit of a double.
    let odds = |p: f64| p / (1.0 - p).max(1e-15);
    let own = odds(alone);
    let (all, best) =
        rivals.map(odds).fold((0.0, 0.0f64), |(all, best), rival| (all + rival, best.max(rival)));
    let among = own / (1.0 + own + all);
    if own < RULED_OUT * best { among.min(UNDECIDED) } else { among }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    const USUAL: NoiseLevel = NoiseLevel::USUAL;

    #[test]
    fn odds_fall_with_the_number_of_scans_beyond_those_fitted() {
        assert_relative_eq!(with_scan_count_prior(0.9, 12), 0.9);
        assert_relative_eq!(with_scan_count_prior(0.9, 60), 0.9);
        // 9 : 1 among sixty are 9 : 10 among six hundred.
        assert_relative_eq!(with_scan_count_prior(0.9, 600), 9.0 / 19.0);
        assert_eq!([with_scan_count_prior(0.0, 600), with_scan_count_prior(1.0, 600)], [0.0, 1.0]);
    }

    #[test]
    fn wrong_hypotheses_that_look_right_lower_all_odds() {
        let probability = |log_odds: f64| 1.0 / (1.0 + (-log_odds).exp());
        let of = |log_odds: &[f64]| aliasing(log_odds.iter().map(|l| probability(*l)));
        // Usual ones and none cost nothing; one wild one among many does not move the median.
        assert_eq!(of(&[]), 0.0);
        assert_eq!(of(&[-7.0, -6.5, 3.0]), 0.0);
        // Five above the usual, in eight pairs of ten.
        assert_relative_eq!(of(&[-1.0; 8]), 4.0, epsilon = 1e-9);
        assert_relative_eq!(with_aliasing(probability(5.0), 4.0), probability(1.0), epsilon = 1e-9);
        assert_eq!([with_aliasing(0.0, 3.0), with_aliasing(1.0, 3.0)], [0.0, 1.0]);
    }

    #[test]
    fn a_pose_is_judged_by_what_the_collection_shows() {
        let noise = NoiseLevel { plane_residual: 0.3, free_space_violation: 0.025 };
        let pose = |free_space_violation: f64| Evidence {
            inliers: 30,
            plane_residual: 0.35,
            free_space_violation,
            ..Evidence::default()
        };
        // 0.005 + 0.025 is three times 0.005 + 0.005.
        let x = predictors(&pose(0.69), &noise);
        assert_relative_eq!(x[4], 0.17 + 0.05, epsilon = 1e-12);
        assert_relative_eq!(x[6], 0.21f64.ln() + 3f64.ln() / 2.5, epsilon = 1e-12);
        assert_relative_eq!(x[8], 0.23 - 0.2, epsilon = 1e-12);
        let x = predictors(&pose(0.06), &noise);
        assert_relative_eq!(x[6], 0.03f64.ln() + 3f64.ln() / 2.5, epsilon = 1e-12);
        assert_eq!(x[8], 0.0);
        let usual = predictors(&pose(0.06), &USUAL);
        assert_relative_eq!(usual[4], 0.35, epsilon = 1e-12);
        assert_relative_eq!(usual[6], 0.07f64.ln(), epsilon = 1e-12);
        let settings = SurfaceVerification::default();
        let exceeds = |v: f64, noise: &NoiseLevel| exceeds_free_space_limit(&pose(v), &settings, noise);
        assert_eq!([0.37, 0.38].map(|v| exceeds(v, &noise)), [false, true]);
        assert_eq!([0.12, 0.13].map(|v| exceeds(v, &USUAL)), [false, true]);
    }

    #[test]
    fn rivals_share_the_odds() {
        assert_relative_eq!(among_rivals(0.9, [].into_iter()), 0.9);
        // 99 : 1 against 9 : 1 is ambiguous no more, 53 : 1 is.
        assert_relative_eq!(among_rivals(0.99, [0.9].into_iter()), 99.0 / 109.0, epsilon = 1e-12);
        assert_relative_eq!(among_rivals(53.0 / 54.0, [0.9].into_iter()), 0.5);
        // 9 : 1 for either: 9/19 each, and 1/19 for neither.
        assert_relative_eq!(among_rivals(0.9, [0.9].into_iter()), 9.0 / 19.0);
        assert_relative_eq!(among_rivals(0.99, [0.5, 0.0].into_iter()), 99.0 / 101.0, epsilon = 1e-12);
        assert_relative_eq!(among_rivals(1.0, [1.0].into_iter()), 0.5, epsilon = 1e-9);
    }

    #[test]
    fn more_of_every_good_thing_is_more_probable() {
        let settings = SurfaceVerification::default();
        let base = Evidence {
            matches: 1000,
            inliers: 30,
            second_best_inliers: 15,
            chance_inliers: 0.5,
            overlap: 0.4,
            normal_agreement: 0.8,
            plane_residual: 0.3,
            free_space_violation: 0.02,
            localizability: 0.05,
            ..Evidence::default()
        };
        let p = probability(&base, &settings, &USUAL);
        assert!(probability(&Evidence { inliers: 60, ..base }, &settings, &USUAL) > p);
        assert!(probability(&Evidence { second_best_inliers: 29, ..base }, &settings, &USUAL) < p);
        assert!(probability(&Evidence { chance_inliers: 3.0, ..base }, &settings, &USUAL) < p);
        assert!(probability(&Evidence { normal_agreement: 0.5, ..base }, &settings, &USUAL) < p);
        assert!(probability(&Evidence { plane_residual: 0.6, ..base }, &settings, &USUAL) < p);
        assert!(probability(&Evidence { overlap: 0.1, ..base }, &settings, &USUAL) < p);
        assert!(probability(&Evidence { free_space_violation: 0.2, ..base }, &settings, &USUAL) < p);
        let seen = |free_space_violation: f64| {
            probability(&Evidence { free_space_violation, ..base }, &settings, &USUAL)
        };
        assert!(seen(0.6) < seen(0.3) && seen(0.3) < seen(0.2));
        assert!(probability(&Evidence { localizability: 0.0, ..base }, &settings, &USUAL) < p);
    }

    #[test]
    fn a_viewpoint_is_reliable_as_far_as_sure_pairs_do_not_lie_in_its_air() {
        let settings = SurfaceVerification::default();
        // Scan 0 with four others: what it sees through of them, and they of it.
        let pairs = |by_0: f64, by_others: f64| -> Vec<SurePair> {
            (1..7).map(|k| ((0, k), [by_others, by_0])).collect()
        };
        assert_eq!(viewpoint_reliability(8, &pairs(0.0, 0.01), &settings), [1.0; 8]);
        assert_eq!(viewpoint_reliability(8, &pairs(0.0, 0.0)[..4], &settings), [UNKNOWN_RELIABILITY; 8]);
        let one_bad = viewpoint_reliability(8, &pairs(0.4, 0.0), &settings);
        // Its own 0.4/1.4 in six pairs, and in the median of all, which counts for two, nothing.
        assert_eq!(one_bad[0], 0.0);
        let all_bad = viewpoint_reliability(8, &pairs(0.3, 0.3), &settings);
        assert_eq!(all_bad, [0.0; 8]);
        // Pairs of 0.06, of which each side has half, and of 0.04.
        let of_pairs = |violation: f64| {
            let half = 0.5 * violation / (1.0 - violation);
            viewpoint_reliability(8, &pairs(half, half), &settings)
        };
        assert_eq!(of_pairs(0.06), [0.0; 8]);
        assert_eq!(of_pairs(0.04), [1.0; 8]);
        // One scan among many that has 0.0875/0.9125 of its own in six pairs: on the way to none.
        let mut one = pairs(0.0875 / 0.9125, 0.0);
        one.extend((10..40).map(|k| ((k, k + 1), [0.0; 2])));
        let found = viewpoint_reliability(41, &one, &settings);
        assert!(found[0] > 0.5 && found[0] < 1.0 && found[20] == 1.0, "{found:?}");
    }

    #[test]
    fn the_logistic_model_is_its_closed_form() {
        let weights = crate::registration::config::EvidenceWeights {
            constant: -1.0,
            ln_inliers: 1.0,
            ln_second_best_ratio: 2.0,
            normal_agreement: 0.5,
            plane_residual: -1.0,
            overlap: 1.0,
            free_space_violation: -2.0,
            localizability: 0.5,
            free_space_excess: -4.0,
            chance_inliers: -3.0,
        };
        let settings = SurfaceVerification { weights, ..SurfaceVerification::default() };
        let evidence = Evidence {
            matches: 100,
            inliers: 20,
            second_best_inliers: 10,
            chance_inliers: 2.0,
            overlap: 0.5,
            normal_agreement: 0.8,
            plane_residual: 0.25,
            free_space_violation: 0.1,
            localizability: 0.049,
            ..Evidence::default()
        };
        let score = -1.0 + 20f64.ln() + 2.0 * 2f64.ln() + 0.5 * 0.85f64.ln() - 0.25 + 0.51f64.ln()
            - 2.0 * 0.11f64.ln()
            + 0.5 * 0.05f64.ln()
            - 3.0 * 0.12f64.ln();
        assert_relative_eq!(
            probability(&evidence, &settings, &USUAL),
            1.0 / (1.0 + (-score).exp()),
            epsilon = 1e-12
        );
    }

    /// What is switched off has no say at all, neither as a weighted term nor as a limit.
    #[test]
    fn what_is_switched_off_has_no_say() {
        let on = SurfaceVerification::default();
        let base = Evidence {
            matches: 1000,
            inliers: 40,
            overlap: 0.4,
            normal_agreement: 0.8,
            plane_residual: 0.3,
            free_space_violation: 0.02,
            localizability: 0.05,
            ..Evidence::default()
        };
        let varied = |evidence: [Evidence; 2], settings: &SurfaceVerification| {
            let judged = evidence
                .map(|e| (probability(&e, settings, &USUAL), exceeds_free_space_limit(&e, settings, &USUAL)));
            judged[0] != judged[1]
        };
        let seen_through = [base, Evidence { free_space_violation: 0.5, ..base }];
        let sliding = [base, Evidence { localizability: 0.0, second_best_inliers: 25, ..base }]
            .map(|e| Evidence { second_best_inliers: 25, ..e });
        let by_chance = [base, Evidence { chance_inliers: 20.0, ..base }];
        let without = SurfaceVerification { free_space: false, ..on.clone() };
        assert!(varied(seen_through, &on) && !varied(seen_through, &without));
        let without = SurfaceVerification { localizability: false, ..on.clone() };
        assert!(varied(sliding, &on) && !varied(sliding, &without));
        let without = SurfaceVerification { chance_inliers: false, ..on.clone() };
        assert!(varied(by_chance, &on) && !varied(by_chance, &without));
        let sure: Vec<SurePair> = (1..9).map(|k| ((0, k), [0.5; 2])).collect();
        assert_eq!(viewpoint_reliability(9, &sure, &on), [0.0; 9]);
        for without in [
            SurfaceVerification { free_space: false, ..on.clone() },
            SurfaceVerification { viewpoint_reliability: false, ..on.clone() },
        ] {
            assert_eq!(viewpoint_reliability(9, &sure, &without), [1.0; 9]);
        }
    }
}
