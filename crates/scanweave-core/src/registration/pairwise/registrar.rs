//! The one registrar of a pair: growth, joining and pose graphs all register by it.

use super::estimate::{Hypothesis, estimate};
use super::matching::{MatchTarget, Matches, NearestCache};
use super::nearest::Columns;
use crate::registration::config::EstimatorConfig;
use crate::registration::input::ContentDigest;
use crate::scan::Features;

/// What matching and the robust estimator find between two scans.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PairHypotheses {
    /// Mutual descriptor matches.
    pub matches: Matches,
    /// Distinct hypotheses for `target_from_source`, most inliers first.
    pub hypotheses: Vec<Hypothesis>,
}

/// Registers scans with each other or with a meta-shape.
#[derive(Debug, Clone, Copy)]
pub struct PairRegistrar<'a> {
    /// The robust estimator.
    pub config: &'a EstimatorConfig,
    /// τ, metres.
    pub radius_m: f64,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl PairRegistrar<'_> {
    /// Mutual matches of a scan with a target, and the motions that they suggest.
    ///
    /// `contents` are those that the random numbers follow from: the target's and the source's.
    pub fn register(
        &self,
        target: &MatchTarget<'_>,
        source: &Features,
        contents: &[ContentDigest],
    ) -> PairHypotheses {
        let mut nearest = NearestCache::new(Columns::new(&source.descriptors));
        nearest.update(target);
        let matches = nearest.mutual(&source.keypoints, target);
        let hypotheses = self.hypotheses(&matches, contents);
        PairHypotheses { matches, hypotheses }
    }

    /// Distinct motions that matches suggest, most inliers first.
    ///
    /// Every set of contents has a stream of random numbers of its own: what else is registered,
    /// and what scans are called, changes nothing.
    pub fn hypotheses(&self, matches: &Matches, contents: &[ContentDigest]) -> Vec<Hypothesis> {
        let mut hasher = blake3::Hasher::new();
        contents.iter().for_each(|c| {
            hasher.update(&c.0);
        });
        let mut stream = [0; 8];
        stream.copy_from_slice(&hasher.finalize().as_bytes()[..8]);
        estimate(matches, self.config, self.radius_m, self.seed ^ u64::from_le_bytes(stream))
    }
}
