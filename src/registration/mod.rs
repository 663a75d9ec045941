//! Pairwise and incremental multiview registration.

pub mod config;
pub mod estimate;
pub mod evidence;
pub mod growth;
pub mod incremental;
pub mod joint;
pub mod matching;
pub mod meta_shape;
pub mod nearest;
pub mod pairwise;
pub mod refinement;

pub use config::RegistrationConfig;
