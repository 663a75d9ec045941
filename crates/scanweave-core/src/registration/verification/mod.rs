//! How probable a relative pose is, by what matches and surfaces say of it.

pub mod alignment;
pub mod decline;
pub mod probability;
pub mod surface_fit;
pub mod verifier;
