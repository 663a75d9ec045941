//! Everything that can be wrong with what the user gives: the message and the exit code.

mod cli_common;

use cli_common::*;
use predicates::prelude::*;
use predicates::str::contains;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Two scans of one corner, 10 cm and a few degrees apart, and a folder for the result.
struct Case {
    place: TempDir,
    good: Vec<PathBuf>,
}

fn turned(points: &[[f64; 3]], angle: f64, shift: f64) -> Vec<[f64; 3]> {
    let (s, c) = angle.sin_cos();
    points.iter().map(|&[x, y, z]| [c * x - s * y + shift, s * x + c * y, z]).collect()
}

impl Case {
    fn new() -> Self {
        let place = folder();
        let good = vec![place.path().join("a.ply"), place.path().join("b.ply")];
        write_ply(&good[0], &corner());
        write_ply(&good[1], &turned(&corner(), 0.1, 0.1));
        Self { place, good }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.place.path().join(name)
    }

    fn file(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, content).unwrap();
        path
    }

    /// Registers the good scans and `more`.
    fn register(&self, more: &[&Path]) -> assert_cmd::Command {
        let mut command = scanweave();
        command.arg("register").args(&self.good).args(more).arg("-o").arg(self.path("result"));
        command
    }

    /// Registering `bad` with the good scans fails with code 3 and a message with all `parts`.
    fn refuses(&self, bad: &Path, parts: &[&str]) {
        let assert = self.register(&[bad]).assert().code(3).stdout("");
        let stderr = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
        let name = bad.file_name().unwrap().to_str().unwrap();
        for part in parts.iter().chain([&name]) {
            assert!(stderr.contains(part), "{part:?} is not in: {stderr}");
        }
        assert!(!self.path("result").join("poses.json").exists());
    }
}

#[test]
fn files_that_are_no_scans_are_named() {
    let case = Case::new();
    case.refuses(&case.path("missing.ply"), &["cannot read it", "no such file"]);
    case.refuses(&case.file("empty.ply", ""), &["expected"]);
    let whole = ply_text(100, &corner()[..100]);
    case.refuses(
        &case.file("cut.ply", &whole[..whole.len() / 2]),
        &["found 49 of 100 complete vertex rows", "expected 100 rows"],
    );
    case.refuses(&case.file("counts.ply", ply_text(200, &corner()[..100])), &["found", "200"]);
    let nan = ply_text(3, &[[f64::NAN; 3]; 3]);
    case.refuses(&case.file("nan.ply", nan), &["0 finite points", "at least one point"]);
    let mut binary = b"ply\nformat binary_little_endian 1.0\nelement vertex 1000\nproperty float x\nproperty float y\nproperty float z\nend_header\n".to_vec();
    binary.extend([0u8; 120]);
    case.refuses(&case.file("cut_binary.ply", binary), &["1000", "expected"]);
}

#[test]
fn the_reason_of_the_system_is_told_once() {
    let case = Case::new();
    let assert = case.register(&[&case.path("missing.ply")]).assert().code(3);
    let said = String::from_utf8_lossy(&assert.get_output().stderr).to_lowercase();
    assert_eq!(said.matches("no such file").count(), 1, "{said}");
    // Below a file nothing can be written.
    let place = case.file("plain", "");
    let run = scanweave().arg("register").args(&case.good).arg("-o").arg(place.join("out")).assert().code(5);
    let said = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
    assert_eq!(said.matches("(os error").count(), 1, "{said}");
}

#[test]
fn one_scan_is_not_enough() {
    let case = Case::new();
    let result = case.path("result");
    let mut command = scanweave();
    command.arg("register").arg(&case.good[0]).arg("-o").arg(&result);
    command.assert().code(3).stderr(contains("one scan, a").and(contains("at least two scans")));
}

#[test]
fn two_identical_scans_lie_on_each_other() {
    let case = Case::new();
    let twin = case.path("twin.ply");
    std::fs::copy(&case.good[0], &twin).unwrap();
    let result = case.path("result");
    scanweave().arg("register").arg(&case.good[0]).arg(&twin).arg("-o").arg(&result).assert().success();
    let poses = json(result.join("poses.json"));
    for entry in poses["scans"].as_array().unwrap() {
        for r in 0..4 {
            for c in 0..4 {
                let value = entry["world_from_scan"][r][c].as_f64().unwrap();
                assert!((value - f64::from(r == c)).abs() < 1e-4, "not the identity: {entry}");
            }
        }
    }
}

#[test]
fn a_plane_fixes_no_pose_and_is_declined() {
    let case = Case::new();
    let plane: Vec<[f64; 3]> =
        (0..10_000).map(|i| [(i % 100) as f64 * 0.03, (i / 100) as f64 * 0.03, 2.0]).collect();
    let path = case.path("plane.ply");
    write_ply(&path, &plane);
    case.register(&[&path]).assert().success().stdout(contains("declined"));
    let poses = json(case.path("result").join("poses.json"));
    let entry = poses["scans"].as_array().unwrap().iter().find(|s| s["name"] == "plane").unwrap();
    assert_eq!(entry["outcome"], "declined", "{entry}");
    // Two planes alone cannot be registered at all: the report is written, the code says so.
    let other = case.path("other.ply");
    write_ply(&other, &turned(&plane, 0.3, 0.2));
    let result = case.path("planes");
    scanweave().arg("register").arg(&path).arg(&other).arg("-o").arg(&result).assert().code(6);
    assert!(result.join("poses.json").exists());
}

