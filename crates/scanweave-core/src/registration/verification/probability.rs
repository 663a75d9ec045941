//! What a registration must show before it is believed.
//!
//! Inlier counts alone cannot tell a right pose from a flip or a slide along repeated
//! structure. The support of a pose joins eight measurements in one logistic score: inlier
//! matches, how far they lead the next distinct hypothesis, how many of them chance explains, how
//! much surface touches, whether normals agree there, how far points lie off the tangent planes, how much lies in space that
//! was seen to be empty, and how firmly the touching surface fixes the pose.

use crate::registration::config::EvidenceWeights;
use crate::scan::Support;

/// Beyond this share of violations more of them say no more unless viewpoints are believed: where
/// scans do not tell where the sensor stood, right joins reach it too, and must still be possible.
const MOST_VIOLATION: f64 = 0.2;

/// Violation that a right pose does not exceed where viewpoints are believed: 9 of 3082 right proposals
/// did of those that `examples/evidence_calibration.rs` measured in four 3DMatch scenes and two
/// synthetic buildings, and three quarters of the wrong ones.
pub const MOST_VIOLATION_OF_RIGHT: f64 = 0.125;

/// Whether the viewpoints of the scans can be believed, and with them what lies in space seen to be
/// empty: then the surest pairs, judged without it, show next to none.
///
/// A fifth of one scan's surface in the air of another means a wrong pose where viewpoints are
/// known; where they are made up it means nothing.
pub fn sight_is_trustworthy<'a>(
    surest: impl Iterator<Item = &'a Support>,
    weights: &EvidenceWeights,
) -> bool {
    /// Pairs below which there is nothing to conclude from.
    const FEWEST: usize = 5;
    /// What a violation is taken for while it is not looked at.
    const USUAL: f64 = 0.02;
    /// Probability from which a pair is sure.
    const SURE: f64 = 0.95;
    /// Median violation of the sure pairs up to which viewpoints are believed.
    const BELIEVABLE: f64 = 0.05;
    let sure = |s: &&Support| probability(&Support { violation: USUAL, ..**s }, weights, false) >= SURE;
    let mut violations: Vec<f64> = surest.filter(sure).map(|s| s.violation).collect();
    violations.sort_by(f64::total_cmp);
    violations.len() >= FEWEST && violations[violations.len() / 2] <= BELIEVABLE
}

/// What the logistic model sees of a support, in the order of [`EvidenceWeights::as_array`]:
/// 1, ln inliers, ln(inliers / inliers of the next hypothesis), ln normal agreement,
/// plane residual, ln overlap, ln violation, ln stiffness, violation beyond a fifth (nothing unless
/// `sight_trusted`), ln(inliers by chance / inliers); the logarithms of shares with 0.01
/// added, 0.05 for the normals, 0.001 for the stiffness, 0.02 for chance.
///
/// Fewer than three inliers of the next hypothesis count as three: any three matches
/// agree on some motion.
pub fn predictors(support: &Support, sight_trusted: bool) -> [f64; 10] {
    let inliers = support.inliers.max(1) as f64;
    let lead = inliers / support.runner_up.max(3) as f64;
    [
        1.0,
        inliers.ln(),
        lead.ln(),
        (support.normal_agreement + 0.05).ln(),
        support.plane_residual,
        (support.overlap + 0.01).ln(),
        (support.violation.min(MOST_VIOLATION) + 0.01).ln(),
        (support.stiffness + 1e-3).ln(),
        if sight_trusted { (support.violation - MOST_VIOLATION).max(0.0) } else { 0.0 },
        (support.chance / inliers + 0.02).ln(),
    ]
}

/// Probability that a pose with this support is right, by the logistic model of the config.
pub fn probability(support: &Support, weights: &EvidenceWeights, sight_trusted: bool) -> f64 {
    let score: f64 =
        predictors(support, sight_trusted).iter().zip(weights.as_array()).map(|(x, w)| x * w).sum();
    1.0 / (1.0 + (-score).exp())
}

/// A probability by weights that were fitted to scenes of some sixty scans, in a pile of `scans`: a scan
/// meets as many neighbours in a larger pile but more that only look like it, so that the odds fall with
/// the number of scans.
pub fn among(probability: f64, scans: usize) -> f64 {
    /// Scans of the scenes that the weights were fitted to.
    const FITTED: f64 = 60.0;
    let odds = probability / (1.0 - probability) * (FITTED / scans as f64).min(1.0);
    if odds.is_finite() { odds / (1.0 + odds) } else { probability }
}

