//! Which pairs and scans of a result are right, judged by limits on the errors of relative poses.

use super::pose_error::{PoseError, PoseReport};
use crate::scan::{Reconstruction, ScanId};
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// A wrongly placed scan that was stated to be right with more than this probability counts as confident.
pub const CONFIDENT: f64 = 0.9;

/// When the relative pose of two scans is right, and which pairs are judged.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Limits {
    /// Largest translation error of a right pair, metres.
    pub max_translation_m: f64,
    /// Largest rotation error of a right pair, degrees.
    pub max_rotation_deg: f64,
    /// Only pairs whose true centres lie at most this far apart are judged, metres; all where `None`.
    pub within_m: Option<f64>,
}

impl Limits {
    fn hold(&self, error: &PoseError) -> bool {
        error.translation_m <= self.max_translation_m && error.rotation_deg <= self.max_rotation_deg
    }
}

/// A scan most of whose judged pairs within its component are wrong.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct WronglyPlaced {
    /// The scan.
    pub scan: ScanId,
    /// Probability that its pose was stated to be right with; `None` where none is stated.
    pub probability: Option<f64>,
}

/// Right and wrong pairs and scans of a result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlacementReport {
    /// What is right.
    pub limits: Limits,
    /// All pairs of scans of the truth that are judged, also those without an estimate.
    pub judged_pairs: usize,
    /// Those within the limits.
    pub right_pairs: usize,
    /// Those within a component and beyond the limits. The others have a declined scan, or scans of
    /// different components.
    pub wrong_pairs: usize,
    /// Scans with a pose.
    pub placed: usize,
    /// Those wrongly placed.
    pub wrongly_placed: Vec<WronglyPlaced>,
    /// Wrongly placed scans with a stated probability above [`CONFIDENT`].
    pub confidently_wrong: usize,
}

impl PlacementReport {
    /// Judges a result by the errors `poses` of its pairs. `true_centres` are the centres of all scans in
    /// the frame of the truth, metres; may be empty without [`Limits::within_m`].
    pub fn new(
        reconstruction: &Reconstruction,
        poses: &PoseReport,
        true_centres: &[Point3<f64>],
        limits: Limits,
    ) -> Self {
        let judged = |i: usize, j: usize| {
            limits.within_m.is_none_or(|limit| (true_centres[i] - true_centres[j]).norm() <= limit)
        };
        let n = reconstruction.outcomes.len();
        let judged_pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))).filter(|p| judged(p.0, p.1));
        let judged_pairs = judged_pairs.count();
        let (mut right, mut wrong) = (vec![0; n], vec![0; n]);
        for pair in poses.pairs.iter().filter(|p| judged(p.i.0, p.j.0)) {
            let counts = match pair.error.is_some_and(|e| limits.hold(&e)) {
                true => &mut right,
                false => &mut wrong,
            };
            counts[pair.i.0] += 1;
            counts[pair.j.0] += 1;
        }
        let probability = |scan: usize| reconstruction.outcomes[scan].placement()?.evidence?.probability;
        let wrongly_placed: Vec<WronglyPlaced> = (0..n)
            .filter(|&scan| wrong[scan] > right[scan])
            .map(|scan| WronglyPlaced { scan: ScanId(scan), probability: probability(scan) })
            .collect();
        let confident = |w: &&WronglyPlaced| w.probability.is_some_and(|p| p > CONFIDENT);
        Self {
            limits,
            judged_pairs,
            // Every pair was counted at both of its scans.
            right_pairs: right.iter().sum::<usize>() / 2,
            wrong_pairs: wrong.iter().sum::<usize>() / 2,
            placed: poses.placed,
            confidently_wrong: wrongly_placed.iter().filter(confident).count(),
            wrongly_placed,
        }
    }

    /// Right pairs over judged pairs; `None` where no pair is judged.
    pub fn right_share(&self) -> Option<f64> {
        (self.judged_pairs > 0).then(|| self.right_pairs as f64 / self.judged_pairs as f64)
    }

    /// Whether a scan is wrongly placed.
    pub fn is_wrong(&self, scan: ScanId) -> bool {
        self.wrongly_placed.iter().any(|w| w.scan == scan)
    }
}

#[cfg(test)]
mod tests {
    use super::super::pose_error::evaluate_against_truth;
    use super::*;
    use crate::geometry::RigidMotion;
    use crate::scan::{DeclineReason, Evidence, Outcome, Placement};
    use nalgebra::Vector3;