#[test]
fn a_scan_in_millimetres_is_pointed_out_and_not_placed() {
    let case = Case::new();
    let millimetres: Vec<[f64; 3]> = corner().iter().map(|p| p.map(|v| v * 1000.0)).collect();
    let path = case.path("large.ply");
    write_ply(&path, &millimetres);
    case.register(&[&path])
        .assert()
        .success()
        .stderr(contains("large").and(contains("check that its unit is the metre")));
    let poses = json(case.path("result").join("poses.json"));
    let entry = poses["scans"].as_array().unwrap().iter().find(|s| s["name"] == "large").unwrap();
    assert_eq!(entry["outcome"], "declined", "{entry}");
}

#[test]
fn settings_are_checked_before_anything_is_read() {
    let case = Case::new();
    let with = |flags: &[&str]| {
        let assert = case.register(&[]).args(flags).assert();
        assert!(!case.path("result").exists());
        assert.stdout("")
    };
    with(&["--config", "nowhere.toml"]).code(3).stderr(contains("nowhere.toml: cannot read it"));
    let path = case.file("bad.toml", "seed = \n");
    with(&["--config", path.to_str().unwrap()]).code(4).stderr(contains("bad.toml").and(contains("line 1")));
    let path = case.file("binary.toml", [0xff, 0xfe, 0x00]);
    with(&["--config", path.to_str().unwrap()]).code(4).stderr(contains("not UTF-8"));
    let path = case.file("unknown.toml", "[registration.strategy]\nshort_list = 3\n");
    with(&["--config", path.to_str().unwrap()]).code(4).stderr(
        contains("unknown.toml: registration.strategy.short_list")
            .and(contains("`registration.strategy.shortlist`")),
    );
    with(&["--set", "registration.strategy.mrege=mean"])
        .code(4)
        .stderr(contains("--set").and(contains("`registration.strategy.merge`")));
    with(&["--set", "registration.strategy.shortlist=5"]).code(4).stderr(
        contains("registration.strategy.shortlist").and(contains("no effect")).and(contains("incremental")),
    );
    with(&["--graph", "full"]).code(4).stderr(contains("synchronization.graph").and(contains("no effect")));
    with(&["--set", "scale.voxel_m=-1"])
        .code(4)
        .stderr(contains("--set: scale.voxel_m").and(contains("positive")));
    with(&["--preset", "best"]).code(4).stderr(contains("one of default, paper"));
    with(&["--threads", "0"]).code(2);
    with(&["--colour"]).code(2).stderr(contains("--colour"));
}

#[test]
fn output_that_cannot_be_written_is_found_out_first() {
    let case = Case::new();
    let file = case.file("taken", "a file");
    for place in [file.clone(), file.join("below")] {
        let mut command = scanweave();
        command.arg("register").args(&case.good).arg("-o").arg(&place);
        command.assert().code(5).stderr(contains("taken").and(contains("cannot write")));
    }
    assert_eq!(text(&file), "a file");
}

#[test]
fn features_that_do_not_fit_are_refused() {
    let case = Case::new();
    let folder = case.path("features");
    std::fs::create_dir(&folder).unwrap();
    let npz = |name: &str, keypoints: usize, descriptors: usize, dim: usize| {
        let mut npz = ndarray_npy::NpzWriter::new(std::fs::File::create(folder.join(name)).unwrap());
        npz.add_array("keypoints", &ndarray::Array2::<f32>::ones((keypoints, 3))).unwrap();
        npz.add_array("descriptors", &ndarray::Array2::<f32>::ones((descriptors, dim))).unwrap();
        npz.finish().unwrap();
    };
    let refused = |parts: &[&str]| {
        let assert = case.register(&[]).arg("--features").arg(&folder).assert().code(3);
        let stderr = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
        for part in parts {
            assert!(stderr.contains(part), "{part:?} is not in: {stderr}");
        }
    };
    npz("a.npz", 50, 50, 32);
    refused(&["b.npz", "cannot read it"]);
    npz("b.npz", 50, 40, 32);
    refused(&["b.npz", "50", "40"]);
    npz("b.npz", 50, 50, 16);
    refused(&["16", "32"]);
}

#[cfg(unix)]
#[test]
fn ctrl_c_stops_between_items_and_leaves_nothing_half_written() {
    use std::io::{BufRead, BufReader, Read};
    use std::process::{Command, Stdio};

    let case = Case::new();
    let result = case.path("result");
    let mut child = Command::new(assert_cmd::cargo::cargo_bin("scanweave"))
        // So many hypotheses that the registration cannot be over before the signal comes.
        .args(["register", "-v", "--preset", "paper", "--threads", "1", "-o"])
        .arg(&result)
        .args(["--set", "registration.estimator.hypotheses=20000000"])
        .args(["--set", "registration.estimator.max_draws=20000000"])
        .args(&case.good)
        .stderr(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.contains("surfaces") {
        line.clear();
        assert!(stderr.read_line(&mut line).unwrap() > 0, "the stage never began");
    }
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    let mut rest = String::new();
    stderr.read_to_string(&mut rest).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{rest}");
    assert!(rest.contains("interrupted during"), "{rest}");
    // A folder that the run made and wrote nothing into goes with it.
    let left = if result.exists() { names(&result) } else { Vec::new() };
    let left: Vec<String> = left.into_iter().filter(|n| n != "cache").collect();
    assert!(left.is_empty(), "left behind: {left:?}");
}
