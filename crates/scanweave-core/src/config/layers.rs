//! Layered settings: preset, then file, then `--set`, each checked before it is laid on top.

use super::keys::Keys;
use crate::error::{Error, Result};
use serde::de::DeserializeOwned;
use std::path::Path;
use toml::{Table, Value};

/// Settings being put together, layer by layer.
#[derive(Debug)]
pub struct Layers {
    keys: Keys,
    table: Table,
    /// Who set what, latest last: (source, table).
    sources: Vec<(String, Table)>,
}

impl Layers {
    /// No setting yet; only keys of the config type `C` will be accepted.
    pub fn new<C: schemars::JsonSchema>() -> Self {
        Self { keys: Keys::of::<C>(), table: Table::new(), sources: Vec::new() }
    }

    /// Lays a built-in preset on top.
    ///
    /// # Errors
    /// [`Error::Setting`] when there is none of that name.
    pub fn add_preset(&mut self, name: &str) -> Result<()> {
        self.add_text(&format!("preset {name}"), super::preset_text(name)?)
    }

    /// Lays TOML text on top. `source` is the name people know it by.
    ///
    /// # Errors
    /// [`Error::Setting`] for bad syntax, an unknown key or a value of the wrong type.
    pub fn add_text(&mut self, source: &str, text: &str) -> Result<()> {
        let table = text.parse::<Table>().map_err(|e| {
            Error::setting(
                source,
                first_line(&e, text),
                "a TOML file of `key = value` lines and `[table]` heads",
                "correct that line",
            )
        })?;
        self.add(source, table)
    }

    /// Lays a TOML file on top.
    ///
    /// # Errors
    /// [`Error::Read`], and those of [`Layers::add_text`].
    pub fn add_file(&mut self, path: &Path) -> Result<()> {
        let bytes = crate::files::read(path)?;
        let source = path.display().to_string();
        let text = String::from_utf8(bytes).map_err(|e| {
            Error::setting(
                source.as_str(),
                format!("a byte that is not UTF-8 at offset {}", e.utf8_error().valid_up_to()),
                "a TOML text file",
                "pass a configuration file, not a scan or an archive",
            )
        })?;
        self.add_text(&source, &text)
    }

    /// Lays one `key=value` of the command line on top; the key may be dotted.
    ///
    /// # Errors
    /// As [`Layers::add_text`], naming `--set`.
    pub fn add_assignment(&mut self, assignment: &str) -> Result<()> {
        let Some((key, value)) = assignment.split_once('=') else {
            return Err(Error::setting(
                "--set",
                format!("`{assignment}`"),
                "key=value, as in scale.voxel_m=0.05",
                "add `=` and a value",
            ));
        };
        let (key, value) = (key.trim(), value.trim());
        // A value that is not TOML is a bare word, which saves the user the quotes.
        let mut value = format!("value = {value}")
            .parse::<Table>()
            .ok()
            .and_then(|mut t| t.remove("value"))
            .unwrap_or_else(|| Value::String(value.to_owned()));
        for part in key.rsplit('.') {
            value = Value::Table(Table::from_iter([(part.to_owned(), value)]));
        }
        match value {
            Value::Table(table) => self.add("--set", table),
            _ => Ok(()),
        }
    }

    /// Lays a table on top.
    ///
    /// # Errors
    /// [`Error::Setting`] for an unknown key or a value of the wrong type.
    pub fn add(&mut self, source: &str, table: Table) -> Result<()> {
        self.keys.check(source, &table)?;
        self.keys.overlay(&mut self.table, &table);
        self.sources.push((source.to_owned(), table));
        Ok(())
    }

    /// The latest layer that sets a dotted key.
    pub fn source_of(&self, key: &str) -> Option<&str> {
        let sets = |table: &Table| {
            let mut parts = key.split('.');
            let first = table.get(parts.next()?)?;
            parts.try_fold(first, |value, part| value.as_table()?.get(part)).map(|_| ())
        };
        self.sources.iter().rev().find(|(_, t)| sets(t).is_some()).map(|(name, _)| name.as_str())
    }

    /// The settings as the config type.
    ///
    /// # Errors
    /// [`Error::Setting`] for a setting without effect, and when a value does not fit in a way the
    /// schema does not tell.
    pub fn read<C: DeserializeOwned>(&self) -> Result<C> {
        self.keys.check_kinds(&self.table, |key| self.source_of(key))?;
        Value::Table(self.table.clone()).try_into().map_err(|e: toml::de::Error| {
            let text = e.to_string();
            let text = text.trim().replace('\n', " ");
            Error::setting("configuration", text, "values of the documented types", "see `scanweave config`")
        })
    }
}

/// "line 3: reason" of a syntax error.
fn first_line(error: &toml::de::Error, text: &str) -> String {
    let line = error.span().map_or(1, |s| text[..s.start.min(text.len())].matches('\n').count() + 1);
    format!("bad syntax in line {line} ({})", error.message().replace('\n', ", "))
}
