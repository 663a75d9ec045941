//! What is remembered of a candidate between steps.

use crate::registration::input::ContentDigest;
use crate::registration::pairwise::estimate::Hypothesis;
use crate::registration::pairwise::matching::{MatchTarget, Matches, NearestCache};
use crate::registration::pairwise::nearest::Columns;
use crate::registration::pairwise::registrar::PairRegistrar;
use crate::scan::Features;

/// A candidate's matches with the meta-shape and the poses they suggest, best first.
pub(super) struct Candidate {
    nearest: NearestCache,
    pub(super) matches: Matches,
    pub(super) hypotheses: Vec<Hypothesis>,
}

impl Candidate {
    /// Nothing matched yet.
    pub(super) fn new(columns: Columns) -> Self {
        Self { nearest: NearestCache::new(columns), matches: Matches::default(), hypotheses: Vec::new() }
    }

    /// Brings matches up to date, and the hypotheses where the matches changed.
    pub(super) fn update(
        &mut self,
        features: &Features,
        content: ContentDigest,
        target: &MatchTarget<'_>,
        registrar: &PairRegistrar<'_>,
    ) {
        self.nearest.update(target);
        let matches = self.nearest.mutual(&features.keypoints, target);
        if matches != self.matches {
            self.hypotheses = registrar.hypotheses(&matches, &[content]);
            self.matches = matches;
        }
    }
}
