//! Files that a document names. Who opens a result of somebody else wants its scans read, and no other
//! file of this machine; a named pipe or device may never end.

use super::cloud::FORMATS;
use super::discover;
use crate::error::{Error, Result};
use crate::files;
use std::path::Path;

/// Refuses a file that a document names as that of a scan and that is no regular file, or does not end
/// as files of scans do.
///
/// # Errors
/// Those of [`files::open`], and [`Error::File`] for the name.
pub fn check_named_scan(path: &Path) -> Result<()> {
    files::open(path)?;
    if discover::is_scan(path) || discover::has_extension(path, &["png"]) {
        return Ok(());
    }
    let remedy = "give the file the extension of its format and register it again";
    Err(Error::file(path, "a name that does not end as those of scans", FORMATS, remedy))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_that_end_as_scans_do() {
        let place = tempfile::tempdir().unwrap();
        for (name, fits) in [("a.ply", true), ("a.ply.gz", true), ("a.txt", true), ("d.png", true)] {
            let path = place.path().join(name);
            assert!(matches!(check_named_scan(&path), Err(Error::Read { .. })), "{name} is not there yet");
            std::fs::write(&path, "x").unwrap();
            assert_eq!(check_named_scan(&path).is_ok(), fits, "{name}");
        }
        for name in ["passwd", "id_rsa.pub", "key.pem"] {
            let path = place.path().join(name);
            std::fs::write(&path, "x").unwrap();
            let message = check_named_scan(&path).unwrap_err().to_string();
            assert!(message.contains(name) && message.contains("does not end"), "{message}");
        }
        let folder = place.path().join("folder.ply");
        std::fs::create_dir(&folder).unwrap();
        assert!(check_named_scan(&folder).unwrap_err().to_string().contains("a folder"));
    }
}
