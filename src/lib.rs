//! Registration of an unordered pile of partially overlapping 3-D scans.
//!
//! What flows where:
//!
//! ```text
//! files → Scan → Surface, Features → SimilarityMatrix → Reconstruction → poses, merged cloud, report
//!     io     descriptor        retrieval        registration          report, io
//! ```
//!
//! [`pipeline::run`] is that line as code; [`registration::incremental`] is the algorithm.
//! Poses are `target_from_source`, a scan's pose is `world_from_scan`; lengths are metres,
//! angles radians. The order of scans carries no meaning. The library neither prints nor
//! panics: it returns [`Error`]s and reports progress to a [`Monitor`].
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

pub mod benchmark;
pub mod config;
pub mod descriptor;
pub mod error;
pub mod evaluation;
pub mod fusion;
pub mod geometry;
pub mod io;
pub mod monitor;
pub mod pipeline;
pub mod preparation;
pub mod registration;
pub mod report;
pub mod retrieval;
pub mod run_folder;
pub mod scan;
pub mod synchronization;
pub mod synthetic;
pub mod tensor_file;
pub mod training;

/// The examples of the README, compiled with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeExamples;

pub use config::Config;
pub use error::{Error, ErrorKind, Result};
pub use monitor::{Monitor, Silent};
