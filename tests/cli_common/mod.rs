//! What the tests of the command line share.
#![allow(dead_code)]

use assert_cmd::Command;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The command under test, with a clean environment as far as it matters.
pub fn scanweave() -> Command {
    let mut command = Command::cargo_bin("scanweave").expect("the binary is built with the tests");
    command.env_remove("SCANWEAVE_LOG");
    command
}

/// A folder that goes away with the test.
pub fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// A synthetic set of `scans` scans, without noise, in `place`.
pub fn synth(place: &Path, scans: usize) -> PathBuf {
    let set = place.join("set");
    scanweave()
        .args(["synth", "-q", "--noise", "0.3", "--scans", &scans.to_string()])
        .arg("-o")
        .arg(&set)
        .assert()
        .success();
    set.join("PointCloud")
}

/// Points of a room's corner with a few boxes, seen from the origin: enough shape to register.
pub fn corner() -> Vec<[f64; 3]> {
    let mut points = Vec::new();
    let steps = |n: usize, width: f64| (0..n).map(move |i| i as f64 * width);
    for u in steps(60, 0.04) {
        for v in steps(60, 0.04) {
            points.extend([[1.0 + u, 0.5 + v, 3.4], [1.0 + u, 2.9, 1.0 + v], [3.4, 0.5 + u, 1.0 + v]]);
        }
    }
    for (x, y, z, size) in
        [(1.5, 2.0, 2.0, 0.5), (2.2, 2.3, 1.4, 0.35), (1.2, 1.1, 2.8, 0.4), (2.6, 1.4, 2.3, 0.3)]
    {
        for u in steps(20, size / 20.0) {
            for v in steps(20, size / 20.0) {
                points.extend([[x + u, y + v, z], [x, y + u, z + v], [x + u, y, z + v]]);
            }
        }
    }
    points
}

/// Writes an ASCII PLY.
pub fn write_ply(path: &Path, points: &[[f64; 3]]) {
    std::fs::write(path, ply_text(points.len(), points)).expect("a writable folder");
}

/// An ASCII PLY whose header states `count` vertices.
pub fn ply_text(count: usize, points: &[[f64; 3]]) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    );
    for [x, y, z] in points {
        text.push_str(&format!("{x} {y} {z}\n"));
    }
    text
}

/// Text of a file of a result.
pub fn text(path: impl AsRef<Path>) -> String {
    std::fs::read_to_string(path).expect("a text file")
}

/// A JSON file of a result.
pub fn json(path: impl AsRef<Path>) -> serde_json::Value {
    serde_json::from_str(&text(path)).expect("a JSON document")
}

/// Names of the files in a folder, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .expect("a folder")
        .map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}
