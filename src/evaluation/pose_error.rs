//! Errors of estimated poses: relative pose errors, the ScanNet protocol's distributions, and
//! a whole reconstruction against truth.

use super::{mean, median};
use crate::geometry::RigidMotion;
use crate::geometry::rotation_median;
use crate::geometry::{motion, nearest_rotation, rotation_error_rad, translation_error_m};
use crate::scan::{Placement, Reconstruction, ScanId};
use crate::{Error, Result};
use nalgebra::{Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// Rotation thresholds of the ScanNet protocol, degrees.
pub const ROTATION_THRESHOLDS_DEG: [f64; 5] = [3.0, 5.0, 10.0, 30.0, 45.0];
/// Translation thresholds of the ScanNet protocol, metres.
pub const TRANSLATION_THRESHOLDS_M: [f64; 5] = [0.05, 0.1, 0.25, 0.5, 0.75];

/// Difference of two poses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseError {
    /// Angle between the rotations, degrees.
    pub rotation_deg: f64,
    /// Distance of the translations, or of the two places of a point that is not zero, metres.
    pub translation_m: f64,
}

impl PoseError {
    /// re = arccos((tr(RᵀR_gt) − 1)/2) and te = ‖t − t_gt‖.
    pub fn between(estimate: &RigidMotion, truth: &RigidMotion) -> Self {
        Self {
            rotation_deg: rotation_error_rad(estimate, truth).to_degrees(),
            translation_m: translation_error_m(estimate, truth),
        }
    }

    /// As [`Self::between`], but with the distance between the places to which the two poses take `point`.
    /// A rotation about a zero far from the scan moves that zero not at all or the scan by much; at
    /// the scan's centre the distance is what the scan itself is off.
    pub fn at(estimate: &RigidMotion, truth: &RigidMotion, point: &Point3<f64>) -> Self {
        let translation_m = (estimate * point - truth * point).norm();
        Self { translation_m, ..Self::between(estimate, truth) }
    }
}

/// The centre of a placed scan in the coordinates of its file, where the result states it.
pub fn stated_centre(placement: &Placement) -> Option<Point3<f64>> {
    placement.pose_uncertainty.as_ref()?.centre
}

/// Error of the relative pose of two scans.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PairError {
    /// Target scan.
    pub i: ScanId,
    /// Source scan.
    pub j: ScanId,
    /// Its error; `None` when the pair has no estimate.
    pub error: Option<PoseError>,
}

/// Distribution of errors of one scene, or its average over scenes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErrorDistribution {
    /// Pairs, with and without an estimate.
    pub pairs: usize,
    /// Pairs without an estimate: beyond every threshold, infinite in the median, not in the mean.
    pub missing: usize,
    /// Share of pairs within each of [`ROTATION_THRESHOLDS_DEG`].
    pub rotation_cdf: [f64; 5],
    /// Share of pairs within each of [`TRANSLATION_THRESHOLDS_M`].
    pub translation_cdf: [f64; 5],
    /// Mean over pairs with an estimate, degrees.
    pub rotation_mean_deg: Option<f64>,
    /// Mean over pairs with an estimate, metres.
    pub translation_mean_m: Option<f64>,
    /// Median, degrees; `None` when it is infinite.
    pub rotation_median_deg: Option<f64>,
    /// Median, metres; `None` when it is infinite.
    pub translation_median_m: Option<f64>,
}

impl ErrorDistribution {
    /// Distribution over the pairs of one scene; `None` without a pair.
    pub fn of_scene(pairs: &[PairError]) -> Option<Self> {
        if pairs.is_empty() {
            return None;
        }
        let column = |of: fn(&PoseError) -> f64| -> Vec<f64> {
            pairs.iter().map(|p| p.error.as_ref().map_or(f64::INFINITY, of)).collect()
        };
        let cdf = |values: &[f64], limits: [f64; 5]| {
            limits.map(|l| values.iter().filter(|v| **v <= l).count() as f64 / values.len() as f64)
        };
        let known = |values: &[f64]| values.iter().copied().filter(|v| v.is_finite()).collect::<Vec<_>>();
        let (r, t) = (column(|e| e.rotation_deg), column(|e| e.translation_m));
        Some(Self {
            pairs: pairs.len(),
            missing: pairs.iter().filter(|p| p.error.is_none()).count(),
            rotation_cdf: cdf(&r, ROTATION_THRESHOLDS_DEG),
            translation_cdf: cdf(&t, TRANSLATION_THRESHOLDS_M),
            rotation_mean_deg: mean(&known(&r)),
            translation_mean_m: mean(&known(&t)),
            rotation_median_deg: median(r).filter(|m| m.is_finite()),
            translation_median_m: median(t).filter(|m| m.is_finite()),
        })
    }

