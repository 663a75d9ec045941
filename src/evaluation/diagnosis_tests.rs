use super::super::recall::PairRecall;
use super::*;
use crate::geometry::Point;
use crate::scan::{DeclineReason, Evidence};
use nalgebra::Vector3;

/// A row of scans one metre apart, each overlapping the next by 0.4 and the one after by 0.2.
struct Row {
    names: Vec<String>,
    numbers: Vec<usize>,
    truth: Vec<RigidMotion>,
    moments: Vec<Moments>,
    overlap: SimilarityMatrix,
    reconstruction: Reconstruction,
}

impl Row {
    /// Scan `i` joined at step `i` to scan `i − 1`, all in place.
    fn new(n: usize) -> Self {
        let corners = [[-0.5, -0.5, 1.0], [0.5, -0.5, 1.0], [0.0, 0.5, 2.0]].map(Point::from);
        let values = (0..n * n).map(|at| match (at / n).abs_diff(at % n) {
            1 => 0.4,
            2 => 0.2,
            _ => 0.0,
        });
        let truth: Vec<RigidMotion> = (0..n)
            .map(|i| RigidMotion::new(Vector3::new(i as f64, 0.0, 0.0), Vector3::z() * (0.3 * i as f64)))
            .collect();
        let outcomes = (0..n).map(|i| {
            let parent = i.checked_sub(1);
            let parent_from_scan = parent.map(|p| truth[p].inverse() * truth[i]);
            let mut placement = Placement::at(truth[0].inverse() * truth[i], 0);
            placement.step = i;
            placement.parent = parent.map(ScanId);
            placement.matches = 100;
            placement.inliers = 40;
            placement.residual_m = 0.02;
            placement.evidence = parent.map(|_| {
                let mut changed = Evidence::default();
                changed.parent_from_scan = parent_from_scan;
                changed
            });
            Outcome::Placed(placement)
        });
        Self {
            names: (0..n).map(|i| format!("s{i}")).collect(),
            numbers: (0..n).map(|i| 10 + i).collect(),
            moments: vec![Moments::of(&corners); n],
            overlap: SimilarityMatrix::new(n, values.collect()).unwrap(),
            reconstruction: Reconstruction::new(outcomes.collect()),
            truth,
        }
    }

    fn placement(&mut self, scan: usize) -> &mut Placement {
        match &mut self.reconstruction.outcomes[scan] {
            Outcome::Placed(p) => p,
            Outcome::Declined(_) => panic!("scan {scan} is declined"),
        }
    }

    /// Moves scans from `from` on by `shift` along x, at the end, and the join of `from` with it.
    fn shift_from(&mut self, from: usize, shift: f64, at_join: bool) {
        let away = RigidMotion::translation(shift, 0.0, 0.0);
        for scan in from..self.names.len() {
            let p = self.placement(scan);
            p.world_from_scan = away * p.world_from_scan;
        }
        if at_join {
            let local = self.truth[from].inverse() * away * self.truth[from];
            let evidence = self.placement(from).evidence.as_mut().unwrap();
            evidence.parent_from_scan = evidence.parent_from_scan.map(|p| p * local);
        }
    }

    fn case(&self) -> Case<'_> {
        Case {
            names: &self.names,
            numbers: &self.numbers,
            reconstruction: &self.reconstruction,
            truth: &self.truth,
            moments: &self.moments,
            overlap: &self.overlap,
            limit_m: 0.2,
        }
    }

    /// With these pairs of places counted and failed.
    fn diagnose(&self, failed: &[(usize, usize)]) -> Diagnosis {
        let pair = |&(i, j): &(usize, usize)| PairRecall {
            i: ScanId(10 + i),
            j: ScanId(10 + j),
            rmse_m: Some(0.5),
            success: false,
            zero_information: false,
        };
        let report = RecallReport { pairs: failed.iter().map(pair).collect(), ..RecallReport::default() };
        self.case().diagnose(&BTreeMap::from([("b".to_owned(), report)]))
    }
}

fn origins(d: &Diagnosis) -> Vec<Option<usize>> {
    d.scans.iter().map(|s| s.origin).collect()
}

#[test]
fn a_perfect_reconstruction_has_nothing_to_say() {
    let d = Row::new(5).diagnose(&[]);
    assert!(origins(&d).iter().all(Option::is_none) && d.pairs.is_empty());
    assert!(
        d.scans.iter().skip(1).all(|s| s.join_error_m.unwrap() < 1e-9 && s.pivot_error_m.unwrap() < 1e-9)
    );
    assert_eq!(d.scans[2].best_before, Some((1, 0.4)));
    assert_eq!(d.scans[2].best_after, Some((3, 0.4)));
}

