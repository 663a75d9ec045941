//! Registration of two scans with each other: the edges of pose graphs.

use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::overlap::two_way_overlap;
use crate::geometry::rigid::PointMover;
use crate::geometry::{Point, PointIndex, RigidMotion};
use crate::registration::config::EstimatorConfig;
use crate::registration::input::{ContentDigest, Lengths, MIN_KEYPOINTS, ScanInput};
use crate::registration::pairwise::estimate::Hypothesis;
use crate::registration::pairwise::matching::{MatchTarget, Matches};
use crate::registration::pairwise::registrar::{PairHypotheses, PairRegistrar};
use crate::registration::usability;
use crate::scan::{DeclineReason, PairKey, PairRegistration, ScanId};
use rayon::prelude::*;

/// Points of either scan whose distance to the other is measured.
const MEASURED_POINTS: usize = 1000;
/// Points farther from the other scan than this, in units of τ, are outside the overlap (0.2 m
/// at the 0.07 m of the published graphs).
const OVERLAP_REACH: f64 = 3.0;

/// Scans made ready to be registered with each other as edges of a pose graph.
pub struct EdgeRegistrar<'a> {
    scans: &'a [ScanInput<'a>],
    registrar: PairRegistrar<'a>,
    /// Keypoints of every scan, indexed with radius τ in its own frame.
    grids: Vec<RadiusGrid<'a>>,
    surfaces: Vec<PointIndex>,
    digests: Vec<ContentDigest>,
    unusable: Vec<Option<DeclineReason>>,
}

impl<'a> EdgeRegistrar<'a> {
    /// Indexes and packs what pairs have in common.
    pub fn new(scans: &'a [ScanInput<'a>], config: &'a EstimatorConfig, lengths: Lengths, seed: u64) -> Self {
        let radius_m = lengths.inlier_radius_m as f32;
        Self {
            scans,
            registrar: PairRegistrar { config, radius_m: lengths.inlier_radius_m, seed },
            grids: scans.par_iter().map(|s| RadiusGrid::new(&s.features.keypoints, radius_m)).collect(),
            surfaces: scans.par_iter().map(|s| PointIndex::new(body(s))).collect(),
            digests: scans.par_iter().map(ContentDigest::of).collect(),
            unusable: scans
                .par_iter()
                .map(|s| usability::unusable(s, MIN_KEYPOINTS, lengths.voxel_m))
                .collect(),
        }
    }

    /// The content of a pair, and whether `i` is its target: what a registration of the two is
    /// known by, whatever the scans are called.
    pub fn key(&self, i: ScanId, j: ScanId) -> (PairKey, bool) {
        let (a, b) = (self.digests[i.0], self.digests[j.0]);
        // Two scans of one content keep the order of their names.
        let forward = a < b || (a == b && i <= j);
        let (target, source) = if forward { (a, b) } else { (b, a) };
        (PairKey { target: target.0, source: source.0 }, forward)
    }

    /// Why a scan cannot be registered with any other, or `None` when it can.
    pub fn unusable(&self, scan: ScanId) -> Option<&DeclineReason> {
        self.unusable[scan.0].as_ref()
    }

    /// Registers two scans: mutual matches, robust estimate, refinement, overlap.
    ///
    /// Which of the two is the target, and the random numbers, follow from the content of the
    /// scans (see [`key`](Self::key)): calling the scans something else changes nothing.
    pub fn register(&self, i: ScanId, j: ScanId) -> PairRegistration {
        let (_, forward) = self.key(i, j);
        let (target, source) = if forward { (i, j) } else { (j, i) };
        self.register_ordered(target, source)
    }

    fn register_ordered(&self, target: ScanId, source: ScanId) -> PairRegistration {
        let [target_scan, source_scan] = [target, source].map(|s| self.scans[s.0]);
        let contents = [self.digests[target.0], self.digests[source.0]];
        let found = self.registrar.register(
            &MatchTarget::of_scan(target_scan.features),
            source_scan.features,
            &contents,
        );
        let PairHypotheses { matches, hypotheses } = found;
        let Some(Hypothesis { target_from_source, inliers }) = hypotheses.into_iter().next() else {
            return PairRegistration { matches: matches.len(), ..PairRegistration::default() };
        };
        let radius_m = self.registrar.radius_m;
        let overlap = two_way_overlap(&self.grids[target.0], &self.grids[source.0], &target_from_source);
        PairRegistration {
            target_from_source,
            matches: matches.len(),
            inliers,
            residual_m: inlier_residual_m(&matches, &target_from_source, radius_m),
            overlap: overlap.ratio,
            median_distance_m: self.median_distance_m(target, source, &target_from_source),
        }
    }

    /// Median distance of points of either scan to the other, of those within reach.
    fn median_distance_m(&self, target: ScanId, source: ScanId, target_from_source: &RigidMotion) -> f64 {
        let reach = (OVERLAP_REACH * self.registrar.radius_m) as f32;
        let mut distances = Vec::new();
        for (from, to, motion) in
            [(source, target, *target_from_source), (target, source, target_from_source.inverse())]
        {
            let mover = PointMover::new(&motion);
            let points = body(&self.scans[from.0]);
            let step = points.len().div_ceil(MEASURED_POINTS).max(1);
            distances.extend(points.iter().step_by(step).filter_map(|p| {
                let (_, squared) = self.surfaces[to.0].nearest(&mover.point(p))?;
                (squared <= reach * reach).then(|| f64::from(squared).sqrt())
            }));
        }
        if distances.is_empty() {
            return f64::INFINITY;
        }
        let middle = distances.len() / 2;
        *distances.select_nth_unstable_by(middle, f64::total_cmp).1
    }
}

/// The points a scan is made of: its surface, or its keypoints where there is none.
fn body<'a>(scan: &ScanInput<'a>) -> &'a [Point] {
    if scan.surface.is_empty() { &scan.features.keypoints } else { &scan.surface.points }
}

fn inlier_residual_m(matches: &Matches, target_from_source: &RigidMotion, radius_m: f64) -> f64 {
    let distances = matches.source.iter().zip(&matches.target).map(|(s, t)| {
        let moved = target_from_source * s.cast::<f64>();
        (moved - t.cast::<f64>()).norm_squared()
    });
    let (count, sum) = distances
        .filter(|d| *d <= radius_m * radius_m)
        .fold((0usize, 0.0), |(count, sum), d| (count + 1, sum + d));
    (sum / count.max(1) as f64).sqrt()
}
