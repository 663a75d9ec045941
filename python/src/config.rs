//! Settings.

use crate::errors::OrRaise;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyList, PyString, PyTuple};
use scanweave::config::{Config, Layers};
use scanweave::{Error, Result};
use std::path::PathBuf;
use toml::{Table, Value};

/// Where the settings of a dictionary come from, in errors.
const SOURCE: &str = "config";

/// Effective settings, checked.
#[pyclass(frozen, name = "Config", module = "scanweave._scanweave")]
pub struct PyConfig {
    pub config: Config,
}

#[pymethods]
impl PyConfig {
    /// Preset, then file, then settings (nested, or with dots in their keys), then seed; later ones win.
    #[new]
    #[pyo3(signature = (preset, file, settings, seed))]
    fn new(
        py: Python<'_>,
        preset: &str,
        file: Option<PathBuf>,
        settings: Option<&Bound<'_, PyDict>>,
        seed: Option<u64>,
    ) -> PyResult<Self> {
        let table = settings.map(|settings| table(settings, "")).transpose()?;
        let config = || -> Result<Config> {
            let mut layers = Layers::new::<Config>();
            layers.add_preset(preset)?;
            if let Some(file) = &file {
                layers.add_file(file)?;
            }
            if let Some(table) = table {
                layers.add(SOURCE, table)?;
            }
            if let Some(seed) = seed {
                layers.add_assignment(&format!("seed={seed}"))?;
            }
            Config::from_layers(&layers)
        };
        Ok(Self { config: config().or_raise(py)? })
    }

    /// The settings of a TOML text with another seed.
    #[staticmethod]
    fn from_toml(py: Python<'_>, text: &str, seed: u64) -> PyResult<Self> {
        let config = || -> Result<Config> {
            let mut layers = Layers::new::<Config>();
            layers.add_text(SOURCE, text)?;
            layers.add_assignment(&format!("seed={seed}"))?;
            Config::from_layers(&layers)
        };
        Ok(Self { config: config().or_raise(py)? })
    }

    #[getter]
    fn seed(&self) -> u64 {
        self.config.seed
    }

    /// As a TOML file.
    fn to_toml(&self, py: Python<'_>) -> PyResult<String> {
        self.config.to_toml().or_raise(py)
    }

    fn __repr__(&self) -> String {
        format!("Config(preset={:?}, seed={})", self.config.preset, self.config.seed)
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.config == other.config
    }
}

/// A dictionary as a TOML table; `within` is the dotted key of the dictionary.
fn table(settings: &Bound<'_, PyDict>, within: &str) -> PyResult<Table> {
    let mut table = Table::new();
    for (key, value) in settings {
        let Ok(key) = key.extract::<String>() else {
            return Err(unusable(&key, within));
        };
        let dotted = if within.is_empty() { key.clone() } else { format!("{within}.{key}") };
        insert(&mut table, &key, toml_value(&value, &dotted)?);
    }
    Ok(table)
}

/// Puts a value at a key that may have dots; tables at one place are joined.
fn insert(table: &mut Table, key: &str, value: Value) {
    let (first, rest) = key.split_once('.').map_or((key, None), |(first, rest)| (first, Some(rest)));
    match (rest, value) {
        (Some(rest), value) => {
            let entry = table.entry(first).or_insert_with(|| Value::Table(Table::new()));
            match entry {
                Value::Table(inner) => insert(inner, rest, value),
                other => *other = Value::Table(Table::from_iter([(rest.to_owned(), value)])),
            }
        }
        (None, Value::Table(new)) => match table.get_mut(first) {
            Some(Value::Table(old)) => new.into_iter().for_each(|(key, value)| insert(old, &key, value)),
            _ => {
                table.insert(first.to_owned(), Value::Table(new));
            }
        },
        (None, value) => {
            table.insert(first.to_owned(), value);
        }
    }
}

/// A value of Python or NumPy, or a path.
fn toml_value(value: &Bound<'_, PyAny>, key: &str) -> PyResult<Value> {
    // Before integers, which True is one of.
    if value.is_instance_of::<PyBool>() {
        return Ok(Value::Boolean(value.extract()?));
    }
    if let Ok(dict) = value.cast::<PyDict>() {
        return Ok(Value::Table(table(dict, key)?));
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        let items = value.try_iter()?.map(|item| toml_value(&item?, key));
        return Ok(Value::Array(items.collect::<PyResult<_>>()?));
    }
    if value.is_instance_of::<PyString>() {
        return Ok(Value::String(value.extract()?));
    }
    if let Ok(path) = value.extract::<PathBuf>() {
        return Ok(Value::String(path.to_string_lossy().into_owned()));
    }
    if let Ok(integer) = value.extract::<i64>() {
        return Ok(Value::Integer(integer));
    }
    value.extract::<f64>().map(Value::Float).map_err(|_| unusable(value, key))
}

fn unusable(value: &Bound<'_, PyAny>, key: &str) -> PyErr {
    let found = value.get_type().name().map_or_else(|_| "an object".to_owned(), |name| format!("a {name}"));
    let subject = if key.is_empty() { SOURCE.to_owned() } else { format!("{SOURCE}: {key}") };
    let expected = "names as keys; numbers, words, truth values, paths, lists or dictionaries of these";
    let error = Error::setting(subject, found, expected, "leave the setting out, or see `scanweave config`");
    crate::errors::exception(value.py(), &error)
}
