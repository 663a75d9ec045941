//! Why the evidence does not suffice.

use crate::registration::config::VerificationConfig;
use crate::scan::{DeclineReason, Evidence};

/// Why a registration does not suffice, or `None` when it does.
pub fn refusal(evidence: &Evidence, config: &VerificationConfig) -> Option<DeclineReason> {
    if evidence.inliers < config.min_inliers() {
        return Some(DeclineReason::TooFewInliers {
            inliers: evidence.inliers,
            needed: config.min_inliers(),
            matches: evidence.matches,
        });
    }
    match evidence.probability {
        Some(p) => {
            let needed = config.surfaces()?.accept;
            (p < needed).then_some(DeclineReason::WeakEvidence { evidence: *evidence, needed })
        }
        None => None,
    }
}
