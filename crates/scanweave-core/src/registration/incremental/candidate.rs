//! What is remembered of a candidate between steps.

use crate::registration::config::RegistrationConfig;
use crate::registration::pairwise::estimate::{Hypothesis, estimate};
use crate::registration::input::ScanInput;
use crate::registration::pairwise::matching::{Matches, NearestCache};
use crate::registration::incremental::meta_shape::MetaShape;
use crate::registration::pairwise::nearest::Columns;
use crate::scan::ScanId;

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
        scan: ScanInput<'_>,
        meta: &MetaShape,
        config: &RegistrationConfig,
        radius_m: f32,
        seed: u64,
        id: ScanId,
    ) {
        self.nearest.update(meta);
        let matches = self.nearest.mutual(&scan.features.keypoints, meta);
        if matches != self.matches {
            // One stream of random numbers a scan: the outcome depends on the matches alone.
            let seed = seed ^ (id.0 as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            self.hypotheses = estimate(&matches, &config.estimator, f64::from(radius_m), seed);
            self.matches = matches;
        }
    }
}
