//! Registration of unordered, partially overlapping 3-D scans.
//!
//! ```text
//! files → Scan → Surface, Features → SimilarityMatrix → Reconstruction → poses, merged cloud
//!     io     preprocessing, descriptor   retrieval       registration     result
//! ```
//!
//! [`pipeline::run`] is that line as code. Poses are `target_from_source`; the pose of a scan is
//! `world_from_scan`. Lengths are metres, angles radians. The order of scans carries no meaning.
//! The library neither prints nor panics: it returns [`Error`]s and reports progress to a
//! [`Monitor`].
#![forbid(unsafe_code)]
#![warn(missing_docs)]
#![cfg_attr(
    not(test),
    warn(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::todo,
        clippy::dbg_macro,
        clippy::print_stdout,
        clippy::print_stderr,
        clippy::iter_over_hash_type
    )
)]

mod atomic;
pub mod config;
pub mod descriptor;
mod error;
pub mod files;
pub mod geometry;
pub mod io;
mod monitor;
mod output_folder;
mod owner;
pub mod pipeline;
pub mod preprocessing;
mod printable;
pub mod random;
mod register;
pub mod registration;
pub mod result;
pub mod retrieval;
pub mod scan;
pub mod synchronization;
mod tensor_file;

pub use config::Config;
pub use error::{Error, ErrorKind, Result};
pub use monitor::{Monitor, Silent};
/// Appears in signatures: motions, points and matrices are its.
pub use nalgebra;
pub use register::{RegisteredPair, register, register_pair, register_pair_with};
pub use scan::{PointCloud, Reconstruction, Scan};
