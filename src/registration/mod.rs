//! Pairwise and incremental multiview registration.

pub mod agglomerate;
pub mod assembly;
pub mod assessment;
pub mod config;
pub mod estimate;
pub mod evidence;
pub mod growth;
pub mod incremental;
pub mod joint;
pub mod matching;
pub mod meta_shape;
pub mod nearest;
mod neighbourhood;
pub mod pairs;
pub mod pairwise;
pub mod refinement;
pub mod scan_model;
mod shade;
pub mod surface_fit;

pub use config::RegistrationConfig;
