//! Registration of unordered, partially overlapping 3-D scans.
//!
//! The registration itself is [`scanweave_core`], which this crate re-exports: one `scanweave` is
//! all that a program names. What is added here needs Burn or is not needed to register scans:
//! training and import of weights (feature `training`), evaluation, benchmarks, reports, synthetic data.
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

// The command names the library as any other program does.
extern crate self as scanweave;

pub mod benchmark;
#[doc(hidden)]
pub mod cli;
pub mod evaluation;
pub mod fusion;
pub mod preparation;
pub mod report;
pub mod result_folder;
pub mod synthetic;
#[cfg(feature = "training")]
pub mod training;
#[cfg(feature = "training")]
pub mod weight_import;

pub use scanweave_core::*;

/// The examples of the README, compiled with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeExamples;
