//! Registration of two scans with each other: matches, distinct hypotheses for the relative
//! pose, and the evidence for each.

use super::assessment::{Assessment, Assessor};
use super::estimate::estimate;
use super::estimate::scoring::Correspondences;
use super::incremental::ScanInput;
use super::matching::NearestCache;
use super::meta_shape::MetaShape;
use super::nearest::Columns;
use super::surface_fit::Posed;
use crate::error::Result;
use crate::geometry::{Point, RigidMotion};
use crate::monitor::Monitor;
use crate::scan::{ScanId, SimilarityMatrix};
use rayon::prelude::*;

/// Matched keypoints of two scans, each in its scan's frame. A large pile has tens of thousands of
/// pairs, so that nothing is kept beside the points.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MatchedPoints {
    /// Keypoints of one scan, one a match.
    pub source: Box<[Point]>,
    /// Their counterparts in the other.
    pub target: Box<[Point]>,
}

/// Everything known about the relative pose of two scans, i < j.
#[derive(Debug, Clone)]
pub struct ScanPair {
    /// The scan whose frame hypotheses map into.
    pub i: ScanId,
    /// The other one.
    pub j: ScanId,
    /// Keypoints of j (sources) with their mutual matches in i (targets); none without a hypothesis.
    pub matches: MatchedPoints,
    /// Distinct hypotheses `i_from_j`, most probable first.
    pub hypotheses: Vec<Assessment>,
}

impl ScanPair {
    /// Puts the hypotheses in the order of what the assessor makes of their evidence.
    pub fn reassess(&mut self, assessor: &Assessor<'_>) {
        for h in &mut self.hypotheses {
            h.support.probability = Some(assessor.probability(&h.support));
        }
        self.hypotheses.sort_by(|x, y| y.probability().total_cmp(&x.probability()));
    }
}

/// Pairs worth comparing: every scan with the `neighbours` most similar to it; ordered.
pub fn most_similar_pairs(
    similarity: &SimilarityMatrix,
    usable: &[ScanId],
    neighbours: usize,
) -> Vec<(ScanId, ScanId)> {
    let mut pairs: Vec<(ScanId, ScanId)> = usable
        .iter()
        .flat_map(|&i| {
            let mut others: Vec<ScanId> = usable.iter().copied().filter(|&j| j != i).collect();
            others
                .sort_by(|a, b| similarity.get(i.0, b.0).total_cmp(&similarity.get(i.0, a.0)).then(a.cmp(b)));
            others.truncate(neighbours);
            others.into_iter().map(move |j| (i.min(j), i.max(j)))
        })
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Registers pairs of scans.
pub struct PairRegistration<'a> {
    scans: &'a [ScanInput<'a>],
    seed: u64,
    columns: Vec<Columns>,
}

impl<'a> PairRegistration<'a> {
    /// Prepares the descriptors for matching.
    pub fn new(scans: &'a [ScanInput<'a>], seed: u64) -> Self {
        let columns = scans.par_iter().map(|s| Columns::new(&s.features.descriptors)).collect();
        Self { scans, seed, columns }
    }

    /// Registers pairs, in their order, and weighs what is found.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn register(
        &self,
        pairs: &[(ScanId, ScanId)],
        assessor: &Assessor<'_>,
        monitor: &dyn Monitor,
    ) -> Result<Vec<ScanPair>> {
        const STAGE: &str = "pairs";
        monitor.begin(STAGE, pairs.len());
        let registered = pairs
            .par_iter()
            .map(|&(i, j)| {
                monitor.check("registration")?;
                let pair = self.register_one(i, j, assessor);
                monitor.advance(1);
                Ok(pair)
            })
            .collect();
        monitor.end();
        registered
    }

    fn register_one(&self, i: ScanId, j: ScanId, assessor: &Assessor<'_>) -> ScanPair {
        let target = MetaShape::new(i, self.scans[i.0].features);
        let mut nearest = NearestCache::new(self.columns[j.0].clone());
        nearest.update(&target);
        let matches = nearest.mutual(&self.scans[j.0].features.keypoints, &target);
        let config = assessor.config;
        // One stream of random numbers a pair: the outcome depends on the pair alone.
        let stream = ((i.0 as u64) << 32) | (j.0 as u64 + 1);
        let seed = self.seed ^ stream.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let proposals = estimate(&matches, &config.estimator, assessor.radius_m, seed);
        let motions: Vec<_> = proposals.into_iter().map(|p| p.target_from_source).collect();
        let alone =
            |s: ScanId| [Posed { model: &assessor.models[s.0], group_from_scan: RigidMotion::identity() }];
        let correspondences = Correspondences::new(&matches.source, &matches.target);
        let hypotheses = assessor.assess(&alone(i), &alone(j), &motions, &correspondences);
        let matches = match hypotheses.is_empty() {
            true => MatchedPoints::default(),
            false => MatchedPoints { source: matches.source.into(), target: matches.target.into() },
        };
        ScanPair { i, j, matches, hypotheses }
    }
}