#[test]
fn a_wrong_join_is_found_with_what_it_carried_along() {
    let mut row = Row::new(6);
    row.shift_from(3, 0.6, true);
    let d = row.diagnose(&[(2, 3), (2, 4), (1, 5), (3, 5)]);
    assert_eq!(origins(&d), [None, None, None, Some(3), Some(3), Some(3)]);
    assert_eq!(d.scans[3].cause, Some(Cause::WrongPose));
    assert_eq!(d.scans[4].cause, None);
    // A pure shift moves every point by its length.
    assert!((d.scans[3].join_error_m.unwrap() - 0.6).abs() < 1e-9);
    let found: Vec<_> = d.pairs[..3].iter().map(|p| (p.i, p.j, p.cause, p.scan, p.carried)).collect();
    assert_eq!(
        found,
        [
            (12, 13, Cause::WrongPose, 3, false),
            (12, 14, Cause::WrongPose, 3, true),
            (11, 15, Cause::WrongPose, 3, true),
        ]
    );
    // Both stand on the same wrong ground: what separates them is drift.
    assert_eq!((d.pairs[3].j, d.pairs[3].cause, d.pairs[3].carried), (15, Cause::Drift, false));
}

#[test]
fn order_refinement_and_drift_are_told_apart() {
    // Scan 3 joins the model of 0 and 1 before scan 2, which it overlaps by 0.4 instead of 0.2.
    let mut early = Row::new(4);
    early.shift_from(3, 0.5, true);
    early.placement(3).step = 2;
    early.placement(3).parent = Some(ScanId(1));
    early.placement(2).step = 3;
    early.placement(3).evidence.as_mut().unwrap().parent_from_scan = None;
    let d = early.diagnose(&[(1, 3)]);
    assert_eq!((d.pairs[0].cause, d.pairs[0].scan), (Cause::WrongOrder, 3));
    assert_eq!((d.scans[3].best_before, d.scans[3].best_after), (Some((1, 0.2)), Some((2, 0.4))));

    let mut moved = Row::new(4);
    moved.shift_from(2, 0.5, false);
    let d = moved.diagnose(&[(1, 2)]);
    assert_eq!((d.pairs[0].cause, d.pairs[0].scan), (Cause::Moved, 2));
    assert!(d.scans[2].join_error_m.unwrap() < 1e-9 && d.scans[2].final_error_m.unwrap() > 0.4);

    let mut drift = Row::new(4);
    for (scan, shift) in [(1, 0.1), (2, 0.15), (3, 0.1)] {
        drift.shift_from(scan, shift, true);
    }
    let d = drift.diagnose(&[(0, 3)]);
    assert!(origins(&d).iter().all(Option::is_none));
    // The largest of the three joins on the way.
    assert_eq!((d.pairs[0].cause, d.pairs[0].scan, d.pairs[0].carried), (Cause::Drift, 2, false));
    assert!((d.scans[3].pivot_error_m.unwrap() - 0.35).abs() < 1e-9);
}

#[test]
fn scans_without_a_common_frame_are_named() {
    let mut row = Row::new(5);
    row.reconstruction.outcomes[4] =
        Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 2, needed: 3 });
    for scan in [2, 3] {
        row.placement(scan).component = 1;
    }
    row.placement(2).parent = None;
    let d = row.diagnose(&[(3, 4), (2, 1), (4, 2)]);
    let found: Vec<_> = d.pairs.iter().map(|p| (p.cause, p.scan)).collect();
    assert_eq!(found, [(Cause::Declined, 4), (Cause::OtherComponent, 2), (Cause::Declined, 4)]);
    assert!(d.scans[4].reason.as_ref().unwrap().contains("only 2 keypoints"));
    assert_eq!(d.scans[3].origin, None);
}

#[test]
fn without_benchmarks_the_pairs_that_overlap_enough_are_looked_at() {
    let mut row = Row::new(4);
    row.shift_from(2, 0.6, true);
    // No tree of joins: other methods place all scans at once.
    for scan in 1..4 {
        row.placement(scan).parent = None;
        row.placement(scan).evidence = None;
    }
    let d = row.case().diagnose(&BTreeMap::new());
    // Neighbours overlap by 0.4; only 1 and 2 are wrong to each other.
    assert_eq!(d.pairs.len(), 1);
    assert_eq!(
        (d.pairs[0].i, d.pairs[0].j, d.pairs[0].cause, d.pairs[0].scan),
        (11, 12, Cause::WrongPose, 2)
    );
    assert_eq!(d.pairs[0].benchmark, "overlap > 0.3");
}
