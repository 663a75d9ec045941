//! Registration of two scans with each other: matches, distinct hypotheses for the relative
//! pose, and the evidence for each.

use crate::registration::verification::verifier::{Assessment, Assessor};
use crate::registration::pairwise::estimate::estimate;
use crate::registration::pairwise::correspondences::Correspondences;
use crate::registration::input::ScanInput;
use crate::registration::pairwise::matching::NearestCache;
use crate::registration::incremental::meta_shape::MetaShape;
use crate::registration::pairwise::nearest::Columns;
use crate::registration::verification::surface_fit::Posed;
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::monitor::Monitor;
use crate::scan::{ScanId, SimilarityMatrix};
use rayon::prelude::*;

/// Everything known about the relative pose of two scans, i < j.
#[derive(Debug, Clone)]
pub struct ScanPair {
    /// The scan whose frame hypotheses map into.
    pub i: ScanId,
    /// The other one.
    pub j: ScanId,
    /// Mutual matches, as `(keypoint of i, keypoint of j)`; none without a hypothesis. A large pile has
    /// tens of thousands of pairs, so that nothing more is kept of them.
    pub matches: Box<[(u32, u32)]>,
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
}

impl<'a> PairRegistration<'a> {
    /// Registers pairs of these scans with random numbers of `seed`.
    pub fn new(scans: &'a [ScanInput<'a>], seed: u64) -> Self {
        Self { scans, seed }
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
        let mut nearest = NearestCache::new(Columns::new(&self.scans[j.0].features.descriptors));
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
        let of_scans = matches.pairs.iter().map(|&(of_j, of_i)| (of_i, of_j));
        let matches = if hypotheses.is_empty() { Box::default() } else { of_scans.collect() };
        ScanPair { i, j, matches, hypotheses }
    }
}
