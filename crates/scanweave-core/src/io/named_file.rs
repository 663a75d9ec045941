//! Files that a document names. Who opens a result of somebody else wants its scans read, and no other
//! file of this machine; a named pipe or device may never end.

use super::cloud::FORMATS;
use super::discover;
use crate::error::{Error, Result};
use std::path::Path;

/// Refuses what is no regular file, or is not there.
///
/// # Errors
/// [`Error::Read`], [`Error::File`].
pub fn check_regular(path: &Path) -> Result<()> {
    let about = std::fs::metadata(path).map_err(|e| Error::read(path, e))?;
    if about.is_file() {
        return Ok(());
    }
    let found = if about.is_dir() { "a folder" } else { "a pipe or device" };
    Err(Error::file(path, found, "a regular file", "name the file itself, or copy its content to one"))
}

/// The text of a regular file.
///
/// # Errors
/// As [`check_regular`], and for text that is not UTF-8.
pub fn regular_text(path: &Path) -> Result<String> {
    check_regular(path)?;
    std::fs::read_to_string(path).map_err(|e| Error::read(path, e))
}

/// Refuses a file that a document names as that of a scan and that is no regular file, or does not end
/// as files of scans do.
///
/// # Errors
/// As [`check_regular`].
pub fn check_named_scan(path: &Path) -> Result<()> {
    check_regular(path)?;
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
            assert_eq!(regular_text(&path).unwrap(), "x");
        }
        let folder = place.path().join("folder.ply");
        std::fs::create_dir(&folder).unwrap();
        assert!(check_named_scan(&folder).unwrap_err().to_string().contains("a folder"));
        if cfg!(unix) {
            let device = check_regular(Path::new("/dev/zero")).unwrap_err().to_string();
            assert!(device.contains("a pipe or device"), "{device}");
        }
    }
}
