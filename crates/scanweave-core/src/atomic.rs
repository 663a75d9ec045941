//! Whole files or none: everything this crate writes goes through [`write`](fn@write).

use crate::error::{Error, Result};
use crate::owner::Owner;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// What the names of temporary files and folders begin with; their owner follows, and a word of chance.
pub(crate) const TEMPORARY: &str = ".scanweave-";

/// What a writing closure gets: buffered, and seekable.
pub type Sink<'a> = BufWriter<&'a File>;

/// Writes `path` by way of a hidden temporary file beside it, so that a run
/// killed half-way leaves the old file or none, never a part of the new one.
///
/// The content is on disk (fsync) before the name appears.
///
/// # Errors
/// [`Error::Write`] naming `path` when the folder is missing or not writable, the disk is full,
/// `path` is a folder, or `content` fails.
pub fn write(path: &Path, content: impl FnOnce(&mut Sink<'_>) -> io::Result<()>) -> Result<()> {
    write_inner(path, content).map_err(|source| Error::write(path, source))
}

/// [`write`](fn@write) for formats that go back to fill in what comes before: the file may be read,
/// written and sought.
///
/// # Errors
/// As [`write`](fn@write).
pub fn write_file(path: &Path, content: impl FnOnce(&File) -> io::Result<()>) -> Result<()> {
    whole_file(path, content).map_err(|source| Error::write(path, source))
}

fn write_inner(path: &Path, content: impl FnOnce(&mut Sink<'_>) -> io::Result<()>) -> io::Result<()> {
    whole_file(path, |file| {
        let mut sink = BufWriter::with_capacity(1 << 16, file);
        content(&mut sink)?;
        sink.flush()
    })
}

fn whole_file(path: &Path, content: impl FnOnce(&File) -> io::Result<()>) -> io::Result<()> {
    if path.is_dir() {
        return Err(io::Error::new(io::ErrorKind::IsADirectory, "there is a folder of that name"));
    }
    let folder = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    };
    let prefix = temporary_prefix();
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // As any new file: readable by whom the umask allows. The crate's default is the owner alone.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let temporary = builder.tempfile_in(folder)?;
    // Tells those who cannot ask the system that somebody still writes it; some file systems have no locks.
    temporary.as_file().try_lock().ok();
    content(temporary.as_file())?;
    temporary.as_file().sync_all()?;
    temporary.persist(path).map_err(|e| e.error)?;
    sync_folder(folder);
    Ok(())
}

/// Makes new names durable, as they are only once their folder is; where a folder cannot be synced, nothing
/// is lost but that.
pub(crate) fn sync_folder(folder: &Path) {
    #[cfg(unix)]
    if let Ok(folder) = File::open(folder) {
        folder.sync_all().ok();
    }
    #[cfg(not(unix))]
    let _ = folder;
}

/// What a temporary file or folder of this process is called before its word of chance: a later run that
/// finds it can tell whether it is still being written.
pub(crate) fn temporary_prefix() -> String {
    format!("{TEMPORARY}{}-", Owner::current().tag())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn names(dir: &Path) -> Vec<String> {
        fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_other() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("poses.json");
        write(&path, |w| w.write_all(b"old")).unwrap();
        let error = write(&path, |w| {
            w.write_all(&[0; 1 << 20])?;
            Err(io::Error::other("disk full"))
        })
        .unwrap_err();
        assert!(
            error.to_string().contains("poses.json") && error.to_string().contains("disk full"),
            "{error}"
        );
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(dir.path()), ["poses.json"]);
        write(&path, |w| w.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
    }

    #[test]
    fn a_missing_folder_and_a_folder_in_the_way_are_write_errors() {
        let dir = tempfile::tempdir().unwrap();
        let missing = dir.path().join("no").join("file");
        assert!(matches!(write(&missing, |_| Ok(())), Err(Error::Write { path, .. }) if path == missing));
        assert!(matches!(write(dir.path(), |_| Ok(())), Err(Error::Write { .. })));
        assert!(names(dir.path()).is_empty());
    }

    #[cfg(unix)]
    #[test]
    fn new_files_are_not_private_to_the_owner() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let (ours, plain) = (dir.path().join("a"), dir.path().join("b"));
        write(&ours, |_| Ok(())).unwrap();
        fs::write(&plain, "").unwrap();
        let mode = |p: &Path| fs::metadata(p).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&plain));
    }
}