    /// The protocol's figures of a data set: every figure averaged over the scenes that have it
    /// (the median is thus the mean of the scenes' medians). `None` without a scene.
    pub fn over_scenes(scenes: &[Self]) -> Option<Self> {
        let average =
            |of: &dyn Fn(&Self) -> Option<f64>| mean(&scenes.iter().filter_map(of).collect::<Vec<_>>());
        let cdf = |of: fn(&Self) -> &[f64; 5]| -> Option<[f64; 5]> {
            let mut out = [0.0; 5];
            for (k, v) in out.iter_mut().enumerate() {
                *v = average(&|s| Some(of(s)[k]))?;
            }
            Some(out)
        };
        Some(Self {
            pairs: scenes.iter().map(|s| s.pairs).sum(),
            missing: scenes.iter().map(|s| s.missing).sum(),
            rotation_cdf: cdf(|s| &s.rotation_cdf)?,
            translation_cdf: cdf(|s| &s.translation_cdf)?,
            rotation_mean_deg: average(&|s| s.rotation_mean_deg),
            translation_mean_m: average(&|s| s.translation_mean_m),
            rotation_median_deg: average(&|s| s.rotation_median_deg),
            translation_median_m: average(&|s| s.translation_median_m),
        })
    }
}

/// Errors of the relative poses of all pairs `i < j`, `relative(i, j)` being the estimated
/// `i_from_j`.
pub fn pair_errors(
    truth_world_from_scan: &[RigidMotion],
    relative: impl Fn(ScanId, ScanId) -> Option<RigidMotion>,
) -> Vec<PairError> {
    let n = truth_world_from_scan.len();
    let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j)));
    pairs
        .map(|(i, j)| {
            let truth = truth_world_from_scan[i].inverse() * truth_world_from_scan[j];
            let estimate = relative(ScanId(i), ScanId(j));
            let error = estimate.map(|e| PoseError::between(&e, &truth));
            PairError { i: ScanId(i), j: ScanId(j), error }
        })
        .collect()
}

/// Error of a placed scan after its component was brought into the frame of the truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScanError {
    /// The scan.
    pub scan: ScanId,
    /// Its component.
    pub component: usize,
    /// Its error.
    pub error: PoseError,
}

/// Largest and median error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Default)]
pub struct ErrorSummary {
    /// Largest rotation error, degrees.
    pub max_rotation_deg: f64,
    /// Median rotation error, degrees.
    pub median_rotation_deg: f64,
    /// Largest translation error, metres.
    pub max_translation_m: f64,
    /// Median translation error, metres.
    pub median_translation_m: f64,
}

impl ErrorSummary {
    /// Sums up errors; all zero when there is none.
    pub fn new(errors: &[PoseError]) -> Self {
        let (r, t): (Vec<f64>, Vec<f64>) = errors.iter().map(|e| (e.rotation_deg, e.translation_m)).unzip();
        let max = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
        Self {
            max_rotation_deg: max(&r),
            max_translation_m: max(&t),
            median_rotation_deg: median(r).unwrap_or(0.0),
            median_translation_m: median(t).unwrap_or(0.0),
        }
    }
}

/// A reconstruction against truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PoseReport {
    /// All scans.
    pub total: usize,
    /// Scans with a pose.
    pub placed: usize,
    /// Components among them.
    pub components: usize,
    /// Every placed scan, in a frame fitted robustly to its component.
    pub scans: Vec<ScanError>,
    /// Relative poses of every two scans of one component, all with an estimate. Measured at the
    /// centre of the source scan where the result states it, else at the zero of its file.
    pub pairs: Vec<PairError>,
    /// How many of `pairs` were measured at the centre of the source scan.
    pub pairs_at_centre: usize,
    /// Two scans in one component that truly have nothing to do with each other.
    pub false_joins: Vec<(ScanId, ScanId)>,
    /// Summary of `scans`.
    pub scan_summary: ErrorSummary,
    /// Summary of `pairs`.
    pub pair_summary: ErrorSummary,
}

/// Compares a reconstruction with the true `world_from_scan` of every scan.
///
/// # Errors
/// When the numbers of scans differ.
pub fn evaluate_against_truth(reconstruction: &Reconstruction, truth: &[RigidMotion]) -> Result<PoseReport> {
    evaluate_groups(reconstruction, truth, &vec![0; truth.len()])
}