    fn placed(world_from_scan: RigidMotion, component: usize, probability: Option<f64>) -> Outcome {
        let mut placement = Placement::at(world_from_scan, component);
        placement.evidence = probability.map(|p| {
            let mut changed = Evidence::default();
            changed.probability = Some(p);
            changed
        });
        Outcome::Placed(placement)
    }

    /// Seven scans a metre apart in a row: 0 to 4 in a component, 5 in another, 6 declined. Scan 2 is
    /// off by 0.3 m, scan 4 by 8°.
    fn row() -> (Vec<RigidMotion>, Reconstruction) {
        let truth: Vec<RigidMotion> = (0..7).map(|k| RigidMotion::translation(k as f64, 0.0, 0.0)).collect();
        let pose = |k: usize| match k {
            2 => RigidMotion::translation(0.0, 0.3, 0.0) * truth[2],
            4 => truth[4] * RigidMotion::rotation(Vector3::z() * 8f64.to_radians()),
            _ => truth[k],
        };
        let mut outcomes: Vec<Outcome> =
            (0..6).map(|k| placed(pose(k), usize::from(k == 5), [None, Some(0.95)][k % 2])).collect();
        outcomes[2] = placed(pose(2), 0, Some(0.95));
        outcomes[4] = placed(pose(4), 0, Some(0.9));
        outcomes.push(Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 1, needed: 3 }));
        (truth, Reconstruction::new(outcomes))
    }

    fn judged(limits: Limits) -> PlacementReport {
        let (truth, reconstruction) = row();
        let poses = evaluate_against_truth(&reconstruction, &truth).unwrap();
        let centres: Vec<_> = truth.iter().map(|t| t * Point3::origin()).collect();
        PlacementReport::new(&reconstruction, &poses, &centres, limits)
    }

    fn scans(report: &PlacementReport) -> Vec<usize> {
        report.wrongly_placed.iter().map(|w| w.scan.0).collect()
    }

    #[test]
    fn all_pairs_of_the_truth_count_and_a_scan_with_mostly_wrong_pairs_is_wrong() {
        let limits = Limits { max_translation_m: 0.2, max_rotation_deg: 5.0, within_m: None };
        let r = judged(limits);
        // Of 7·6/2 pairs, 5·4/2 are within the component, and three of those are of 0, 1 and 3 alone.
        assert_eq!((r.judged_pairs, r.right_pairs, r.wrong_pairs, r.placed), (21, 3, 7, 6));
        assert!((r.right_share().unwrap() - 1.0 / 7.0).abs() < 1e-12);
        assert_eq!(scans(&r), [2, 4]);
        // Exactly .9 is not above it.
        assert_eq!((r.wrongly_placed[1].probability, r.confidently_wrong), (Some(0.9), 1));
        assert!(r.is_wrong(ScanId(4)) && !r.is_wrong(ScanId(3)));
        // Either limit alone: scan 4 turned about its own zero moves no zero but those seen from it.
        let turned = judged(Limits { max_translation_m: 100.0, ..limits });
        assert_eq!((scans(&turned), turned.wrong_pairs), (vec![4], 4));
        let shifted = judged(Limits { max_rotation_deg: 180.0, ..limits });
        // The zero of scan 4 lies right for 0, 1 and 3: the errors are measured at the later scan.
        assert_eq!((scans(&shifted), shifted.wrong_pairs), (vec![2], 4));
        assert!(
            judged(Limits { max_translation_m: 0.31, max_rotation_deg: 8.1, within_m: None })
                .wrongly_placed
                .is_empty()
        );
    }

    #[test]
    fn only_pairs_within_the_distance_are_judged() {
        let near = Limits { max_translation_m: 0.2, max_rotation_deg: 5.0, within_m: Some(1.5) };
        // The six neighbours in the row; 0–1 is right, 1–2, 2–3 and 3–4 are wrong.
        let r = judged(near);
        assert_eq!((r.judged_pairs, r.right_pairs, r.wrong_pairs), (6, 1, 3));
        // Scan 1 has one right and one wrong pair: not most.
        assert_eq!(scans(&r), [2, 3, 4]);
        let none = judged(Limits { within_m: Some(0.5), ..near });
        assert_eq!((none.judged_pairs, none.right_share()), (0, None));
        assert!(none.wrongly_placed.is_empty());
    }
}
