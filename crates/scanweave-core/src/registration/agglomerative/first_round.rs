//! Step 1 of the agglomerative registration on its own: most of the work, and a function of the scans, the
//! settings and the seed alone, pair by pair. Any part of it may be computed elsewhere.

use super::pairs::{PairScorer, ScanPair, most_similar_pairs};
use crate::error::{Error, Result};
use crate::monitor::Monitor;
use crate::registration::canonical_order::CanonicalOrder;
use crate::registration::config::{
    AgglomerativeConfig, RegistrationConfig, Strategy, SurfaceVerification, needs_surfaces,
};
use crate::registration::input::{self, ContentDigest, Lengths, ScanInput};
use crate::registration::prior;
use crate::registration::scan_model::ScanModel;
use crate::registration::usability;
use crate::registration::verification::verifier::Verifier;
use crate::scan::{ScanId, SimilarityMatrix, Surface};
use rayon::prelude::*;
use std::ops::Range;

/// The pairs that an agglomerative registration begins with. Scans are numbered in the canonical order.
pub struct FirstRound<'a> {
    scans: Vec<ScanInput<'a>>,
    planned: Vec<(ScanId, ScanId)>,
    config: &'a RegistrationConfig,
    verification: &'a SurfaceVerification,
    lengths: Lengths,
    seed: u64,
}

impl<'a> FirstRound<'a> {
    /// Plans the pairs of these scans; nothing is registered yet.
    ///
    /// # Errors
    /// Settings of another strategy, or shapes that cannot be used.
    pub fn new(
        scans: &[ScanInput<'a>],
        similarity: &SimilarityMatrix,
        config: &'a RegistrationConfig,
        lengths: Lengths,
        seed: u64,
    ) -> Result<Self> {
        config.validate()?;
        input::check_shapes(scans, similarity)?;
        let Strategy::Agglomerative(settings) = &config.strategy else {
            return Err(Error::setting(
                "registration.strategy.kind",
                config.strategy.to_string(),
                "agglomerative, whose first pairs do not depend on each other",
                "leave it out to register the pairs apart, or register in one process",
            ));
        };
        let Some(verification) = config.verification.surfaces() else {
            return Err(needs_surfaces("registration.strategy.kind", "agglomerative"));
        };
        let order = CanonicalOrder::new(scans);
        let (scans, similarity) = (order.scans(scans), order.similarity(similarity)?);
        let planned = planned_pairs(&scans, &similarity, &usability::usable(&scans, lengths), settings);
        Ok(Self { scans, planned, config, verification, lengths, seed })
    }

    /// The pairs, ordered.
    pub fn planned(&self) -> &[(ScanId, ScanId)] {
        &self.planned
    }

    /// Keypoints of a scan, to which its matches refer.
    pub fn keypoints(&self, scan: ScanId) -> usize {
        self.scans.get(scan.0).map_or(0, |s| s.features.len())
    }

    /// Of everything that pairs are registered from, besides settings: all scans in order, and lengths.
    pub fn digest(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        let lengths = [self.lengths.inlier_radius_m, self.lengths.voxel_m];
        lengths.iter().for_each(|length| {
            hasher.update(&length.to_le_bytes());
        });
        let digests: Vec<[u8; 32]> = self.scans.par_iter().map(digest_of).collect();
        digests.iter().for_each(|digest| {
            hasher.update(digest);
        });
        hasher.finalize().into()
    }

    /// Registers a stretch of the planned pairs.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn register(&self, part: Range<usize>, monitor: &dyn Monitor) -> Result<Vec<ScanPair>> {
        let pairs = self.planned.get(part).unwrap_or_default();
        let mut needed = vec![false; self.scans.len()];
        pairs.iter().for_each(|&(i, j)| [i, j].iter().for_each(|s| needed[s.0] = true));
        // Scans of no pair of this stretch only count.
        let (nothing, radius_m) = (Surface::default(), self.lengths.inlier_radius_m);
        let surfaces = self.scans.iter().zip(&needed);
        let surfaces: Vec<&Surface> =
            surfaces.map(|(s, needed)| if *needed { s.surface } else { &nothing }).collect();
        let mut models: Vec<ScanModel<'_>> =
            surfaces.into_par_iter().map(|s| ScanModel::new(s, radius_m as f32, self.config)).collect();
        models.iter_mut().zip(&self.scans).for_each(|(model, scan)| model.prior = scan.prior);
        let scorer = PairScorer::new(&self.scans, &self.config.estimator, self.seed);
        scorer.register(pairs, &Verifier::new(&models, self.verification, radius_m), monitor)
    }
}

/// The pairs of step 1: every scan with those most similar to it, and with those that rough poses put beside
/// it; ordered.
pub(super) fn planned_pairs(
    scans: &[ScanInput<'_>],
    similarity: &SimilarityMatrix,
    usable: &[ScanId],
    settings: &AgglomerativeConfig,
) -> Vec<(ScanId, ScanId)> {
    let mut planned = most_similar_pairs(similarity, usable, settings.neighbours);
    planned.extend(prior::near_pairs(scans, usable, settings.neighbours));
    planned.sort_unstable();
    planned.dedup();
    planned
}

/// Of everything that is known of a scan.
fn digest_of(scan: &ScanInput<'_>) -> [u8; 32] {
    let ScanInput { surface, prior, .. } = scan;
    let mut hasher = blake3::Hasher::new();
    hasher.update(&ContentDigest::of(scan).0);
    let mut add = |values: &[f32]| {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        hasher.update(&(bytes.len() as u64).to_le_bytes()).update(&bytes);
    };
    add(&surface.normals.iter().flat_map(|n| [n.x, n.y, n.z]).collect::<Vec<_>>());
    add(&[surface.viewpoint.x, surface.viewpoint.y, surface.viewpoint.z, surface.viewpoint_confidence]);
    add(&surface.intensities);
    // Shortest decimals: other numbers give another text.
    hasher.update(format!("{prior:?}").as_bytes());
    hasher.finalize().into()
}
