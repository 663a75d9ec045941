//! `scanweave register` on what people have on disk: the formats that scans come in, the coordinates
//! they come in, and what users say about them.
//!
//! Every input is made here, from views of a room whose poses are known.

#[path = "../cli_common/mod.rs"]
mod cli_common;

mod clouds;
mod frames;
mod images;
mod place;
mod priors;
mod reading;
mod registered;
mod scanners;
mod tables;
