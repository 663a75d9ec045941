//! What a registration is given.

use crate::error::{Error, Result};
use crate::scan::{Features, ScanId, SimilarityMatrix, Surface};

/// Keypoints below which a scan is not tried.
pub const MIN_KEYPOINTS: usize = 3;

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

pub(super) fn check_shapes(scans: &[ScanInput<'_>], similarity: &SimilarityMatrix) -> Result<()> {
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
