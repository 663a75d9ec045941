//! The `scanweave` command. What it does is in the library, which the Python package calls too.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(scanweave::cli::main(std::env::args_os()))
}
