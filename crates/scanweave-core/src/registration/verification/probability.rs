//! What a registration must show before it counts as right.
//!
//! Inlier counts alone cannot tell a right pose from a flip or a slide along repeated
//! structure. The evidence of a pose joins eight measurements in one logistic score: inlier
//! matches, how far they lead the next distinct hypothesis, how many of them chance explains, how
//! much surface touches, whether normals agree there, how far points lie off the tangent planes, how much lies in space that
//! was seen to be empty, and how firmly the touching surface fixes the pose.

use crate::registration::config::SurfaceVerification;
use crate::scan::Evidence;

/// Beyond this share of free-space violations more of them say no more unless viewpoints are reliable: where
/// scans do not tell where the sensor stood, right joins reach it too, and must still be possible.
const MOST_VIOLATION: f64 = 0.2;

/// Violation that a right pose does not exceed where viewpoints are reliable: 9 of 3082 right proposals
/// did of those that `examples/evidence_calibration.rs` measured in four 3DMatch scenes and two
/// synthetic buildings, and three quarters of the wrong ones.
pub const MOST_VIOLATION_OF_CORRECT: f64 = 0.125;

/// What right poses usually show: it stands for a measurement that is switched off. The figures are
/// those at which the weighted term equals its mean over the right proposals that the weights were
/// fitted to (`examples/evidence_calibration.rs`).
const USUAL_VIOLATION: f64 = 0.02;
const USUAL_LOCALIZABILITY: f64 = 0.0787;
const USUAL_CHANCE_SHARE: f64 = 0.0092;

/// Whether the viewpoints of the scans are reliable, and with them what lies in space seen to be
/// empty: then the surest pairs, judged without it, show next to none.
///
/// A fifth of one scan's surface in the air of another means a wrong pose where viewpoints are
/// known; where they are made up it means nothing.
pub fn viewpoints_are_reliable<'a>(
    surest: impl Iterator<Item = &'a Evidence>,
    settings: &SurfaceVerification,
) -> bool {
    /// Pairs below which there is nothing to conclude from.
    const FEWEST: usize = 5;
    /// Probability from which a pair is sure.
    const SURE: f64 = 0.95;
    /// Median free-space violation of the sure pairs up to which viewpoints are reliable.
    const RELIABLE: f64 = 0.05;
    if !(settings.free_space && settings.viewpoint_reliability) {
        return false;
    }
    let sure = |s: &&Evidence| {
        probability(&Evidence { free_space_violation: USUAL_VIOLATION, ..**s }, settings, false) >= SURE
    };
    let mut violations: Vec<f64> = surest.filter(sure).map(|s| s.free_space_violation).collect();
    violations.sort_by(f64::total_cmp);
    violations.len() >= FEWEST && violations[violations.len() / 2] <= RELIABLE
}

/// What the logistic model sees of evidence, in the order of [`crate::registration::config::EvidenceWeights::as_array`]:
/// 1, ln inliers, ln(inliers / inliers of the next hypothesis), ln normal agreement,
/// plane residual, ln overlap, ln free-space violation, ln localizability, free-space violation beyond a fifth (nothing unless
/// `viewpoints_reliable`), ln(inliers by chance / inliers); the logarithms of shares with 0.01
/// added, 0.05 for the normals, 0.001 for the localizability, 0.02 for chance.
///
/// Fewer than three inliers of the next hypothesis count as three: any three matches
/// agree on some motion.
pub fn predictors(evidence: &Evidence, viewpoints_reliable: bool) -> [f64; 10] {
    let inliers = evidence.inliers.max(1) as f64;
    let second_best_ratio = inliers / evidence.second_best_inliers.max(3) as f64;
    [
        1.0,
        inliers.ln(),
        second_best_ratio.ln(),
        (evidence.normal_agreement + 0.05).ln(),
        evidence.plane_residual,
        (evidence.overlap + 0.01).ln(),
        (evidence.free_space_violation.min(MOST_VIOLATION) + 0.01).ln(),
        (evidence.localizability + 1e-3).ln(),
        if viewpoints_reliable { (evidence.free_space_violation - MOST_VIOLATION).max(0.0) } else { 0.0 },
        (evidence.chance_inliers / inliers + 0.02).ln(),
    ]
}

