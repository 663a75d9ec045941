//! How probable a relative pose is, by what matches and surfaces say of it.

pub(crate) mod alignment;
pub(super) mod config;
pub(crate) mod decline;
pub(crate) mod noise_level;
pub(crate) mod probability;
mod shipped;
pub(crate) mod surface_fit;
pub(crate) mod verifier;
