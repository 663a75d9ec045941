//! Why pairs failed: which scan went wrong first, at which registration step, and on what
//! evidence.
//!
//! A scan is *right* when it lies within the limit of some right scan that joined before it and
//! that it truly overlaps; the pivot is right by definition. A scan that lies so only beside wrong
//! ones was *carried along*: its error began with the scan they follow. What is left went wrong
//! itself. Distances are root mean square displacements of the scan's points.

use super::moments::Moments;
use super::recall::RecallReport;
use crate::geometry::RigidMotion;
use crate::scan::{Outcome, Placement, Reconstruction, ScanId, SimilarityMatrix};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// True overlap from which two scans say something about each other's pose: that of 3DLoMatch.
const LEAST_OVERLAP: f32 = 0.1;
/// True overlap from which a registration should succeed: that of 3DMatch.
const ENOUGH_OVERLAP: f32 = 0.3;
/// How much more overlap a scan must have with what came later for its place in the order to be
/// the mistake.
const ORDER_GAIN: f32 = 0.1;

/// How a scan, and with it a pair, came to be wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// It has no pose.
    Declined,
    /// It is in another component than the other scan of the pair.
    OtherComponent,
    /// It joined with a wrong pose though it overlapped the model well, or never would have.
    WrongPose,
    /// It joined with a wrong pose while it hardly overlapped the model; a scan that came later
    /// would have given better evidence.
    WrongOrder,
    /// It joined with a right pose and was moved away by a later refinement.
    Moved,
    /// Every join between the two scans is within the limit; their errors add up.
    Drift,
}

impl Cause {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Declined, Self::OtherComponent, Self::WrongPose, Self::WrongOrder, Self::Moved, Self::Drift];

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Declined => "declined",
            Self::OtherComponent => "other component",
            Self::WrongPose => "wrong pose",
            Self::WrongOrder => "wrong order",
            Self::Moved => "moved by refinement",
            Self::Drift => "drift",
        }
    }
}

/// What is known of one scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScanFinding {
    /// Name of the scan.
    pub scan: String,
    /// Component; `None` for a declined scan.
    pub component: Option<usize>,
    /// Registration step at which it joined.
    pub step: Option<usize>,
    /// Place of the scan it joined to.
    pub parent: Option<usize>,
    /// How it went wrong itself; `None` when it is right or was carried along.
    pub cause: Option<Cause>,
    /// Place of the scan that its error began with (itself, if it has a cause); `None` when right.
    pub origin: Option<usize>,
    /// Error relative to the parent when it joined, metres.
    pub join_error_m: Option<f64>,
    /// Error relative to the parent at the end, metres.
    pub final_error_m: Option<f64>,
    /// Error relative to the pivot at the end, metres.
    pub pivot_error_m: Option<f64>,
    /// Matches with the model when it joined.
    pub matches: usize,
    /// Those within the inlier radius.
    pub inliers: usize,
    /// Probability that it was given, where one was.
    pub probability: Option<f64>,
    /// The scan registered before it that it truly overlaps most: place and overlap.
    pub best_before: Option<(usize, f32)>,
    /// The same among all others.
    pub best_after: Option<(usize, f32)>,
    /// Why it was declined.
    pub reason: Option<String>,
}

/// Why one pair failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairFinding {
    /// Benchmark that counts it.
    pub benchmark: String,
    /// Number of the target scan.
    pub i: usize,
    /// Number of the source scan.
    pub j: usize,
    /// Its error by the benchmark, metres; `None` without an estimate.
    pub rmse_m: Option<f64>,
    /// True overlap of the two.
    pub overlap: f32,
    /// What went wrong first.
    pub cause: Cause,
    /// Place of the scan that it went wrong with.
    pub scan: usize,
    /// Whether that is neither of the two: they were carried along.
    pub carried: bool,
}

/// Everything found about one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Diagnosis {
    /// Error from which a pose is wrong, metres.
    pub limit_m: f64,
    /// Every scan, in order.
    pub scans: Vec<ScanFinding>,
    /// Every failed pair.
    pub pairs: Vec<PairFinding>,
}

/// A registered scene with all that is known for true.
#[derive(Debug, Clone, Copy)]
pub struct Case<'a> {
    /// Names of the scans.
    pub names: &'a [String],
    /// Numbers of the scans, by which the pairs call them.
    pub numbers: &'a [usize],
    /// What was estimated.
    pub reconstruction: &'a Reconstruction,
    /// True `world_from_scan`.
    pub truth: &'a [RigidMotion],
    /// Moments of the scans' points.
    pub moments: &'a [Moments],
    /// True overlap.
    pub overlap: &'a SimilarityMatrix,
    /// Error from which a pose is wrong, metres.
    pub limit_m: f64,
}

