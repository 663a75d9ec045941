//! Files as safe to read, write and show: everything that this crate reads is opened by [`open`], everything
//! that it writes goes through [`write`](fn@write), a folder of results belongs to one run ([`FolderLock`]), and
//! text from elsewhere is shown by [`printable`].
//!
//! Only regular files are read, or links to them. Opening a named pipe waits until somebody writes to it,
//! a device such as `/dev/zero` never ends, and a pipe can be read only once, where scans are read again
//! for the report and for exports.

pub use crate::atomic::{Sink, write, write_file};
pub use crate::output_folder::{FolderLock, LOCK_FILE, Staging, is_same_place, is_within};
pub use crate::printable::{
    is_printable, printable, printable_json, printable_lines, printable_path, printable_start,
};
pub use crate::tensor_file::{Array, Arrays, digest_of_arrays, load_arrays, parse_arrays, save_arrays};

use crate::error::{Error, Result};
use std::fs::{self, File, FileType, Metadata};
use std::io::{self, Read};
use std::path::Path;

/// Opens a regular file.
///
/// # Errors
/// [`Error::Read`] when the system refuses; [`Error::File`] for a folder, pipe, socket or device.
pub fn open(path: &Path) -> Result<File> {
    let refused = |e| Error::read(path, e);
    // Before opening, which waits where the name is that of a pipe.
    check(path, &fs::metadata(path).map_err(refused)?)?;
    let file = File::open(path).map_err(refused)?;
    // Again: the name may stand for something else by now.
    check(path, &file.metadata().map_err(refused)?)?;
    Ok(file)
}

/// The bytes of a regular file.
///
/// # Errors
/// As [`open`].
pub fn read(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?.read_to_end(&mut bytes).map_err(|e| Error::read(path, e))?;
    Ok(bytes)
}

/// The text of a regular file.
///
/// # Errors
/// As [`open`], and [`Error::Read`] for bytes that are not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    let not_utf8 = |_| Error::read(path, io::Error::new(io::ErrorKind::InvalidData, "it is not UTF-8 text"));
    String::from_utf8(read(path)?).map_err(not_utf8)
}

fn check(path: &Path, about: &Metadata) -> Result<()> {
    if about.is_file() {
        return Ok(());
    }
    let (found, remedy) = match about.is_dir() {
        true => ("a folder", "name a file in it"),
        false => (kind(about.file_type()), "write its content to a file, and name that file"),
    };
    Err(Error::file(path, found, "a regular file", remedy))
}

#[cfg(unix)]
fn kind(file_type: FileType) -> &'static str {
    use std::os::unix::fs::FileTypeExt;
    match () {
        () if file_type.is_fifo() => "a pipe",
        () if file_type.is_socket() => "a socket",
        () if file_type.is_char_device() || file_type.is_block_device() => "a device",
        () => "something else than a file",
    }
}

#[cfg(not(unix))]
fn kind(_: FileType) -> &'static str {
    "something else than a file"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regular_files_are_read_and_folders_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        fs::write(&path, "one\n").unwrap();
        assert_eq!(
            (read(&path).unwrap(), read_text(&path).unwrap()),
            (b"one\n".to_vec(), "one\n".to_owned())
        );
        fs::write(&path, b"\xff").unwrap();
        assert!(matches!(read_text(&path), Err(Error::Read { .. })));
        assert!(matches!(read(&folder.path().join("none")), Err(Error::Read { .. })));
        let said = read(folder.path()).unwrap_err().to_string();
        assert!(said.contains("found a folder, expected a regular file"), "{said}");
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_and_what_may_not_end_is_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        fs::write(place("a.txt"), "one").unwrap();
        std::os::unix::fs::symlink(place("a.txt"), place("link")).unwrap();
        assert_eq!(read(&place("link")).unwrap(), b"one");
        let _listener = std::os::unix::net::UnixListener::bind(place("socket")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", place("zero")).unwrap();
        let made = std::process::Command::new("mkfifo").arg(place("pipe")).status();
        assert!(made.unwrap().success());
        for (name, found) in [("socket", "a socket"), ("zero", "a device"), ("pipe", "a pipe")] {
            let said = read(&place(name)).unwrap_err().to_string();
            assert!(said.contains(name) && said.contains(&format!("found {found},")), "{said}");
            assert!(said.contains("write its content to a file"), "{said}");
        }
    }
}
