//! Many scans at once: in parallel, in order, with unique names.

use super::read_cloud;
use super::scalar::counted;
use crate::error::{Error, Result};
use crate::monitor::Monitor;
use crate::scan::{Scan, ScanId};
use rayon::prelude::*;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Reads `paths` in parallel; scan `i` comes from `paths[i]`.
///
/// # Errors
/// That of the first path in order that fails; [`Error::File`] for a cloud without a finite point;
/// [`Error::Interrupted`].
pub fn read_scans(paths: &[PathBuf], monitor: &dyn Monitor) -> Result<Vec<Scan>> {
    const STAGE: &str = "reading scans";
    monitor.begin(STAGE, paths.len());
    let names = unique_names(paths);
    let one = |(i, path): (usize, &PathBuf)| {
        monitor.check(STAGE)?;
        let cloud = read_cloud(path)?;
        if cloud.is_empty() {
            let found = format!("0 finite points of {}", counted(cloud.dropped_rows, "row"));
            let remedy = "leave this scan out, or export it again";
            return Err(Error::file(path, found, "at least one point with finite coordinates", remedy));
        }
        monitor.advance(1);
        Ok(Scan { id: ScanId(i), name: names[i].clone(), path: Some(path.clone()), cloud })
    };
    // Collected before errors are looked at: which of two bad files is named must not depend on threads.
    let results: Vec<Result<Scan>> = paths.par_iter().enumerate().map(one).collect();
    monitor.end();
    results.into_iter().collect()
}

/// A short name for each path: its stem, with as many folders before it as it takes to be unique,
/// and a number where even the whole paths look alike.
pub fn unique_names(paths: &[PathBuf]) -> Vec<String> {
    let deepest = paths.iter().map(|p| p.components().count()).max().unwrap_or(0);
    let mut depth = vec![1; paths.len()];
    for _ in 1..deepest {
        let names: Vec<String> = paths.iter().zip(&depth).map(|(p, &d)| name(p, d)).collect();
        let count = occurrences(&names);
        let repeated: Vec<usize> = (0..names.len()).filter(|&i| count[&names[i]] > 1).collect();
        if repeated.is_empty() {
            return names;
        }
        for i in repeated {
            depth[i] += 1;
        }
    }
    // Same stem in one folder, or names that differ only in bytes that are not UTF-8.
    let mut names: Vec<String> = paths
        .iter()
        .zip(&depth)
        .map(|(p, &d)| {
            let full = name(p, d);
            p.extension().map_or(full.clone(), |e| format!("{full}.{}", e.to_string_lossy()))
        })
        .collect();
    if occurrences(&names).values().all(|&n| n == 1) {
        return names;
    }
    for (i, name) in names.iter_mut().enumerate() {
        name.push_str(&format!("#{i}"));
    }
    names
}

fn occurrences(names: &[String]) -> HashMap<String, usize> {
    names.iter().fold(HashMap::new(), |mut count, n| {
        *count.entry(n.clone()).or_insert(0) += 1;
        count
    })
}

/// The last `depth` parts of a path, without its extension; characters that would upset a
/// terminal or a table are replaced.
fn name(path: &Path, depth: usize) -> String {
    let stem = path.with_extension("");
    let parts: Vec<String> = stem
        .components()
        .filter(|c| matches!(c, std::path::Component::Normal(_)))
        .map(|c| c.as_os_str().to_string_lossy().replace(char::is_control, "\u{fffd}"))
        .collect();
    parts[parts.len().saturating_sub(depth)..].join("/")
}
