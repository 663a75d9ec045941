//! Results whose documents name what is not there, or what is none of their business.

mod cli_common;

use cli_common::{corner, folder, json, scanweave, text, write_ply};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Two scans of a corner, registered: the folder of the scans and that of the result.
fn registered(place: &Path) -> (PathBuf, PathBuf) {
    let (scans, result) = (place.join("scans"), place.join("result"));
    std::fs::create_dir(&scans).unwrap();
    for k in 0..2 {
        let moved: Vec<[f64; 3]> = corner().iter().map(|p| [p[0] + 0.3 * f64::from(k), p[1], p[2]]).collect();
        write_ply(&scans.join(format!("s{k}.ply")), &moved);
    }
    scanweave().args(["register", "-q"]).arg(&scans).arg("-o").arg(&result).assert().success();
    (scans, result)
}

/// Changes poses.json of a result.
fn edit(result: &Path, at: &str, value: Value) {
    let path = result.join("poses.json");
    let mut poses = json(&path);
    *poses.pointer_mut(at).unwrap_or_else(|| panic!("nothing at {at}")) = value;
    std::fs::write(path, poses.to_string()).unwrap();
}

fn run(words: &[&str], result: &Path) -> assert_cmd::assert::Assert {
    scanweave()
        .arg(words[0])
        .arg(result)
        .args(&words[1..])
        .timeout(std::time::Duration::from_secs(60))
        .assert()
}

#[test]
fn a_document_that_names_scans_that_are_not_there_is_refused_by_every_command() {
    let place = folder();
    let (scans, result) = registered(place.path());
    let page = text(result.join("report.html"));
    let child = (0..2).find(|i| !json(result.join("poses.json"))["scans"][i]["parent"].is_null()).unwrap();
    edit(&result, &format!("/scans/{child}/parent"), 99.into());
    let truth = ["evaluate", "--truth", scans.to_str().unwrap()];
    for words in [&["report"][..], &["inspect"], &["export", "--trajectory", "tum"], &truth] {
        let said = contains(format!("poses.json: found parent 99 of scan {child}, expected"));
        run(words, &result).code(3).stderr(said);
    }
    assert_eq!(text(result.join("report.html")), page);
    edit(&result, &format!("/scans/{child}/parent"), (1 - child).into());
    run(&["report"], &result).success();
    edit(&result, "/components/0/scans", serde_json::json!([0, 1, 99]));
    run(&["report"], &result).code(3).stderr(contains("3 scans listed in component 0"));
}

#[test]
fn only_files_of_scans_are_read_from_a_result() {
    let place = folder();
    let (scans, result) = registered(place.path());
    // A whole scan, but by another name: it could be any file of this machine.
    let secret = place.path().join("secret.key");
    std::fs::copy(scans.join("s0.ply"), &secret).unwrap();
    edit(&result, "/scans/0/file", secret.to_str().unwrap().into());
    let said = contains("secret.key").and(contains("does not end")).and(contains("(s0)"));
    run(&["report"], &result).success().stderr(said);
    assert!(text(result.join("report.html")).contains("\"points_from\":\"merged\""));
    let out = place.path().join("out");
    let export = ["export", "--export-scans", out.to_str().unwrap(), "--format", "ply"];
    run(&export, &result).code(3).stderr(contains("secret.key").and(contains("does not end")));

    edit(&result, "/scans/0/file", place.path().join("gone.ply").to_str().unwrap().into());
    run(&["report"], &result).success().stderr(contains("(s0)").and(contains("does not end").not()));
}

#[cfg(unix)]
#[test]
fn a_pipe_in_the_place_of_a_file_is_not_waited_for() {
    let place = folder();
    let (_, result) = registered(place.path());
    let pipe = place.path().join("pipe.ply");
    if !std::process::Command::new("mkfifo").arg(&pipe).status().is_ok_and(|s| s.success()) {
        return;
    }
    edit(&result, "/scans/1/file", pipe.to_str().unwrap().into());
    run(&["report"], &result).success().stderr(contains("found a pipe").and(contains("(s1)")));
    let out = place.path().join("out");
    let export = ["export", "--export-scans", out.to_str().unwrap(), "--format", "ply"];
    run(&export, &result).code(3).stderr(contains("pipe.ply: found a pipe"));
    for name in ["report.json", "config.toml", "poses.json"] {
        let (path, kept) = (result.join(name), result.join("kept"));
        std::fs::rename(&path, &kept).unwrap();
        std::fs::rename(&pipe, &path).unwrap();
        run(&["report"], &result).code(3).stderr(contains(format!("{name}: found a pipe")));
        std::fs::rename(&path, &pipe).unwrap();
        std::fs::rename(&kept, &path).unwrap();
    }
}

#[test]
fn a_result_without_its_last_file_is_not_evaluated() {
    let place = folder();
    let (scans, result) = registered(place.path());
    std::fs::remove_file(result.join("poses.json")).unwrap();
    run(&["evaluate", "--truth", scans.to_str().unwrap()], &result).code(3).stderr(contains("poses.json"));
}

#[test]
fn cached_features_of_two_scans_that_are_swapped_are_computed_again() {
    let place = folder();
    let (scans, _) = registered(place.path());
    let describe = |output: &str| {
        let mut command = scanweave();
        command.arg("describe").arg(&scans).arg("-o").arg(place.path().join(output));
        command.arg("--cache").arg(place.path().join("cache")).assert().success()
    };
    describe("one");
    let entries: Vec<PathBuf> =
        std::fs::read_dir(place.path().join("cache")).unwrap().map(|e| e.unwrap().path()).collect();
    // Thinned scans and features.
    let is_surface = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().starts_with("surface-");
    let kinds: (Vec<PathBuf>, Vec<PathBuf>) = entries.into_iter().partition(is_surface);
    let swapped = [kinds.0, kinds.1].map(|kind| {
        let [a, b] = &kind[..] else { panic!("{kind:?}") };
        let both = [a, b].map(|path| (path.clone(), std::fs::read(path).unwrap()));
        std::fs::write(a, &both[1].1).unwrap();
        std::fs::write(b, &both[0].1).unwrap();
        both
    });
    describe("two")
        .stderr(contains("features of another scan").and(contains("surface of another scan")))
        .stdout(contains("0 not computed now"));
    for name in ["s0.npz", "s1.npz"] {
        let [one, two] = ["one", "two"].map(|o| std::fs::read(place.path().join(o).join(name)).unwrap());
        assert!(one == two, "{name}");
    }
    assert!(swapped.iter().flatten().all(|(path, bytes)| &std::fs::read(path).unwrap() == bytes));
    describe("three").stderr("").stdout(contains("2 not computed now"));
}