/// Probability that a pose with this evidence is right, by the logistic model of the settings.
pub fn probability(evidence: &Evidence, settings: &SurfaceVerification, viewpoints_reliable: bool) -> f64 {
    let x = predictors(&considered(evidence, settings), viewpoints_reliable && settings.free_space);
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

/// Whether reliable viewpoints speak against a pose, so that no number of matches makes up for it:
/// two rooms furnished alike match as well as one seen twice.
pub fn exceeds_free_space_limit(
    evidence: &Evidence,
    settings: &SurfaceVerification,
    viewpoints_reliable: bool,
) -> bool {
    settings.free_space && viewpoints_reliable && evidence.free_space_violation > MOST_VIOLATION_OF_CORRECT
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

/// Whether matches do not single a pose out and must: another pose has more of them; or it has half
/// as many, and the touching surface leaves some motion free, as two walls do, so that it fits
/// elsewhere as well. A trial can still show that the other pose does not hold.
pub fn is_undecided(evidence: &Evidence, settings: &SurfaceVerification) -> bool {
    /// Localizability below which a motion is free. Of 1045 joins on five 3DMatch scenes, nearly all of
    /// them right, a hundredth lie below 0.0155.
    const FREE: f64 = 0.01;
    let slides = settings.localizability && evidence.localizability < FREE;
    let needed = if slides { 2 } else { 1 } * evidence.second_best_inliers;
    evidence.second_best_inliers > 0 && evidence.inliers <= needed
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn odds_fall_with_the_number_of_scans_beyond_those_fitted() {
        assert_relative_eq!(with_scan_count_prior(0.9, 12), 0.9);
        assert_relative_eq!(with_scan_count_prior(0.9, 60), 0.9);
        // 9 : 1 among sixty are 9 : 10 among six hundred.
        assert_relative_eq!(with_scan_count_prior(0.9, 600), 9.0 / 19.0);
        assert_eq!([with_scan_count_prior(0.0, 600), with_scan_count_prior(1.0, 600)], [0.0, 1.0]);
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
        let p = probability(&base, &settings, false);
        assert!(probability(&Evidence { inliers: 60, ..base }, &settings, false) > p);
        assert!(probability(&Evidence { second_best_inliers: 29, ..base }, &settings, false) < p);
        assert!(probability(&Evidence { chance_inliers: 3.0, ..base }, &settings, false) < p);
        assert!(probability(&Evidence { normal_agreement: 0.5, ..base }, &settings, false) < p);
        assert!(probability(&Evidence { plane_residual: 0.6, ..base }, &settings, false) < p);
        assert!(probability(&Evidence { overlap: 0.1, ..base }, &settings, false) < p);
        assert!(probability(&Evidence { free_space_violation: 0.2, ..base }, &settings, false) < p);
        let seen = |free_space_violation: f64, trusted: bool| {
            probability(&Evidence { free_space_violation, ..base }, &settings, trusted)
        };
        assert_eq!(seen(0.2, false), seen(0.6, false));
        assert!(seen(0.6, true) < seen(0.6, false) && seen(0.2, true) == seen(0.2, false));
        assert!(probability(&Evidence { localizability: 0.0, ..base }, &settings, false) < p);
    }

    #[test]
    fn a_slide_along_a_wall_is_undecided_unless_matches_single_it_out() {
        let settings = SurfaceVerification::default();
        let wall =
            Evidence { inliers: 30, second_best_inliers: 16, localizability: 0.001, ..Evidence::default() };
        assert!(is_undecided(&wall, &settings));
        assert!(!is_undecided(&Evidence { inliers: 33, ..wall }, &settings));
        assert!(!is_undecided(&Evidence { localizability: 0.05, ..wall }, &settings));
        assert!(is_undecided(&Evidence { localizability: 0.05, second_best_inliers: 40, ..wall }, &settings));
        assert!(!is_undecided(&Evidence { second_best_inliers: 0, ..wall }, &settings));
    }

    #[test]
    fn viewpoints_are_reliable_when_sure_pairs_hardly_violate_free_space() {
        let settings = SurfaceVerification::default();
        let sure = |free_space_violation: f64| Evidence {
            matches: 1000,
            inliers: 300,
            second_best_inliers: 10,
            overlap: 0.6,
            normal_agreement: 0.95,
            plane_residual: 0.2,
            free_space_violation,
            localizability: 0.08,
            ..Evidence::default()
        };
        let unsure = |free_space_violation: f64| Evidence {
            inliers: 7,
            second_best_inliers: 6,
            ..sure(free_space_violation)
        };
        let reliable =
            |member_evidence: &[Evidence]| viewpoints_are_reliable(member_evidence.iter(), &settings);
        let good = [0.0, 0.01, 0.02, 0.01, 0.2].map(sure);
        assert!(reliable(&good));
        assert!(!reliable(&good[..4]), "four pairs are too few to conclude from");
        assert!(!reliable(&[0.0, 0.2, 0.3, 0.2, 0.25].map(sure)));
        // What is not sure says nothing, however much of it there is.
        let mixed: Vec<Evidence> = good.into_iter().chain((0..20).map(|_| unsure(0.4))).collect();
        assert!(reliable(&mixed));
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
            probability(&evidence, &settings, false),
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
            let judged = evidence.map(|e| {
                let limits = (is_undecided(&e, settings), exceeds_free_space_limit(&e, settings, true));
                (probability(&e, settings, true), limits)
            });
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
        let surest = vec![Evidence { inliers: 500, overlap: 0.8, ..base }; 9];
        assert!(viewpoints_are_reliable(surest.iter(), &on));
        for without in [
            SurfaceVerification { free_space: false, ..on.clone() },
            SurfaceVerification { viewpoint_reliability: false, ..on.clone() },
        ] {
            assert!(!viewpoints_are_reliable(surest.iter(), &without));
        }
    }
}
