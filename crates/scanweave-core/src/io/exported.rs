//! Which files of a folder are scans that this program exported: moved copies, which must not be taken for more
//! scans where folders are looked through.

use crate::atomic;
use crate::error::Result;
use crate::files;
use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::path::Path;

/// Lists the exported files beside it. Hidden, so that it is never taken for a scan.
const LIST: &str = ".scanweave.exported";

/// Notes that files of these names in `folder` are exported scans, besides those that were noted before.
///
/// # Errors
/// [`Error::Write`](crate::Error::Write).
pub(crate) fn note(folder: &Path, names: impl IntoIterator<Item = String>) -> Result<()> {
    let mut noted = exported(folder);
    noted.extend(names);
    // Names are text: this cannot fail.
    let text = serde_json::to_string_pretty(&noted).unwrap_or_default();
    atomic::write(&folder.join(LIST), |out| out.write_all(text.as_bytes()))
}

/// Takes what is not there out of the list, which an export that failed would leave; without any file, the
/// list goes.
pub(crate) fn forget_missing(folder: &Path) {
    let mut noted = exported(folder);
    noted.retain(|name| folder.join(name).exists());
    let list = folder.join(LIST);
    if noted.is_empty() {
        std::fs::remove_file(list).ok();
    } else {
        let text = serde_json::to_string_pretty(&noted).unwrap_or_default();
        atomic::write(&list, |out| out.write_all(text.as_bytes())).ok();
    }
}

/// Names of the exported scans in a folder; none where there is no list that can be read.
pub(super) fn exported(folder: &Path) -> BTreeSet<String> {
    /// A list of a hundred thousand long names.
    const MOST_BYTES: u64 = 32 << 20;
    let mut bytes = Vec::new();
    let read = files::open(&folder.join(LIST)).map(|file| file.take(MOST_BYTES).read_to_end(&mut bytes));
    read.ok().and_then(|_| serde_json::from_slice(&bytes).ok()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_add_up_and_a_damaged_one_is_none() {
        let folder = tempfile::tempdir().unwrap();
        assert!(exported(folder.path()).is_empty());
        let names = |names: &[&str]| names.iter().map(|n| n.to_string()).collect::<BTreeSet<_>>();
        note(folder.path(), names(&["b.ply", "a\n.ply"])).unwrap();
        note(folder.path(), names(&["b.ply", "c.las"])).unwrap();
        assert_eq!(exported(folder.path()), names(&["a\n.ply", "b.ply", "c.las"]));
        std::fs::write(folder.path().join("b.ply"), "").unwrap();
        forget_missing(folder.path());
        assert_eq!(exported(folder.path()), names(&["b.ply"]));
        std::fs::remove_file(folder.path().join("b.ply")).unwrap();
        forget_missing(folder.path());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        std::fs::write(folder.path().join(LIST), "[\"a").unwrap();
        assert!(exported(folder.path()).is_empty());
    }
}