/// As [`evaluate_against_truth`], where truth is known only within groups (`group[i]` of scan
/// `i`): poses of different groups are unrelated, and joining them is an error by itself.
///
/// # Errors
/// When the numbers of scans differ.
pub fn evaluate_groups(
    reconstruction: &Reconstruction,
    truth: &[RigidMotion],
    group: &[usize],
) -> Result<PoseReport> {
    let n = reconstruction.outcomes.len();
    if truth.len() != n || group.len() != n {
        return Err(Error::input(
            "true poses",
            format!("{} poses for {n} scans", truth.len()),
            "one true pose for every scan",
            "check that the truth belongs to these scans",
        ));
    }
    let placed: Vec<(ScanId, usize, RigidMotion)> = (0..n)
        .filter_map(|i| {
            let p = reconstruction.outcomes[i].placement()?;
            Some((ScanId(i), p.component, p.world_from_scan))
        })
        .collect();
    let (mut pairs, mut false_joins) = (Vec::new(), Vec::new());
    let centre = |scan: &ScanId| reconstruction.outcomes[scan.0].placement().and_then(stated_centre);
    let mut pairs_at_centre = 0;
    for (k, (i, ci, wi)) in placed.iter().enumerate() {
        for (j, cj, wj) in &placed[k + 1..] {
            if ci != cj {
                continue;
            }
            if group[i.0] != group[j.0] {
                false_joins.push((*i, *j));
                continue;
            }
            let truth = truth[i.0].inverse() * truth[j.0];
            let centre = centre(j);
            pairs_at_centre += usize::from(centre.is_some());
            let at = centre.unwrap_or_else(Point3::origin);
            let error = Some(PoseError::at(&(wi.inverse() * wj), &truth, &at));
            pairs.push(PairError { i: *i, j: *j, error });
        }
    }
    let mut scans = Vec::new();
    for (scan, component, world) in &placed {
        let mates: Vec<(RigidMotion, RigidMotion)> = placed
            .iter()
            .filter(|(s, c, _)| c == component && group[s.0] == group[scan.0])
            .map(|(s, _, w)| (truth[s.0], *w))
            .collect();
        let aligned = gauge(&mates) * world;
        let error = PoseError::between(&aligned, &truth[scan.0]);
        scans.push(ScanError { scan: *scan, component: *component, error });
    }
    let errors = |pairs: &[PairError]| pairs.iter().filter_map(|p| p.error).collect::<Vec<_>>();
    Ok(PoseReport {
        total: n,
        placed: placed.len(),
        components: reconstruction.components(),
        scan_summary: ErrorSummary::new(&scans.iter().map(|s| s.error).collect::<Vec<_>>()),
        pair_summary: ErrorSummary::new(&errors(&pairs)),
        scans,
        pairs,
        pairs_at_centre,
        false_joins,
    })
}

