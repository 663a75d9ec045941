//! Registration of an unordered pile of partially overlapping 3-D scans.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod error;
pub mod evaluation;
pub mod geometry;
pub mod monitor;
pub mod scan;
pub mod synthetic;

pub use error::{Error, ErrorKind, Result};
pub use monitor::{Monitor, Silent};
