//! Incremental multiview registration: the algorithm, in the paper's own steps.
//!
//! Li, Zhu, Xie & Zhu, "Incremental Multiview Point Cloud Registration with Two-stage
//! Candidate Retrieval" (Pattern Recognition 2025).

use super::agglomerate;
use super::config::{Ordering, RegistrationConfig, Strategy};
use super::growth::{Attempt, Growth};
use crate::error::{Error, Result};
use crate::monitor::Monitor;
use crate::scan::{Features, Reconstruction, ScanId, SimilarityMatrix, Surface};

/// Keypoints below which a scan is not tried.
pub(super) const MIN_KEYPOINTS: usize = 3;

/// What the registration needs of one scan.
#[derive(Debug, Clone, Copy)]
pub struct ScanInput<'a> {
    /// Keypoints and descriptors.
    pub features: &'a Features,
    /// The thinned surface with normals, for evidence and joint refinement.
    pub surface: &'a Surface,
}

/// The lengths that the registration works with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lengths {
    /// τ: matches and points within it agree, metres.
    pub inlier_radius_m: f64,
    /// Spacing of the thinned surfaces, metres.
    pub voxel_m: f64,
}

/// Registers all scans: grows a meta-shape from a pivot, scan by scan; scans that fit
/// nothing of it grow components of their own; what fits nowhere is declined.
///
/// `similarity` is `[N,N]` for the N scans. The result depends on the inputs and `seed`
/// alone, never on the number of threads.
///
/// # Errors
/// When the settings or shapes are unusable, or the monitor is cancelled.
pub fn register(
    scans: &[ScanInput<'_>],
    similarity: &SimilarityMatrix,
    config: &RegistrationConfig,
    lengths: Lengths,
    seed: u64,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    config.validate()?;
    check_shapes(scans, similarity)?;
    if config.strategy == Strategy::Assemble {
        return agglomerate::register(scans, similarity, config, lengths, seed, monitor);
    }
    monitor.begin("register", scans.len());
    let mut growth = Growth::new(scans, similarity, config, lengths, seed);
    while let Some(pivot) = growth.most_connected_scan() {
        growth.start_meta_shape(pivot);
        monitor.advance(1);
        while let Some(chosen) = retrieve_and_verify(&mut growth, config, monitor)? {
            let world_from_scan = growth.average_transformation(&chosen);
            growth.merge(&chosen, world_from_scan);
            growth.refine_if_due(monitor)?;
            monitor.advance(1);
        }
        growth.close_component(monitor)?;
    }
    monitor.end();
    Ok(growth.conclude())
}

/// Two-stage retrieval: the scans most similar to the meta-shape, then the one among
/// them that geometry supports best.
///
/// Goes down the similarity list until a candidate is certain enough; failing that, the
/// best of all sufficient ones; `None` when no scan left is sufficiently supported.
fn retrieve_and_verify(
    growth: &mut Growth<'_>,
    config: &RegistrationConfig,
    monitor: &dyn Monitor,
) -> Result<Option<Attempt>> {
    let remaining = growth.by_similarity_to_meta_shape();
    let size = match (config.ordering, config.semantic) {
        (Ordering::Similarity, _) => 1,
        (_, false) => remaining.len().max(1),
        (_, true) => config.shortlist,
    };
    let mut best: Option<Attempt> = None;
    for shortlist in remaining.chunks(size) {
        monitor.check("registration")?;
        for attempt in growth.register_pairwise(shortlist) {
            let sufficient = attempt.refusal.is_none();
            // The list is ordered by similarity, then index: a tie keeps the earlier one.
            let better = |b: &Attempt| support(&attempt, config.ordering) > support(b, config.ordering);
            if sufficient && best.as_ref().is_none_or(better) {
                best = Some(attempt);
            }
        }
        if best.as_ref().is_some_and(|b| b.support.probability.is_none_or(|p| p >= config.evidence.confident))
        {
            break;
        }
    }
    Ok(best)
}

/// What decides among candidates.
fn support(attempt: &Attempt, ordering: Ordering) -> f64 {
    let inliers = attempt.support.inliers as f64;
    match ordering {
        Ordering::Inliers | Ordering::Similarity => inliers,
        Ordering::Overlap => attempt.support.overlap,
        Ordering::Probability => attempt.support.probability.unwrap_or(inliers),
    }
}

fn check_shapes(scans: &[ScanInput<'_>], similarity: &SimilarityMatrix) -> Result<()> {
    if similarity.len() != scans.len() {
        return Err(Error::input(
            "similarity matrix",
            format!("{0}×{0} entries", similarity.len()),
            format!("one row for each of {} scans", scans.len()),
            "compute it from these scans",
        ));
    }
    let mut dims = scans.iter().enumerate().filter(|s| !s.1.features.is_empty());
    let Some((first, dim)) = dims.next().map(|(i, s)| (i, s.features.descriptors.dim())) else {
        return Ok(());
    };
    match dims.find(|(_, s)| s.features.descriptors.dim() != dim) {
        None => Ok(()),
        Some((other, s)) => Err(Error::input(
            format!("features of scan {}", ScanId(other)),
            format!("descriptors of dimension {}", s.features.descriptors.dim()),
            format!("dimension {dim}, as in scan {}", ScanId(first)),
            "compute the features of all scans with one descriptor",
        )),
    }
}
