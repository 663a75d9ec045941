//! Where the real scans are: tests that need them are ignored unless asked for, and then fail
//! without them.
#![allow(dead_code, reason = "every test program uses what it needs")]

use std::path::PathBuf;

/// The folder that `SCANWEAVE_DATA` names.
pub fn data() -> PathBuf {
    let folder = std::env::var_os("SCANWEAVE_DATA").expect("SCANWEAVE_DATA names the real scans");
    let folder = PathBuf::from(folder);
    assert!(folder.is_dir(), "SCANWEAVE_DATA names {}, which is no folder", folder.display());
    folder
}

/// A file or folder beside that folder.
pub fn beside_data(relative: &str) -> PathBuf {
    let path = data().join("..").join(relative);
    assert!(path.exists(), "{} is missing", path.display());
    path
}
