//! What a registration must show before it is believed.

use super::config::EvidenceConfig;
use super::incremental::ScanInput;
use crate::scan::DeclineReason;

/// Inliers that a registration with this many matches needs.
pub fn needed_inliers(config: &EvidenceConfig, matches: usize) -> usize {
    let share = (config.min_inlier_ratio * matches as f64).ceil() as usize;
    config.min_inliers.max(share)
}

/// Why a scan cannot be registered at all, before anything is tried.
pub fn unusable(scan: &ScanInput<'_>, min_keypoints: usize) -> Option<DeclineReason> {
    let keypoints = scan.features.len();
    if keypoints < min_keypoints {
        return Some(DeclineReason::TooFewKeypoints { keypoints, needed: min_keypoints });
    }
    None
}
