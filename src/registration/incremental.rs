//! Incremental multiview registration: the algorithm, in the paper's own steps.
//!
//! Li, Zhu, Xie & Zhu, "Incremental Multiview Point Cloud Registration with Two-stage
//! Candidate Retrieval" (Pattern Recognition 2025).

use super::config::{Ordering, RegistrationConfig};
use super::growth::{Attempt, Growth};
use crate::error::{Error, Result};
use crate::monitor::Monitor;
use crate::scan::{Features, Reconstruction, ScanId, SimilarityMatrix, Surface};

/// What the registration needs of one scan.
#[derive(Debug, Clone, Copy)]
pub struct ScanInput<'a> {
    /// Keypoints and descriptors.
    pub features: &'a Features,
    /// The thinned surface with normals, for evidence and joint refinement.
    pub surface: &'a Surface,
}

/// Registers all scans: grows a meta-shape from a pivot, scan by scan; scans that fit
/// nothing of it grow components of their own; what fits nowhere is declined.
///
/// `similarity` is `[N,N]` for the N scans, `inlier_radius_m` is τ. The result depends on
/// the inputs and `seed` alone, never on the number of threads.
///
/// # Errors
/// When the settings or shapes are unusable, or the monitor is cancelled.
pub fn register(
    scans: &[ScanInput<'_>],
    similarity: &SimilarityMatrix,
    config: &RegistrationConfig,
    inlier_radius_m: f64,
    seed: u64,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    config.validate()?;
    check_shapes(scans, similarity)?;
    monitor.begin("register", scans.len());
    let mut growth = Growth::new(scans, similarity, config, inlier_radius_m as f32, seed);
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
/// them that geometry supports best. Goes down the similarity list until one is
/// sufficiently supported; `None` when no scan left is.
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
    for shortlist in remaining.chunks(size) {
        monitor.check("registration")?;
        let attempts = growth.register_pairwise(shortlist);
        if let Some(best) = attempts.into_iter().filter(|a| a.accepted).reduce(|best, next| {
            // The list is ordered by similarity, then index: a tie keeps the earlier one.
            if support(&next, config.ordering) > support(&best, config.ordering) { next } else { best }
        }) {
            return Ok(Some(best));
        }
    }
    Ok(None)
}

/// What decides among candidates.
fn support(attempt: &Attempt, ordering: Ordering) -> f64 {
    match ordering {
        Ordering::Inliers | Ordering::Similarity => attempt.inliers as f64,
        Ordering::Overlap => attempt.overlap,
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
