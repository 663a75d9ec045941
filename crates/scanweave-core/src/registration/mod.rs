//! Pairwise and multiview registration.

pub mod agglomerative;
pub mod config;
pub mod incremental;
pub mod input;
pub mod multiview_icp;
mod neighbours;
pub mod pairwise;
pub mod scan_model;
pub mod verification;

pub use config::RegistrationConfig;
pub use input::{Lengths, ScanInput};

use crate::error::Result;
use crate::monitor::Monitor;
use crate::scan::{Reconstruction, SimilarityMatrix};
use config::Strategy;

/// Registers all scans by the strategy of the settings. Scans that only fit each other form
/// components of their own; what fits nowhere is declined.
///
/// `similarity` is `[N,N]` for the N scans. The result depends on the inputs and `seed` alone, never
/// on the number of threads.
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
    input::check_shapes(scans, similarity)?;
    match config.strategy {
        Strategy::Grow => incremental::register(scans, similarity, config, lengths, seed, monitor),
        Strategy::Assemble => agglomerative::register(scans, similarity, config, lengths, seed, monitor),
    }
}
