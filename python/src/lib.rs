//! The native part of the Python package `scanweave`: arrays in, arrays and documents out. What Python
//! objects are taken for scans, and what results look like, is in `scanweave/*.py`.
#![forbid(unsafe_code)]
#![warn(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, clippy::print_stderr)]

mod calls;
mod config;
mod errors;
mod evaluation;
mod matrix;
mod run;
mod scan;
mod stages;
mod watched;

use pyo3::prelude::*;
use std::ffi::OsString;

/// The command with the arguments of a process; returns its exit code.
#[pyfunction]
fn command(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| scanweave::cli::main(arguments))
}

#[pymodule]
fn _scanweave(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<scan::PyScan>()?;
    module.add_class::<config::PyConfig>()?;
    module.add_class::<run::PyRun>()?;
    module.add_function(wrap_pyfunction!(command, module)?)?;
    module.add_function(wrap_pyfunction!(calls::read, module)?)?;
    module.add_function(wrap_pyfunction!(calls::register, module)?)?;
    module.add_function(wrap_pyfunction!(calls::register_pair, module)?)?;
    module.add_function(wrap_pyfunction!(calls::describe, module)?)?;
    module.add_function(wrap_pyfunction!(calls::predict_overlap, module)?)?;
    module.add_function(wrap_pyfunction!(stages::check_shards, module)?)?;
    module.add_function(wrap_pyfunction!(stages::describe_shard, module)?)?;
    module.add_function(wrap_pyfunction!(stages::register_shard, module)?)?;
    module.add_function(wrap_pyfunction!(calls::synthesize, module)?)?;
    module.add_function(wrap_pyfunction!(evaluation::evaluate_poses, module)?)
}
