//! Registration recall of 3DMatch, 3DLoMatch and ETH.
//!
//! A pair counts as registered when its error, weighted by the information matrix of
//! `gt.info`, is at most the threshold (Choi, Zhou, Koltun 2015; Zeng et al. 2017).

use super::mean;
use crate::geometry::RigidMotion;
use crate::scan::{PairTruth, ScanId};
use crate::{Error, Result};
use nalgebra::{Matrix6, Vector6};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What published evaluators add to Λ₀₀ of a pair without information.
const ZERO_INFORMATION_FLOOR: f64 = 1e-6;

/// The protocol of a registration recall.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RecallConfig {
    /// Largest RMSE of a registered pair, metres: 0.2 for 3DMatch and 3DLoMatch, 0.5 for ETH.
    pub threshold_m: f64,
    /// Leave out pairs of scans that follow each other (|i − j| = 1), as the benchmarks do.
    pub skip_adjacent: bool,
    /// Drop the first counted pair of a scene, as a published evaluator does by mistake.
    pub reference_quirks: bool,
}

impl Default for RecallConfig {
    fn default() -> Self {
        Self { threshold_m: 0.2, skip_adjacent: true, reference_quirks: false }
    }
}

impl RecallConfig {
    /// The ETH protocol: 0.5 m.
    pub fn eth() -> Self {
        Self { threshold_m: 0.5, ..Self::default() }
    }

    /// Checks the threshold.
    ///
    /// # Errors
    /// [`Error::Setting`] when it is not a positive number.
    pub fn validate(&self) -> Result<()> {
        if self.threshold_m > 0.0 && self.threshold_m.is_finite() {
            return Ok(());
        }
        Err(Error::setting(
            "evaluation.threshold_m",
            self.threshold_m.to_string(),
            "a positive number of metres",
            "use 0.2 for 3DMatch and 3DLoMatch, 0.5 for ETH",
        ))
    }
}

/// Outcome of one counted pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairRecall {
    /// Target scan.
    pub i: ScanId,
    /// Source scan.
    pub j: ScanId,
    /// Information-weighted error, metres; `None` when the pair has no estimate.
    pub rmse_m: Option<f64>,
    /// Within the threshold.
    pub success: bool,
    /// Its information matrix says nothing (Λ₀₀ = 0).
    pub zero_information: bool,
}

/// Registration recall of one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
pub struct RecallReport {
    /// Pairs the protocol counts.
    pub counted: usize,
    /// Counted pairs within the threshold, within all components.
    pub succeeded: usize,
    /// Those of them in the largest component; `None` in reports of earlier versions.
    #[serde(default)]
    pub succeeded_in_largest: Option<usize>,
    /// Counted pairs without information.
    pub zero_information: usize,
    /// Counted pairs without an estimate; they count as failures.
    pub declined: Vec<(ScanId, ScanId)>,
    /// Every counted pair, in the order of the truth.
    pub pairs: Vec<PairRecall>,
}

impl RecallReport {
    /// Successes over counted pairs; `None` without a counted pair.
    pub fn recall(&self) -> Option<f64> {
        (self.counted > 0).then(|| self.succeeded as f64 / self.counted as f64)
    }

    /// Successes in the largest component over all counted pairs; `None` without a counted pair, and
    /// where they were not told apart.
    pub fn recall_in_largest(&self) -> Option<f64> {
        let succeeded = self.succeeded_in_largest?;
        (self.counted > 0).then(|| succeeded as f64 / self.counted as f64)
    }
}

/// Recall over several scenes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecallSummary {
    /// Mean of the scenes' recalls: the headline. `None` without a scene with counted pairs.
    pub mean_of_scenes: Option<f64>,
    /// All successes over all counted pairs.
    pub pooled: Option<f64>,
    /// As `mean_of_scenes`, in the largest component of each scene alone; `None` where any scene does
    /// not tell.
    pub mean_of_scenes_in_largest: Option<f64>,
    /// As `pooled`, in the largest component of each scene alone; `None` where any scene does not tell.
    pub pooled_in_largest: Option<f64>,
    /// Scenes with counted pairs.
    pub scenes: usize,
    /// Scenes without, which are in neither figure.
    pub empty_scenes: usize,
}

impl RecallSummary {
    /// Sums up scenes.
    pub fn new<'a>(scenes: impl IntoIterator<Item = &'a RecallReport>) -> Self {
        let (all, empty): (Vec<&RecallReport>, Vec<&RecallReport>) =
            scenes.into_iter().partition(|scene| scene.counted > 0);
        let counted: usize = all.iter().map(|scene| scene.counted).sum();
        let pooled = |succeeded: usize| (counted > 0).then(|| succeeded as f64 / counted as f64);
        let recalls: Vec<f64> = all.iter().filter_map(|scene| scene.recall()).collect();
        // Not of those scenes alone that tell: they would be other scenes than those of the other figures.
        let largest: Option<Vec<usize>> = all.iter().map(|scene| scene.succeeded_in_largest).collect();
        let recalls_in_largest: Option<Vec<f64>> =
            all.iter().map(|scene| scene.recall_in_largest()).collect();
        Self {
            mean_of_scenes: mean(&recalls),
            pooled: pooled(all.iter().map(|scene| scene.succeeded).sum()),
            mean_of_scenes_in_largest: recalls_in_largest.and_then(|recalls| mean(&recalls)),
            pooled_in_largest: largest.and_then(|succeeded| pooled(succeeded.iter().sum())),
            scenes: recalls.len(),
            empty_scenes: empty.len(),
        }
    }
}