impl Case<'_> {
    fn placement(&self, scan: usize) -> Option<&Placement> {
        self.reconstruction.outcomes.get(scan)?.placement()
    }

    /// Displacement of the points of `b` by the error of `a_from_b`.
    fn error_m(&self, a: usize, b: usize, a_from_b: &RigidMotion) -> f64 {
        let truth = self.truth[a].inverse() * self.truth[b];
        self.moments[b].displacement_m(&(truth.inverse() * a_from_b))
    }

    /// Error of `b` relative to `a` at the end; `None` when they have no relative pose.
    fn final_error_m(&self, a: usize, b: usize) -> Option<f64> {
        self.reconstruction.relative(ScanId(a), ScanId(b)).map(|pose| self.error_m(a, b, &pose))
    }

    /// Of `others`, the one that `scan` truly overlaps most.
    fn most_overlapping(&self, scan: usize, others: impl Iterator<Item = usize>) -> Option<(usize, f32)> {
        let scored = others.filter(|&o| o != scan).map(|o| (o, self.overlap.get(scan, o)));
        scored.reduce(|best, next| if next.1 > best.1 { next } else { best })
    }

    /// Examines every scan and every failed pair.
    pub fn diagnose(&self, recalls: &BTreeMap<String, RecallReport>) -> Diagnosis {
        let mut scans: Vec<ScanFinding> = (0..self.names.len()).map(|scan| self.facts(scan)).collect();
        for component in 0..self.reconstruction.components() {
            let mut order: Vec<(usize, usize)> = (0..scans.len())
                .filter(|&s| scans[s].component == Some(component))
                .filter_map(|s| Some((scans[s].step?, s)))
                .collect();
            order.sort_unstable();
            let order: Vec<usize> = order.into_iter().map(|o| o.1).collect();
            for at in 0..order.len() {
                self.judge(&mut scans, &order, at);
            }
        }
        let pairs = self.failed(recalls);
        let pairs = pairs.into_iter().map(|p| self.explain(p, &scans)).collect();
        Diagnosis { limit_m: self.limit_m, scans, pairs }
    }

    /// What the reconstruction itself says of a scan.
    fn facts(&self, scan: usize) -> ScanFinding {
        let placement = self.placement(scan);
        let parent = placement.and_then(|p| p.parent).map(|p| p.0);
        let evidence = placement.and_then(|p| p.evidence);
        let joined = evidence.and_then(|s| s.parent_from_scan).zip(parent);
        let declined = match self.reconstruction.outcomes.get(scan) {
            Some(Outcome::Declined(reason)) => Some(reason.to_string()),
            _ => None,
        };
        ScanFinding {
            scan: self.names[scan].clone(),
            component: placement.map(|p| p.component),
            step: placement.map(|p| p.step),
            parent,
            cause: declined.as_ref().map(|_| Cause::Declined),
            origin: declined.as_ref().map(|_| scan),
            join_error_m: joined.map(|(pose, parent)| self.error_m(parent, scan, &pose)),
            final_error_m: parent.and_then(|p| self.final_error_m(p, scan)),
            pivot_error_m: None,
            matches: placement.map_or(0, |p| p.matches),
            inliers: placement.map_or(0, |p| p.inliers),
            probability: evidence.and_then(|s| s.probability),
            best_before: None,
            best_after: None,
            reason: declined,
        }
    }

    /// Decides whether the scan at place `at` of a component's `order` is right.
    fn judge(&self, scans: &mut [ScanFinding], order: &[usize], at: usize) {
        let (scan, before) = (order[at], &order[..at]);
        let others = (0..scans.len()).filter(|s| !before.contains(s));
        scans[scan].best_after = self.most_overlapping(scan, others);
        let Some(&pivot) = before.first() else { return };
        scans[scan].pivot_error_m = self.final_error_m(pivot, scan);
        scans[scan].best_before = self.most_overlapping(scan, before.iter().copied());
        let parent = scans[scan].parent;
        let mut witnesses: Vec<usize> = before.to_vec();
        witnesses.retain(|&q| Some(q) == parent || self.overlap.get(scan, q) >= LEAST_OVERLAP);
        if witnesses.is_empty() {
            witnesses = before.to_vec();
        }
        // The parent speaks first, then those that overlap most.
        witnesses.sort_by(|&a, &b| {
            let rank = |q: usize| (Some(q) == parent, self.overlap.get(scan, q));
            rank(b).0.cmp(&rank(a).0).then(rank(b).1.total_cmp(&rank(a).1)).then(a.cmp(&b))
        });
        witnesses.retain(|&q| self.final_error_m(q, scan).is_some_and(|e| e <= self.limit_m));
        if witnesses.iter().any(|&q| scans[q].origin.is_none()) {
            return;
        }
        scans[scan].origin = match witnesses.first() {
            Some(&wrong) => scans[wrong].origin,
            None => {
                scans[scan].cause = Some(self.own_cause(&scans[scan]));
                Some(scan)
            }
        };
    }

    fn own_cause(&self, finding: &ScanFinding) -> Cause {
        if finding.join_error_m.is_some_and(|e| e <= self.limit_m) {
            return Cause::Moved;
        }
        let overlap = |best: Option<(usize, f32)>| best.map_or(0.0, |b| b.1);
        let (before, after) = (overlap(finding.best_before), overlap(finding.best_after));
        if before < ENOUGH_OVERLAP && after >= before + ORDER_GAIN {
            Cause::WrongOrder
        } else {
            Cause::WrongPose
        }
    }

    /// Failed pairs as `(benchmark, i, j, rmse)` with scans by place; where no benchmark counts any,
    /// those that truly overlap enough and are off by more than the limit.
    fn failed(&self, recalls: &BTreeMap<String, RecallReport>) -> Vec<(String, usize, usize, Option<f64>)> {
        let place = |n: ScanId| self.numbers.iter().position(|&m| m == n.0);
        if !recalls.is_empty() {
            let of = |(name, report): (&String, &RecallReport)| -> Vec<_> {
                let failed = report.pairs.iter().filter(|p| !p.success);
                failed.filter_map(|p| Some((name.clone(), place(p.i)?, place(p.j)?, p.rmse_m))).collect()
            };
            return recalls.iter().flat_map(of).collect();
        }
        let n = self.names.len();
        let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j)));
        pairs
            .filter(|&(i, j)| self.overlap.get(i, j) > ENOUGH_OVERLAP)
            .map(|(i, j)| (format!("overlap > {ENOUGH_OVERLAP}"), i, j, self.final_error_m(i, j)))
            .filter(|p| p.3.is_none_or(|e| e > self.limit_m))
            .collect()
    }

    fn explain(
        &self,
        (benchmark, i, j, rmse_m): (String, usize, usize, Option<f64>),
        scans: &[ScanFinding],
    ) -> PairFinding {
        let (a, b) = (&scans[i], &scans[j]);
        let step = |s: usize| (scans[s].step.unwrap_or(usize::MAX), s);
        let (cause, scan) = if let Some(declined) = [i, j].into_iter().find(|&s| scans[s].component.is_none())
        {
            (Cause::Declined, declined)
        } else if a.component != b.component {
            // The larger component has the lower number: the other scan is the one apart.
            (Cause::OtherComponent, if a.component > b.component { i } else { j })
        } else if a.origin == b.origin {
            (Cause::Drift, self.weakest_join(i, j, scans))
        } else {
            let first = [a.origin, b.origin].into_iter().flatten().min_by_key(|&s| step(s)).unwrap_or(j);
            (scans[first].cause.unwrap_or(Cause::WrongPose), first)
        };
        PairFinding {
            benchmark,
            i: self.numbers[i],
            j: self.numbers[j],
            rmse_m,
            overlap: self.overlap.get(i, j),
            cause,
            scan,
            carried: cause != Cause::Drift && scan != i && scan != j,
        }
    }

    /// On the path from `i` to `j` through the tree of joins, the scan whose join is off most; the
    /// later of the two where there is no tree.
    fn weakest_join(&self, i: usize, j: usize, scans: &[ScanFinding]) -> usize {
        let up = |mut s: usize| {
            let mut path = vec![s];
            while let Some(parent) = scans[s].parent.filter(|_| path.len() <= scans.len()) {
                path.push(parent);
                s = parent;
            }
            path
        };
        let (from_i, from_j) = (up(i), up(j));
        let joins = from_i
            .iter()
            .filter(|s| !from_j.contains(s))
            .chain(from_j.iter().filter(|s| !from_i.contains(s)));
        let worst = joins
            .filter_map(|&s| Some((s, scans[s].final_error_m?)))
            .reduce(|best, next| if next.1 > best.1 { next } else { best });
        worst.map_or_else(|| [i, j].into_iter().max_by_key(|&s| scans[s].step).unwrap_or(j), |w| w.0)
    }
}

#[cfg(test)]
#[path = "diagnosis_tests.rs"]
mod tests;
