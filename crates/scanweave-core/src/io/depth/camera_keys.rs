//! The few keys of a camera's calibration that registration needs, out of JSON, YAML and `key = value`
//! files.
//!
//! No YAML parser: of YAML only mappings by indentation and lists of numbers are understood, which is
//! what ROS, OpenCV, Kalibr and ORB-SLAM write.

use crate::io::scalar::parse_number;
use serde_json::Value;
use std::collections::BTreeMap;

/// Numbers by the path of their key, such as `camera_matrix.data`.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Keys(BTreeMap<String, Vec<f64>>);

impl Keys {
    /// The numbers of the first key that has some.
    pub(super) fn numbers(&self, keys: &[&str]) -> Option<&[f64]> {
        keys.iter().find_map(|k| self.0.get(*k).filter(|v| !v.is_empty())).map(Vec::as_slice)
    }

    /// The number of the first key that has one.
    pub(super) fn number(&self, keys: &[&str]) -> Option<f64> {
        self.numbers(keys).filter(|v| v.len() == 1).map(|v| v[0])
    }

    /// The first keys in the order of their names, for messages.
    pub(super) fn some_names(&self) -> String {
        self.0.keys().take(6).cloned().collect::<Vec<_>>().join(", ")
    }

    /// Whether no key was found.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// All numbers of a JSON document; `None` where it is none.
    pub(super) fn of_json(text: &str) -> Option<Self> {
        let mut keys = Self::default();
        keys.add_json("", &serde_json::from_str(text).ok()?);
        Some(keys)
    }

    fn add_json(&mut self, path: &str, value: &Value) {
        match value {
            Value::Object(map) => {
                for (key, value) in map {
                    let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                    self.add_json(&path, value);
                }
            }
            // A matrix as a list of rows is the list of its numbers.
            Value::Array(values) => values.iter().for_each(|v| self.add_json(path, v)),
            Value::Number(number) => {
                self.0.entry(path.to_owned()).or_default().extend(number.as_f64());
            }
            Value::Null | Value::Bool(_) | Value::String(_) => {}
        }
    }

    /// All numbers of YAML or of lines `key = value`.
    pub(super) fn of_lines(text: &str) -> Self {
        let mut keys = Self::default();
        // Keys that the line is in, with their indentation.
        let mut open: Vec<(usize, String)> = Vec::new();
        for line in text.lines().map(|l| l.split('#').next().unwrap_or("")) {
            let trimmed = line.trim();
            if trimmed.is_empty() || trimmed.starts_with('%') || matches!(trimmed, "---" | "...") {
                continue;
            }
            let continues = trimmed.starts_with(|c: char| c.is_ascii_digit() || "+-.[]".contains(c));
            let Some((key, rest)) = trimmed.split_once([':', '=']).filter(|_| !continues) else {
                if let Some((_, path)) = open.last() {
                    keys.0.entry(path.clone()).or_default().extend(leading_numbers(trimmed));
                }
                continue;
            };
            let indentation = line.len() - line.trim_start().len();
            open.retain(|(outer, _)| *outer < indentation);
            let key = key.trim().trim_matches(['"', '\'']);
            let mut path = open.last().map_or(key.to_owned(), |(_, outer)| format!("{outer}.{key}"));
            let mut values = rest;
            // A matrix in one line: `camera_matrix: {rows: 3, cols: 3, data: [...]}`.
            if rest.trim_start().starts_with('{')
                && let Some((_, data)) = rest.split_once("data:")
            {
                path.push_str(".data");
                values = data;
            }
            keys.0.entry(path.clone()).or_default().extend(leading_numbers(values));
            open.push((indentation, path));
        }
        keys
    }
}

/// Words of a text between white space and the signs of lists.
pub(super) fn words(text: &str) -> impl Iterator<Item = &str> {
    let separates = |c: char| c.is_whitespace() || matches!(c, ',' | ';' | '[' | ']' | '{' | '}');
    text.split(separates).filter(|w| !w.is_empty())
}

/// The numbers up to the first word that is none; the dash of a list's item is no word.
fn leading_numbers(text: &str) -> impl Iterator<Item = f64> {
    words(text).filter(|w| *w != "-").map_while(parse_number)
}
