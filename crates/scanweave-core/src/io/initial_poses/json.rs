//! Poses in JSON.

use super::{Entry, Poses};
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::io::poses::repaired;
use serde_json::Value;
use std::path::Path;

const REMEDY: &str = "correct it or write the file again";

pub(super) fn read(path: &Path, text: &str) -> Result<Poses> {
    let document: Value = serde_json::from_str(text).map_err(|e| {
        // Open brackets begin other text, too; the parser tells line and column.
        Error::file(path, format!("text that is no JSON ({e})"), "poses as JSON", REMEDY)
    })?;
    let is = |key: &str, value: &str| document.get(key).and_then(Value::as_str) == Some(value);
    match &document {
        _ if is("format", "scanweave-poses") => read_result(path, &document),
        _ if is("class_name", "PoseGraph") => read_pose_graph(path, &document),
        Value::Object(poses) => {
            let entry = |(name, value): (&String, &Value)| {
                let at = format!("'{name}'");
                Ok(Some(Entry { key: vec![name.clone()], pose: matrix(path, &at, value, false)?, at }))
            };
            // A scan may be named without a pose.
            let stated = poses.iter().filter(|(_, value)| !value.is_null());
            Ok(Poses::Named(stated.map(entry).filter_map(Result::transpose).collect::<Result<_>>()?))
        }
        _ => Err(Error::file(path, "a JSON list", "a JSON object from names to matrices", REMEDY)),
    }
}

/// The first component of `poses.json`: poses of different components are unrelated.
fn read_result(path: &Path, document: &Value) -> Result<Poses> {
    let mut entries = Vec::new();
    for (k, scan) in list(path, document, "scans")?.iter().enumerate() {
        if scan.get("outcome").and_then(Value::as_str) != Some("placed")
            || scan.get("component").and_then(Value::as_u64) != Some(0)
        {
            continue;
        }
        let text = |key: &str| scan.get(key).and_then(Value::as_str).map(str::to_owned);
        let key: Vec<String> = text("name").into_iter().chain(text("file")).collect();
        let at = format!("scan {k}");
        let pose = matrix(path, &at, scan.get("world_from_scan").unwrap_or(&Value::Null), false)?;
        entries.push(Entry { key, pose, at });
    }
    Ok(Poses::Named(entries))
}

/// The nodes of Open3D's pose graph; ours have names.
fn read_pose_graph(path: &Path, document: &Value) -> Result<Poses> {
    let nodes = list(path, document, "nodes")?;
    let pose = |(k, node): (usize, &Value)| {
        matrix(path, &format!("node {k}"), node.get("pose").unwrap_or(&Value::Null), true)
    };
    let poses: Vec<RigidMotion> = nodes.iter().enumerate().map(pose).collect::<Result<_>>()?;
    let names: Option<Vec<&str>> = nodes.iter().map(|n| n.get("name")?.as_str()).collect();
    let Some(names) = names else { return Ok(Poses::Ordered(poses)) };
    let entry = |(k, (name, pose)): (usize, (&str, RigidMotion))| Entry {
        key: vec![name.to_owned()],
        pose,
        at: format!("node {k}"),
    };
    Ok(Poses::Named(names.into_iter().zip(poses).enumerate().map(entry).collect()))
}

fn list<'a>(path: &Path, document: &'a Value, key: &str) -> Result<&'a Vec<Value>> {
    document.get(key).and_then(Value::as_array).ok_or_else(|| {
        let found = format!("no list '{key}'");
        Error::file(path, found, "the document as its program writes it", REMEDY)
    })
}

/// A matrix as rows of rows, or as 12 or 16 numbers row by row (or column by column).
fn matrix(path: &Path, at: &str, value: &Value, by_columns: bool) -> Result<RigidMotion> {
    let numbers = |v: &Value| v.as_array()?.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>();
    let rows = || value.as_array()?.iter().map(numbers).collect::<Option<Vec<_>>>();
    let flat = numbers(value).filter(|v| matches!(v.len(), 12 | 16));
    let nested = || {
        let fits = |rows: &Vec<Vec<f64>>| matches!(rows.len(), 3 | 4) && rows.iter().all(|r| r.len() == 4);
        Some(rows().filter(fits)?.concat())
    };
    let mut values = flat.or_else(nested).ok_or_else(|| {
        let start: String = value.to_string().chars().take(80).collect();
        let expected = "a 3x4 or 4x4 matrix: rows of 4 numbers, or 12 or 16 numbers";
        Error::file(path, format!("{at}: {start}"), expected, REMEDY)
    })?;
    if by_columns && values.len() == 16 {
        values = (0..16).map(|k| values[4 * (k % 4) + k / 4]).collect();
    }
    Ok(repaired(path, &format!("{at}: the matrix"), &values)?.0)
}
