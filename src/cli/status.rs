//! Exit codes.

use scanweave::{Error, ErrorKind};

/// How a run of the command ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Status {
    /// Done. Some scans may have been declined; the summary says which.
    Success = 0,
    /// An error this program should not have run into.
    Internal = 1,
    /// Input that cannot be used. (2, bad usage, is given by clap itself.)
    Input = 3,
    /// A setting that cannot be used.
    Setting = 4,
    /// Output that cannot be written.
    Output = 5,
    /// The run ended, but no scan could be joined to another, or the demo missed the truth.
    NothingRegistered = 6,
    /// Stopped by Ctrl-C (128 + SIGINT).
    Interrupted = 130,
}

/// The codes, for `--help`.
pub const HELP: &str = "\
Exit codes:
  0    done (scans may have been declined; the summary says which and why)
  1    internal error
  2    bad usage
  3    input that cannot be used
  4    a setting that cannot be used
  5    output that cannot be written
  6    nothing registered: no scan could be joined to another (register, after writing
       its report), or the result differs from the truth (demo)
  130  interrupted (Ctrl-C)";

impl Status {
    /// The code that tells what went wrong.
    pub fn of(error: &anyhow::Error) -> Self {
        match error.downcast_ref::<Error>().map(Error::kind) {
            Some(ErrorKind::Input) => Status::Input,
            Some(ErrorKind::Setting) => Status::Setting,
            Some(ErrorKind::Output) => Status::Output,
            Some(ErrorKind::Interrupted) => Status::Interrupted,
            _ => Status::Internal,
        }
    }
}
