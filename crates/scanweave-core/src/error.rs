//! The one error type of the library.
//!
//! Every message names the file or setting it is about, what was found there,
//! what was expected, and what to do next. The library returns errors and
//! never prints them; the command line maps [`Error::kind`] to an exit code.
//! Names and texts of files come from anywhere: a message shows them without control characters.

use crate::printable::{printable, printable_path};
use std::io;
use std::path::{Path, PathBuf};

/// Result with this crate's [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Everything that can go wrong in the library.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused to read a file or folder.
    #[error("{}: cannot read it: {}", printable_path(path), printable(&source.to_string()))]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's own reason.
        source: io::Error,
    },
    /// The operating system refused to write a file or folder.
    #[error(
        "{}: cannot write it: {}; check that the folder exists, is writable and has free space",
        printable_path(path),
        printable(&source.to_string())
    )]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's own reason.
        source: io::Error,
    },
    /// A file's content is not what its format or the method needs.
    #[error("{}: {}", printable_path(path), comparison(found, expected, remedy))]
    File {
        /// The file.
        path: PathBuf,
        /// What is there.
        found: String,
        /// What should be there.
        expected: String,
        /// What the user can do.
        remedy: String,
    },
    /// A file that is something else than a scan: a table, notes, a list of poses.
    #[error("{}: {}", printable_path(path), comparison(found, expected, remedy))]
    NotAScan {
        /// The file.
        path: PathBuf,
        /// What is there.
        found: String,
        /// What a scan would have.
        expected: String,
        /// What the user can do.
        remedy: String,
    },
    /// A setting (config key or flag) has an unusable value.
    #[error("{}: {}", printable(key), comparison(found, expected, remedy))]
    Setting {
        /// Config key or flag, as the user writes it.
        key: String,
        /// What is there.
        found: String,
        /// What should be there.
        expected: String,
        /// What the user can do.
        remedy: String,
    },
    /// Input that is readable but cannot be worked with (too few scans, mismatched features, …).
    #[error("{}: {}", printable(subject), comparison(found, expected, remedy))]
    Input {
        /// The scan, set of scans, or argument.
        subject: String,
        /// What is there.
        found: String,
        /// What should be there.
        expected: String,
        /// What the user can do.
        remedy: String,
    },
    /// The output place is already taken.
    #[error(
        "{}: already holds a result; pass --force to replace it or choose another folder with --output",
        printable_path(path)
    )]
    OutputExists {
        /// The output file or folder.
        path: PathBuf,
    },
    /// Another run is writing into the output folder.
    #[error("{}: another run writes into it ({owner}); wait for its end, or choose another folder with --output", path.display())]
    OutputInUse {
        /// The folder.
        path: PathBuf,
        /// Who has it.
        owner: String,
    },
    /// The user asked to stop.
    #[error("interrupted during {}; nothing half-written was left behind", printable(stage))]
    Interrupted {
        /// The stage that was running.
        stage: String,
    },
}

/// The part of a message that is the same for files, settings and inputs.
fn comparison(found: &str, expected: &str, remedy: &str) -> String {
    format!("found {}, expected {}; {}", printable(found), printable(expected), printable(remedy))
}

/// Coarse class of an [`Error`], for exit codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorKind {
    /// Files or scans that cannot be used.
    Input,
    /// A setting that cannot be used.
    Setting,
    /// Output that cannot be written.
    Output,
    /// Stopped by the user.
    Interrupted,
}

impl Error {
    /// The class this error belongs to.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Error::Read { .. } | Error::File { .. } | Error::NotAScan { .. } | Error::Input { .. } => {
                ErrorKind::Input
            }
            Error::Setting { .. } => ErrorKind::Setting,
            Error::Write { .. } | Error::OutputExists { .. } | Error::OutputInUse { .. } => ErrorKind::Output,
            Error::Interrupted { .. } => ErrorKind::Interrupted,
        }
    }

    /// A file whose content is not usable.
    pub fn file(
        path: impl AsRef<Path>,
        found: impl Into<String>,
        expected: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Error::File {
            path: path.as_ref().to_path_buf(),
            found: found.into(),
            expected: expected.into(),
            remedy: remedy.into(),
        }
    }

    /// A file that is something else than a scan.
    pub fn not_a_scan(
        path: impl AsRef<Path>,
        found: impl Into<String>,
        expected: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Error::NotAScan {
            path: path.as_ref().to_path_buf(),
            found: found.into(),
            expected: expected.into(),
            remedy: remedy.into(),
        }
    }

    /// A config key or flag whose value is not usable.
    pub fn setting(
        key: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Error::Setting {
            key: key.into(),
            found: found.into(),
            expected: expected.into(),
            remedy: remedy.into(),
        }
    }

    /// Scans or features that are readable but not usable.
    pub fn input(
        subject: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Error::Input {
            subject: subject.into(),
            found: found.into(),
            expected: expected.into(),
            remedy: remedy.into(),
        }
    }

    /// A read that the system refused.
    pub fn read(path: impl AsRef<Path>, source: io::Error) -> Self {
        Error::Read { path: path.as_ref().to_path_buf(), source }
    }

    /// A write that the system refused.
    pub fn write(path: impl AsRef<Path>, source: io::Error) -> Self {
        Error::Write { path: path.as_ref().to_path_buf(), source }
    }
}
