//! Whole tables from one file: data sets × methods × keypoint counts × seeds.
//!
//! A [`Suite`] says what is compared; its `plan` lists the cells, each a scene registered by one
//! method with one number of keypoints and one seed. [`run`](fn@run) computes the cells that are
//! not there yet, each into a file of its own; `table` sums them up. A run killed at any moment
//! goes on where it stopped, because a cell's file appears whole or not at all and carries a hash
//! of everything it depends on.

pub(crate) mod cell;
mod group;
mod loaded;
mod markdown;
pub(crate) mod merge;
pub(crate) mod output;
mod page;
pub(crate) mod plan;
mod plots;
pub(crate) mod run;
pub(crate) mod suite;
pub(crate) mod table;
pub(crate) mod trust;

pub use crate::pipeline::Shard;
pub use cell::{Cell, CellKey};
pub use merge::merge;
pub use plan::Plan;
pub use run::{Options, Progress, run};
pub use suite::Suite;
