//! Errors of the library as exceptions of `scanweave._errors`, with the same text.

use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::PyType;
use scanweave::{Error, ErrorKind};

/// The exception that an error becomes.
pub fn exception(py: Python<'_>, error: &Error) -> PyErr {
    let class = match error {
        Error::Read { .. } => "ReadError",
        _ => match error.kind() {
            ErrorKind::Input => "InputError",
            ErrorKind::Setting => "SettingError",
            ErrorKind::Output => "OutputError",
            ErrorKind::Interrupted => return PyKeyboardInterrupt::new_err(error.to_string()),
            _ => "ScanweaveError",
        },
    };
    let mut text = error.to_string();
    if matches!(error, Error::OutputExists { .. }) {
        text.push_str(" (in Python: force=True)");
    }
    let class = || Ok::<_, PyErr>(py.import("scanweave._errors")?.getattr(class)?.cast_into::<PyType>()?);
    class().map_or_else(|failed| failed, |class| PyErr::from_type(class, text))
}

/// `?` for results of the library.
pub trait OrRaise<T> {
    /// The value, or the exception.
    fn or_raise(self, py: Python<'_>) -> PyResult<T>;
}

impl<T> OrRaise<T> for scanweave::Result<T> {
    fn or_raise(self, py: Python<'_>) -> PyResult<T> {
        self.map_err(|error| exception(py, &error))
    }
}