/// Whether matches do not single a pose out and must: another pose has more of them; or it has half
/// as many, and the touching surface leaves some motion free, as two walls do, so that it fits
/// elsewhere as well. A trial can still show that the other pose does not hold.
pub fn is_undecided(support: &Support) -> bool {
    /// Stiffness below which a motion is free. Of 1045 joins on five 3DMatch scenes, nearly all of
    /// them right, a hundredth lie below 0.0155.
    const FREE: f64 = 0.01;
    let needed = if support.stiffness < FREE { 2 * support.runner_up } else { support.runner_up };
    support.runner_up > 0 && support.inliers <= needed
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn odds_fall_with_the_number_of_scans_beyond_those_fitted() {
        assert_relative_eq!(among(0.9, 12), 0.9);
        assert_relative_eq!(among(0.9, 60), 0.9);
        // 9 : 1 among sixty are 9 : 10 among six hundred.
        assert_relative_eq!(among(0.9, 600), 9.0 / 19.0);
        assert_eq!([among(0.0, 600), among(1.0, 600)], [0.0, 1.0]);
    }

    #[test]
    fn more_of_every_good_thing_is_more_probable() {
        let weights = EvidenceWeights::default();
        let base = Support {
            matches: 1000,
            inliers: 30,
            runner_up: 15,
            chance: 0.5,
            overlap: 0.4,
            normal_agreement: 0.8,
            plane_residual: 0.3,
            violation: 0.02,
            stiffness: 0.05,
            ..Support::default()
        };
        let p = probability(&base, &weights, false);
        assert!(probability(&Support { inliers: 60, ..base }, &weights, false) > p);
        assert!(probability(&Support { runner_up: 29, ..base }, &weights, false) < p);
        assert!(probability(&Support { chance: 3.0, ..base }, &weights, false) < p);
        assert!(probability(&Support { normal_agreement: 0.5, ..base }, &weights, false) < p);
        assert!(probability(&Support { plane_residual: 0.6, ..base }, &weights, false) < p);
        assert!(probability(&Support { overlap: 0.1, ..base }, &weights, false) < p);
        assert!(probability(&Support { violation: 0.2, ..base }, &weights, false) < p);
        let seen =
            |violation: f64, trusted: bool| probability(&Support { violation, ..base }, &weights, trusted);
        assert_eq!(seen(0.2, false), seen(0.6, false));
        assert!(seen(0.6, true) < seen(0.6, false) && seen(0.2, true) == seen(0.2, false));
        assert!(probability(&Support { stiffness: 0.0, ..base }, &weights, false) < p);
    }

    #[test]
    fn a_slide_along_a_wall_is_undecided_unless_matches_single_it_out() {
        let wall = Support { inliers: 30, runner_up: 16, stiffness: 0.001, ..Support::default() };
        assert!(is_undecided(&wall));
        assert!(!is_undecided(&Support { inliers: 33, ..wall }));
        assert!(!is_undecided(&Support { stiffness: 0.05, ..wall }));
        assert!(is_undecided(&Support { stiffness: 0.05, runner_up: 40, ..wall }));
        assert!(!is_undecided(&Support { runner_up: 0, ..wall }));
    }

    #[test]
    fn viewpoints_are_believed_when_sure_pairs_hardly_contradict_them() {
        let weights = EvidenceWeights::default();
        let sure = |violation: f64| Support {
            matches: 1000,
            inliers: 300,
            runner_up: 10,
            overlap: 0.6,
            normal_agreement: 0.95,
            plane_residual: 0.2,
            violation,
            stiffness: 0.08,
            ..Support::default()
        };
        let unsure = |violation: f64| Support { inliers: 7, runner_up: 6, ..sure(violation) };
        let believed = |supports: &[Support]| sight_is_trustworthy(supports.iter(), &weights);
        let good = [0.0, 0.01, 0.02, 0.01, 0.2].map(sure);
        assert!(believed(&good));
        assert!(!believed(&good[..4]), "four pairs are too few to conclude from");
        assert!(!believed(&[0.0, 0.2, 0.3, 0.2, 0.25].map(sure)));
        // What is not sure says nothing, however much of it there is.
        let mixed: Vec<Support> = good.into_iter().chain((0..20).map(|_| unsure(0.4))).collect();
        assert!(believed(&mixed));
    }

    #[test]
    fn the_logistic_model_is_its_closed_form() {
        let weights = EvidenceWeights {
            constant: -1.0,
            ln_inliers: 1.0,
            ln_lead: 2.0,
            normal_agreement: 0.5,
            plane_residual: -1.0,
            overlap: 1.0,
            violation: -2.0,
            stiffness: 0.5,
            contradiction: -4.0,
            chance: -3.0,
        };
        let support = Support {
            matches: 100,
            inliers: 20,
            runner_up: 10,
            chance: 2.0,
            overlap: 0.5,
            normal_agreement: 0.8,
            plane_residual: 0.25,
            violation: 0.1,
            stiffness: 0.049,
            ..Support::default()
        };
        let score = -1.0 + 20f64.ln() + 2.0 * 2f64.ln() + 0.5 * 0.85f64.ln() - 0.25 + 0.51f64.ln()
            - 2.0 * 0.11f64.ln()
            + 0.5 * 0.05f64.ln()
            - 3.0 * 0.12f64.ln();
        assert_relative_eq!(
            probability(&support, &weights, false),
            1.0 / (1.0 + (-score).exp()),
            epsilon = 1e-12
        );
    }
}