/// Motion `truth_from_estimate` that brings estimated poses onto true ones, `(truth, estimate)`
/// each `world_from_scan`: the geometric median of the rotations between them, and of the
/// offsets of the scans' origins that remain. Scans gone astray do not drag the others along.
pub fn gauge(poses: &[(RigidMotion, RigidMotion)]) -> RigidMotion {
    const ROUNDS: usize = 100;
    const TOLERANCE: f64 = 1e-12;
    let turns: Vec<(Matrix3<f64>, f64)> = poses
        .iter()
        .map(|(truth, estimate)| {
            ((truth.rotation * estimate.rotation.inverse()).to_rotation_matrix().into_inner(), 1.0)
        })
        .collect();
    let sum: Matrix3<f64> = turns.iter().map(|t| t.0).sum();
    let start = nearest_rotation(&sum).unwrap_or_else(nalgebra::Rotation3::identity);
    let rotation = rotation_median(start.matrix(), &turns, ROUNDS, TOLERANCE).unwrap_or(start);
    let offsets: Vec<Vector3<f64>> =
        poses.iter().map(|(t, e)| t.translation.vector - rotation * e.translation.vector).collect();
    let mut middle = offsets.iter().sum::<Vector3<f64>>() / offsets.len().max(1) as f64;
    for _ in 0..ROUNDS {
        let pull = |o: &Vector3<f64>| 1.0 / (o - middle).norm().max(1e-9);
        let weight: f64 = offsets.iter().map(pull).sum();
        if weight <= 0.0 {
            break;
        }
        let next = offsets.iter().map(|o| o * pull(o)).sum::<Vector3<f64>>() / weight;
        let step = (next - middle).norm();
        middle = next;
        if step < TOLERANCE {
            break;
        }
    }
    motion(rotation, middle)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{DeclineReason, Outcome, PoseUncertainty};
    use approx::assert_relative_eq;

    fn pose(k: usize) -> RigidMotion {
        let f = k as f64;
        RigidMotion::new(Vector3::new(f, 0.3 * f * f, -0.5 * f), Vector3::new(0.2 * f, -0.5, 0.1 * f))
    }

    fn placed(world_from_scan: RigidMotion, component: usize) -> Outcome {
        Outcome::Placed(Placement::at(world_from_scan, component))
    }

    fn declined() -> Outcome {
        Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 1, needed: 3 })
    }

    #[test]
    fn errors_are_the_angle_and_the_distance() {
        let e = RigidMotion::new(Vector3::new(0.3, 0.0, 0.4), Vector3::x() * 0.25);
        let error = PoseError::between(&e, &RigidMotion::identity());
        assert_relative_eq!(error.rotation_deg, 0.25f64.to_degrees(), epsilon = 1e-9);
        assert_relative_eq!(error.translation_m, 0.5, epsilon = 1e-12);
    }

    #[test]
    fn at_a_point_the_error_is_how_far_that_point_is_moved() {
        // Half a turn about the axis x = 2, y = 0 along z: a point on it stays, the zero moves by twice 2.
        let half_turn = RigidMotion::new(Vector3::new(4.0, 0.0, 0.0), Vector3::z() * std::f64::consts::PI);
        let truth = RigidMotion::identity();
        let at = |x: f64| PoseError::at(&half_turn, &truth, &Point3::new(x, 0.0, 7.0));
        assert_relative_eq!(at(2.0).translation_m, 0.0, epsilon = 1e-12);
        assert_relative_eq!(at(5.0).translation_m, 6.0, epsilon = 1e-12);
        assert_relative_eq!(at(2.0).rotation_deg, 180.0, epsilon = 1e-9);
        assert_relative_eq!(PoseError::between(&half_turn, &truth).translation_m, 4.0, epsilon = 1e-12);
    }

    #[test]
    fn pairs_are_measured_at_the_source_scans_centre_where_it_is_stated() {
        let truth = vec![RigidMotion::identity(); 3];
        // Scan 1 is turned by half a turn about its centre at x = 2; scan 2 states no centre.
        let half_turn = RigidMotion::new(Vector3::new(4.0, 0.0, 0.0), Vector3::z() * std::f64::consts::PI);
        let mut outcomes = vec![
            placed(truth[0], 0),
            placed(half_turn, 0),
            placed(RigidMotion::translation(0.0, 0.0, 0.5), 0),
        ];
        let Outcome::Placed(turned) = &mut outcomes[1] else { panic!() };
        let centre = Some(Point3::new(2.0, 0.0, 1.0));
        turned.pose_uncertainty = Some(Box::new(PoseUncertainty { centre, ..PoseUncertainty::default() }));
        let r = evaluate_against_truth(&Reconstruction::new(outcomes), &truth).unwrap();
        let found: Vec<_> = r.pairs.iter().map(|p| (p.i.0, p.j.0, p.error.unwrap().translation_m)).collect();
        assert_eq!(found.iter().map(|p| (p.0, p.1)).collect::<Vec<_>>(), [(0, 1), (0, 2), (1, 2)]);
        // Of the last pair the zero of the source comes to (4, 0, 0.5) of the turned frame instead of zero.
        for (pair, expected) in found.iter().zip([0.0, 0.5, 16.25f64.sqrt()]) {
            assert_relative_eq!(pair.2, expected, epsilon = 1e-12);
        }
        assert_eq!(r.pairs_at_centre, 1);
    }

    #[test]
    fn distributions_count_missing_pairs_as_failures() {
        let pair = |e: Option<(f64, f64)>| PairError {
            i: ScanId(0),
            j: ScanId(1),
            error: e.map(|(rotation_deg, translation_m)| PoseError { rotation_deg, translation_m }),
        };
        let scene = [pair(Some((3.0, 0.04))), pair(Some((4.0, 0.3))), pair(Some((50.0, 2.0))), pair(None)];
        let d = ErrorDistribution::of_scene(&scene).unwrap();
        assert_eq!((d.pairs, d.missing), (4, 1));
        assert_eq!(d.rotation_cdf, [0.25, 0.5, 0.5, 0.5, 0.5]);
        assert_eq!(d.translation_cdf, [0.25, 0.25, 0.25, 0.5, 0.5]);
        assert_relative_eq!(d.rotation_mean_deg.unwrap(), 19.0);
        // Sorted 3, 4, 50, ∞: between 4 and 50.
        assert_relative_eq!(d.rotation_median_deg.unwrap(), 27.0);
        let lost = ErrorDistribution::of_scene(&[pair(None), pair(None), pair(Some((1.0, 0.0)))]).unwrap();
        assert_eq!(lost.rotation_median_deg, None);
        let both = ErrorDistribution::over_scenes(&[d, lost]).unwrap();
        assert_relative_eq!(both.rotation_cdf[0], (0.25 + 1.0 / 3.0) / 2.0);
        assert_relative_eq!(both.rotation_mean_deg.unwrap(), 10.0);
        assert_eq!((both.pairs, both.missing), (7, 3));
        assert!(ErrorDistribution::of_scene(&[]).is_none() && ErrorDistribution::over_scenes(&[]).is_none());
    }

    #[test]
    fn a_perfect_result_in_another_frame_has_no_error() {
        let truth: Vec<RigidMotion> = (0..6).map(pose).collect();
        let frame = RigidMotion::new(Vector3::new(7.0, -2.0, 1.0), Vector3::new(1.0, 2.0, -0.4));
        let outcomes = truth.iter().map(|t| placed(frame * t, 0)).collect();
        let r = evaluate_against_truth(&Reconstruction::new(outcomes), &truth).unwrap();
        assert_eq!((r.total, r.placed, r.components, r.pairs.len()), (6, 6, 1, 15));
        for s in [r.scan_summary, r.pair_summary] {
            assert!(s.max_rotation_deg < 1e-5 && s.max_translation_m < 1e-9, "{s:?}");
        }
    }

    #[test]
    fn one_stray_scan_spoils_its_own_pairs_and_nothing_else() {
        let truth: Vec<RigidMotion> = (0..7).map(pose).collect();
        let frame = RigidMotion::new(Vector3::new(7.0, -2.0, 1.0), Vector3::new(1.0, 2.0, -0.4));
        let stray = RigidMotion::new(Vector3::new(0.6, 0.0, 0.8), Vector3::z() * 0.5);
        let mut outcomes: Vec<Outcome> = truth.iter().map(|t| placed(frame * t, 0)).collect();
        // Moved in the scan's own frame: the distance to truth is the length of the shift.
        outcomes[2] = placed(frame * truth[2] * stray, 0);
        outcomes[5] = declined();
        let r = evaluate_against_truth(&Reconstruction::new(outcomes), &truth).unwrap();
        assert_eq!((r.placed, r.scans.len(), r.pairs.len()), (6, 6, 15));
        for s in &r.scans {
            let expected = if s.scan.0 == 2 { (0.5f64.to_degrees(), 1.0) } else { (0.0, 0.0) };
            assert_relative_eq!(s.error.rotation_deg, expected.0, epsilon = 1e-4);
            assert_relative_eq!(s.error.translation_m, expected.1, epsilon = 1e-4);
        }
        for p in &r.pairs {
            let bad = p.i.0 == 2 || p.j.0 == 2;
            assert_eq!(p.error.unwrap().rotation_deg > 1.0, bad, "{p:?}");
        }
        assert_relative_eq!(r.scan_summary.max_translation_m, 1.0, epsilon = 1e-4);
        assert!(r.scan_summary.median_translation_m < 1e-4);
    }

    #[test]
    fn components_and_groups_are_kept_apart() {
        let truth: Vec<RigidMotion> = (0..5).map(pose).collect();
        let frames = [RigidMotion::identity(), RigidMotion::translation(3.0, 0.0, 0.0)];
        // Scans 0 1 4 in component 0, 2 3 in component 1; scan 4 belongs to another building.
        let outcomes = (0..5)
            .map(|i| {
                let c = usize::from(i == 2 || i == 3);
                placed(frames[c] * truth[i], c)
            })
            .collect();
        let rec = Reconstruction::new(outcomes);
        let r = evaluate_groups(&rec, &truth, &[0, 0, 0, 0, 1]).unwrap();
        let joined: Vec<_> = r.pairs.iter().map(|p| (p.i.0, p.j.0)).collect();
        assert_eq!(joined, [(0, 1), (2, 3)]);
        assert_eq!(r.false_joins, [(ScanId(0), ScanId(4)), (ScanId(1), ScanId(4))]);
        assert_eq!(r.components, 2);
        assert!(r.scan_summary.max_translation_m < 1e-9);
        assert!(evaluate_against_truth(&rec, &truth[1..]).is_err());
        // The ScanNet protocol sees the pairs across components as missing.
        let all = pair_errors(&truth, |i, j| rec.relative(i, j));
        assert_eq!((all.len(), all.iter().filter(|p| p.error.is_none()).count()), (10, 6));
    }
}