/// √(ξᵀ Λ ξ / Λ₀₀), metres, with ξ = [t; q_xyz] of E = truth⁻¹ · estimate and q the quaternion
/// of E with w ≥ 0. Where Λ₀₀ is zero, 1e-6 is added to it, as published evaluators do.
///
/// ξ holds half angles while `gt.info` is made for whole ones (see
/// [`super::ground_truth::information_matrix`]): that is the published protocol, kept as it is.
pub fn rmse_m(i_from_j_truth: &RigidMotion, estimate: &RigidMotion, information: &Matrix6<f64>) -> f64 {
    let error = i_from_j_truth.inverse() * estimate;
    let t = error.translation.vector;
    let q = error.rotation.quaternion();
    let v = if q.w < 0.0 { -q.imag() } else { q.imag() };
    let xi = Vector6::new(t.x, t.y, t.z, v.x, v.y, v.z);
    let scale = information[(0, 0)];
    let scale = if scale == 0.0 { ZERO_INFORMATION_FLOOR } else { scale };
    (xi.dot(&(information * xi)) / scale).max(0.0).sqrt()
}

/// Recall of a scene: `relative(i, j)` is the estimated `i_from_j` with the component that both scans
/// are in, `None` where a scan was declined or the two are in different components. Component 0 is the
/// largest; poses that are not of components have that number.
///
/// # Errors
/// An invalid config, or a counted pair without an information matrix.
pub fn registration_recall(
    pairs: &[PairTruth],
    relative: impl Fn(ScanId, ScanId) -> Option<(usize, RigidMotion)>,
    config: &RecallConfig,
) -> Result<RecallReport> {
    config.validate()?;
    let mut report = RecallReport::default();
    let mut in_largest = 0;
    let counted = pairs
        .iter()
        .filter(|p| !config.skip_adjacent || p.i.0.abs_diff(p.j.0) > 1)
        .skip(usize::from(config.reference_quirks));
    for pair in counted {
        let Some(information) = &pair.information else {
            return Err(Error::input(
                format!("pair {} {} of the ground truth", pair.i, pair.j),
                "no information matrix",
                "one entry of gt.info for every entry of gt.log",
                "use the gt.info that belongs to this gt.log",
            ));
        };
        let estimate = relative(pair.i, pair.j);
        let rmse_m = estimate.map(|e| rmse_m(&pair.i_from_j, &e.1, information));
        let success = rmse_m.is_some_and(|e| e * e <= config.threshold_m * config.threshold_m);
        let zero_information = information[(0, 0)] == 0.0;
        report.counted += 1;
        report.succeeded += usize::from(success);
        in_largest += usize::from(success && estimate.is_some_and(|e| e.0 == 0));
        report.zero_information += usize::from(zero_information);
        if rmse_m.is_none() {
            report.declined.push((pair.i, pair.j));
        }
        report.pairs.push(PairRecall { i: pair.i, j: pair.j, rmse_m, success, zero_information });
    }
    report.succeeded_in_largest = Some(in_largest);
    Ok(report)
}

#[cfg(test)]
mod tests {
    use super::super::ground_truth::information_matrix;
    use super::*;
    use crate::geometry::Point;
    use approx::assert_relative_eq;
    use nalgebra::Vector3;

    fn pair(i: usize, j: usize, information: Matrix6<f64>) -> PairTruth {
        let i_from_j = RigidMotion::new(Vector3::new(0.3, 0.1 * j as f64, -1.0), Vector3::new(0.1, 0.4, 2.9));
        PairTruth { i: ScanId(i), j: ScanId(j), i_from_j, information: Some(information) }
    }

