//! What a registration is given.

use super::prior::PosePrior;
use crate::error::{Error, Result};
use crate::scan::{Features, ScanId, SimilarityMatrix, Surface};

/// Keypoints below which a scan is not tried.
pub const MIN_KEYPOINTS: usize = 3;

/// What the registration needs of one scan.
#[derive(Debug, Clone, Copy)]
pub struct ScanInput<'a> {
    /// Keypoints and descriptors.
    pub features: &'a Features,
    /// The thinned surface with normals, for evidence and multiview ICP.
    pub surface: &'a Surface,
    /// What is known of its pose before.
    pub prior: PosePrior,
}

impl<'a> ScanInput<'a> {
    /// A scan of whose pose nothing is known.
    pub fn new(features: &'a Features, surface: &'a Surface) -> Self {
        Self { features, surface, prior: PosePrior::default() }
    }
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

/// What a scan is, whatever it is called and wherever it stands in the input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct ContentDigest(pub [u8; 16]);

impl ContentDigest {
    /// Of keypoints, descriptors and surface.
    pub fn of(scan: &ScanInput<'_>) -> Self {
        let mut hasher = blake3::Hasher::new();
        let mut add = |values: &mut dyn Iterator<Item = f32>| {
            let bytes: Vec<u8> = values.flat_map(f32::to_le_bytes).collect();
            hasher.update(&(bytes.len() as u64).to_le_bytes()).update(&bytes);
        };
        add(&mut scan.features.keypoints.iter().flat_map(|p| [p.x, p.y, p.z]));
        add(&mut scan.features.descriptors.values().iter().copied());
        add(&mut scan.surface.points.iter().flat_map(|p| [p.x, p.y, p.z]));
        let mut digest = [0; 16];
        digest.copy_from_slice(&hasher.finalize().as_bytes()[..16]);
        Self(digest)
    }
}
