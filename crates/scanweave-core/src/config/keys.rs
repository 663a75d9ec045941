//! Which keys a config type knows and what their values may be, read from its JSON schema.

use crate::error::{Error, Result};
use schemars::generate::SchemaSettings;
use serde_json::Value as Json;
use std::collections::BTreeMap;
use toml::{Table, Value};

/// The keys of a config type.
#[derive(Debug)]
pub struct Keys {
    schema: Json,
}

impl Keys {
    /// Keys of the config type `C`.
    pub fn of<C: schemars::JsonSchema>() -> Self {
        let settings = SchemaSettings::draft2020_12().with(|s| s.inline_subschemas = true);
        Self { schema: settings.into_generator().into_root_schema_for::<C>().to_value() }
    }

    /// Every key a file or `--set` may name, dotted, tables left out.
    pub fn leaves(&self) -> Vec<String> {
        let mut all = Vec::new();
        collect_leaves(&self.schema, "", &mut all);
        all
    }

    /// Refuses unknown keys and values of the wrong type.
    ///
    /// # Errors
    /// [`Error::Setting`] naming `source`, the key, and the nearest known key or what was expected.
    pub fn check(&self, source: &str, table: &Table) -> Result<()> {
        self.check_table(&self.schema, source, "", table)
    }

    fn check_table(&self, schema: &Json, source: &str, prefix: &str, table: &Table) -> Result<()> {
        let known = properties(schema);
        for (key, value) in table {
            let path = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
            let Some(child) = known.get(key.as_str()) else {
                return Err(self.unknown(source, &path, known.keys().copied()));
            };
            match value {
                _ if key == KIND && kinds(schema).is_some() => {
                    self.check_kind(schema, source, &path, value)?
                }
                Value::Table(inner) if !properties(child).is_empty() => {
                    self.check_table(child, source, &path, inner)?;
                }
                // A list of tables: every one has the keys of the items.
                Value::Array(items) if child.get("items").is_some_and(|s| !properties(s).is_empty()) => {
                    let schema = &child["items"];
                    for (at, item) in items.iter().enumerate() {
                        let path = format!("{path}[{at}]");
                        match item {
                            Value::Table(inner) => self.check_table(schema, source, &path, inner)?,
                            other => return Err(self.misfit(source, &path, other, schema)),
                        }
                    }
                }
                _ if accepts(child, value) => {}
                _ => return Err(self.misfit(source, &path, value, child)),
            }
        }
        Ok(())
    }

    /// Refuses a kind that there is not.
    fn check_kind(&self, schema: &Json, source: &str, path: &str, value: &Value) -> Result<()> {
        let names: Vec<&str> = kinds(schema).into_iter().flatten().map(|kind| kind.0).collect();
        if value.as_str().is_some_and(|name| names.contains(&name)) {
            return Ok(());
        }
        Err(Error::setting(
            format!("{source}: {path}"),
            describe(value),
            format!("one of {}", names.iter().map(|n| format!("\"{n}\"")).collect::<Vec<_>>().join(", ")),
            "correct the value; `scanweave config` prints every setting",
        ))
    }

    /// Lays `top` over `base`, table by table. Where that chooses another kind, settings that only the
    /// former kind had are dropped: they were values of something that is no more there.
    pub fn overlay(&self, base: &mut Table, top: &Table) {
        overlay(&self.schema, base, top);
    }

    /// Refuses settings that the chosen kind does not have: they would have no effect.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key, its source by `source_of`, and the settings there are.
    pub fn check_kinds<'s>(&self, table: &Table, source_of: impl Fn(&str) -> Option<&'s str>) -> Result<()> {
        check_kinds(&self.schema, "", table, &source_of)
    }

    fn misfit(&self, source: &str, path: &str, value: &Value, schema: &Json) -> Error {
        Error::setting(
            format!("{source}: {path}"),
            describe(value),
            expectation(schema),
            "correct the value; `scanweave config` prints every setting",
        )
    }

    /// The error for a key nobody knows, with the most similar one that exists.
    fn unknown<'k>(&self, source: &str, path: &str, siblings: impl Iterator<Item = &'k str>) -> Error {
        let (prefix, key) = path.rsplit_once('.').map_or(("", path), |(p, k)| (p, k));
        let dotted = |k: &str| if prefix.is_empty() { k.to_owned() } else { format!("{prefix}.{k}") };
        let beside = siblings.map(|k| (strsim::jaro_winkler(key, k), dotted(k)));
        // A key may also be right but in the wrong table.
        let elsewhere = self.leaves().into_iter().map(|leaf| {
            let last = leaf.rsplit('.').next().unwrap_or(&leaf);
            (if last == key { 1.0 } else { strsim::jaro_winkler(path, &leaf) - 0.05 }, leaf)
        });
        let nearest = beside.chain(elsewhere).max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        let expected = match nearest {
            Some((_, near)) => format!("a known key, the nearest is `{near}`"),
            None => "no key here".to_owned(),
        };
        Error::setting(
            format!("{source}: {path}"),
            format!("an unknown key `{key}`"),
            expected,
            "rename or remove it; `scanweave config` prints every setting",
        )
    }
}