    #[test]
    fn a_shift_is_its_own_length_and_a_turn_moves_points() {
        let points = [[1.0, 2.0, 0.5], [-0.5, 0.3, 2.0], [0.2, -1.0, 1.0]].map(Point::from);
        let information = information_matrix(&points);
        let truth = pair(0, 2, information).i_from_j;
        let shift = RigidMotion::translation(0.1, -0.2, 0.2);
        assert_relative_eq!(rmse_m(&truth, &(truth * shift), &information), 0.3, epsilon = 1e-9);
        assert_relative_eq!(rmse_m(&truth, &truth, &information), 0.0, epsilon = 1e-6);
        // Σ‖t + q × p‖² by hand, q = sin(θ/2)·axis; a turn beyond 180° has w < 0 before the sign is fixed.
        for angle in [0.3f64, -0.8, 3.5, -4.0] {
            let e = RigidMotion::new(Vector3::new(0.05, 0.0, 0.1), Vector3::z() * angle);
            let wrapped = (angle + 3.0 * std::f64::consts::PI).rem_euclid(2.0 * std::f64::consts::PI)
                - std::f64::consts::PI;
            let q = Vector3::z() * (0.5 * wrapped).sin();
            let sum: f64 = points
                .iter()
                .map(|p| (Vector3::new(0.05, 0.0, 0.1) + q.cross(&p.coords.cast())).norm_squared())
                .sum();
            let expected = (sum / 3.0).sqrt();
            assert_relative_eq!(rmse_m(&truth, &(truth * e), &information), expected, epsilon = 1e-7);
        }
    }

    #[test]
    fn pairs_are_counted_as_the_protocol_says() {
        let full = Matrix6::identity() * 5000.0;
        let pairs = [
            pair(0, 1, full),
            pair(0, 2, full),
            pair(1, 4, full),
            pair(2, 5, Matrix6::zeros()),
            pair(6, 3, full),
        ];
        let at = |i: ScanId, j: ScanId| pairs.iter().find(|p| p.i == i && p.j == j).unwrap().i_from_j;
        let off = |x: f64| RigidMotion::translation(x, 0.0, 0.0);
        // The last two are in the second largest component.
        let estimate = |i: ScanId, j: ScanId| match i.0 {
            0 => Some((0, at(i, j) * off(0.199_999))),
            1 => Some((1, at(i, j) * off(0.200_001))),
            2 => Some((1, at(i, j) * off(5.0))), // wrong, but nobody can tell
            _ => None,
        };
        let r = registration_recall(&pairs, estimate, &RecallConfig::default()).unwrap();
        assert_eq!((r.counted, r.succeeded, r.zero_information), (4, 2, 1));
        assert_eq!(r.declined, [(ScanId(6), ScanId(3))]);
        assert_eq!(r.pairs.iter().map(|p| p.success).collect::<Vec<_>>(), [true, false, true, false]);
        assert_eq!(r.recall(), Some(0.5));
        assert_eq!((r.succeeded_in_largest, r.recall_in_largest()), (Some(1), Some(0.25)));
        let all = RecallConfig { skip_adjacent: false, ..RecallConfig::default() };
        assert_eq!(registration_recall(&pairs, estimate, &all).unwrap().counted, 5);
        let quirks = RecallConfig { reference_quirks: true, ..RecallConfig::default() };
        let quirky = registration_recall(&pairs, estimate, &quirks).unwrap();
        assert_eq!((quirky.counted, quirky.succeeded, quirky.succeeded_in_largest), (3, 1, Some(0)));
        let eth = registration_recall(&pairs, estimate, &RecallConfig::eth()).unwrap();
        assert_eq!(eth.succeeded, 3);
        // 2 of 4 and 1 of 3: mean of scenes 5/12, pooled 3/7; a scene without pairs is in neither.
        let summary = RecallSummary::new([&r, &quirky, &RecallReport::default()]);
        assert_relative_eq!(summary.mean_of_scenes.unwrap(), 5.0 / 12.0);
        assert_relative_eq!(summary.pooled.unwrap(), 3.0 / 7.0);
        assert_eq!((summary.scenes, summary.empty_scenes), (2, 1));
        // 1 of 4 and 0 of 3.
        assert_relative_eq!(summary.mean_of_scenes_in_largest.unwrap(), 0.125);
        assert_relative_eq!(summary.pooled_in_largest.unwrap(), 1.0 / 7.0);
        // A report of an earlier version does not tell: neither does the summary.
        let earlier = RecallReport { succeeded_in_largest: None, ..r.clone() };
        let summary = RecallSummary::new([&earlier, &quirky]);
        assert_eq!((summary.mean_of_scenes_in_largest, summary.pooled_in_largest), (None, None));
        assert_relative_eq!(summary.pooled.unwrap(), 3.0 / 7.0);
    }

    #[test]
    fn missing_information_and_bad_thresholds_are_named() {
        let mut p = pair(3, 7, Matrix6::identity());
        p.information = None;
        let none = |_: ScanId, _: ScanId| None::<(usize, RigidMotion)>;
        let e = registration_recall(&[p], none, &RecallConfig::default()).unwrap_err().to_string();
        assert!(e.contains("pair 3 7") && e.contains("gt.info"), "{e}");
        for threshold_m in [0.0, f64::NAN] {
            let config = RecallConfig { threshold_m, ..RecallConfig::default() };
            let e = registration_recall(&[], none, &config).unwrap_err().to_string();
            assert!(e.contains("threshold_m"), "{e}");
        }
    }
}