/// The key that chooses among kinds of settings.
const KIND: &str = "kind";

/// The settings of every kind, where a table has kinds.
fn kinds(schema: &Json) -> Option<Vec<(&str, BTreeMap<&str, &Json>)>> {
    let named = |choice| {
        let known = properties(choice);
        let name = known.get(KIND)?.get("const")?.as_str()?;
        Some((name, known))
    };
    let kinds: Vec<_> = choices(schema).map(named).collect::<Option<_>>()?;
    (!kinds.is_empty()).then_some(kinds)
}

/// The settings of the kind that a table has chosen.
fn chosen<'s>(schema: &'s Json, table: &Table) -> Option<(&'s str, BTreeMap<&'s str, &'s Json>)> {
    let kind = table.get(KIND)?.as_str()?;
    kinds(schema)?.into_iter().find(|(name, _)| *name == kind)
}

fn overlay(schema: &Json, base: &mut Table, top: &Table) {
    let known = properties(schema);
    for (key, value) in top {
        match (base.get_mut(key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => {
                let child = known.get(key.as_str()).copied().unwrap_or(&Json::Null);
                let other_kind = above.get(KIND).is_some_and(|kind| below.get(KIND) != Some(kind));
                if let Some((_, settings)) = chosen(child, above).filter(|_| other_kind) {
                    below.retain(|key, _| settings.contains_key(key));
                }
                overlay(child, below, above);
            }
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

fn check_kinds<'s>(
    schema: &Json,
    prefix: &str,
    table: &Table,
    source_of: &impl Fn(&str) -> Option<&'s str>,
) -> Result<()> {
    let known = properties(schema);
    let dotted = |key: &str| if prefix.is_empty() { key.to_owned() } else { format!("{prefix}.{key}") };
    if let Some((kind, settings)) = chosen(schema, table)
        && let Some(key) = table.keys().find(|key| !settings.contains_key(key.as_str()))
    {
        let path = dotted(key);
        let named = source_of(&path).map_or_else(|| path.clone(), |source| format!("{source}: {path}"));
        let others = kinds(schema).into_iter().flatten().filter(|(_, s)| s.contains_key(key.as_str()));
        let others: Vec<String> = others.map(|(name, _)| format!("\"{name}\"")).collect();
        let own: Vec<&str> = settings.keys().copied().filter(|k| *k != KIND).collect();
        return Err(Error::setting(
            named,
            format!("a value, which has no effect with {} = \"{kind}\"", dotted(KIND)),
            format!("settings of that kind: {}", own.join(", ")),
            format!("leave it out, or set {} to {}", dotted(KIND), others.join(" or ")),
        ));
    }
    for (key, value) in table {
        if let (Value::Table(inner), Some(child)) = (value, known.get(key.as_str())) {
            check_kinds(child, &dotted(key), inner, source_of)?;
        }
    }
    Ok(())
}

fn collect_leaves(schema: &Json, prefix: &str, all: &mut Vec<String>) {
    for (key, child) in properties(schema) {
        let path = if prefix.is_empty() { key.to_owned() } else { format!("{prefix}.{key}") };
        if properties(child).is_empty() {
            all.push(path);
        } else {
            collect_leaves(child, &path, all);
        }
    }
}

/// Schemas that a value may follow, where a schema offers a choice.
fn choices(schema: &Json) -> impl Iterator<Item = &Json> {
    ["anyOf", "oneOf", "allOf"].iter().filter_map(|k| schema.get(k)?.as_array()).flatten()
}

/// Known keys of a table, those of every variant where it is an enumeration.
fn properties(schema: &Json) -> BTreeMap<&str, &Json> {
    let own = schema.get("properties").and_then(Json::as_object).into_iter().flatten();
    let mut all: BTreeMap<&str, &Json> = own.map(|(k, v)| (k.as_str(), v)).collect();
    for choice in choices(schema) {
        all.extend(properties(choice));
    }
    all
}

/// Whether a value fits a schema, as far as types, enumerations and least values tell.
fn accepts(schema: &Json, value: &Value) -> bool {
    if let Some(listed) = schema.get("enum").and_then(Json::as_array) {
        return listed.iter().any(|v| v.as_str() == value.as_str() && v.is_string());
    }
    if let Some(word) = schema.get("const") {
        return word.as_str() == value.as_str();
    }
    let mut offered = choices(schema).peekable();
    if offered.peek().is_some() {
        return offered.any(|s| accepts(s, value));
    }
    let kinds: Vec<&str> = match schema.get("type") {
        Some(Json::String(kind)) => vec![kind],
        Some(Json::Array(kinds)) => kinds.iter().filter_map(Json::as_str).collect(),
        _ => return true,
    };
    let number = match value {
        Value::Integer(i) => Some(*i as f64),
        Value::Float(f) => Some(*f),
        _ => None,
    };
    let bound = |key: &str| schema.get(key).and_then(Json::as_f64);
    if number
        .is_some_and(|v| bound("minimum").is_some_and(|m| v < m) || bound("maximum").is_some_and(|m| v > m))
    {
        return false;
    }
    kinds.iter().any(|kind| match (*kind, value) {
        ("number", Value::Integer(_) | Value::Float(_)) => true,
        ("integer", Value::Integer(_)) => true,
        ("string", Value::String(_)) => true,
        ("boolean", Value::Boolean(_)) => true,
        ("array", Value::Array(items)) => {
            schema.get("items").is_none_or(|s| items.iter().all(|v| accepts(s, v)))
        }
        ("object", Value::Table(_)) => true,
        _ => false,
    })
}

/// What a schema asks for, in words.
fn expectation(schema: &Json) -> String {
    let quoted = |v: &Json| v.as_str().map(|s| format!("\"{s}\""));
    if let Some(listed) = schema.get("enum").and_then(Json::as_array) {
        return format!("one of {}", listed.iter().filter_map(quoted).collect::<Vec<_>>().join(", "));
    }
    if let Some(word) = schema.get("const").and_then(quoted) {
        return word;
    }
    let offered: Vec<String> =
        choices(schema).filter(|s| s.get("type") != Some(&"null".into())).map(expectation).collect();
    if !offered.is_empty() {
        return offered.join(" or ");
    }
    let word = |kind: &str| match kind {
        "number" => Some("a number"),
        "integer" => Some("a whole number"),
        "string" => Some("a text in quotes"),
        "boolean" => Some("true or false"),
        "array" => Some("a list"),
        "object" => Some("a table"),
        _ => None,
    };
    let kinds: Vec<&str> = match schema.get("type") {
        Some(Json::String(kind)) => word(kind).into_iter().collect(),
        Some(Json::Array(kinds)) => kinds.iter().filter_map(Json::as_str).filter_map(word).collect(),
        _ => vec!["another value"],
    };
    let mut text = kinds.join(" or ");
    if let Some(items) = schema.get("items").filter(|_| text == "a list") {
        text = format!("{text} whose items are each {}", expectation(items));
    }
    if let Some(least) = schema.get("minimum").and_then(Json::as_f64) {
        text = format!("{text} of at least {least}");
    }
    if let Some(most) = schema.get("maximum").and_then(Json::as_f64) {
        text = format!("{text} of at most {most}");
    }
    text
}

/// A value and its kind, in words.
fn describe(value: &Value) -> String {
    match value {
        Value::String(s) => format!("the text \"{s}\""),
        Value::Integer(i) => format!("the whole number {i}"),
        Value::Float(f) => format!("the number {f}"),
        Value::Boolean(b) => format!("{b}"),
        Value::Array(_) => format!("the list {value}"),
        Value::Table(_) => "a table".to_owned(),
        Value::Datetime(d) => format!("the date {d}"),
    }
}
