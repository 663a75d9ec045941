//! `scanweave register` on sets that can be registered: what it writes, says, and keeps.

mod cli_common;

use cli_common::*;
use predicates::prelude::*;
use predicates::str::contains;
use std::path::Path;

const FILES: [&str; 9] = [
    "cache",
    "config.toml",
    "merged.ply",
    "overlap.csv",
    "poses.json",
    "registration.html",
    "report.html",
    "report.json",
    "trajectory.log",
];

fn register(scans: &Path, output: &Path, more: &[&str]) -> assert_cmd::assert::Assert {
    scanweave().arg("register").arg(scans).arg("-o").arg(output).args(more).assert()
}

#[test]
fn a_result_is_whole_reproducible_kept_and_only_replaced_by_force() {
    let place = folder();
    let scans = synth(place.path(), 4);
    let (one, two) = (place.path().join("one"), place.path().join("two"));

    register(&scans, &one, &["--threads", "1", "--seed", "3"])
        .success()
        .stdout(contains("cloud_bin_0").and(contains("prob.")).and(contains("placed   4 of 4 scans")))
        .stdout(contains("voxel").and(contains("trained checkpoint netvlad-mini-spin-net-fpfh")))
        .stderr("");
    assert_eq!(names(&one), FILES);
    register(&scans, &two, &["--threads", "2", "--seed", "3"]).success();
    for file in
        ["poses.json", "trajectory.log", "merged.ply", "overlap.csv", "config.toml", "registration.html"]
    {
        let read = |folder: &Path| std::fs::read(folder.join(file)).unwrap();
        assert!(read(&one) == read(&two), "{file} differs between 1 and 2 threads");
    }

    // The poses are those of the truth that `synth` wrote (noise 0.3; errors of a few mm expected).
    let poses = json(one.join("poses.json"));
    for entry in poses["scans"].as_array().unwrap() {
        let id = entry["id"].as_u64().unwrap() as usize;
        let pivot = poses["components"][0]["pivot"].as_u64().unwrap() as usize;
        let info = |i: usize| {
            scanweave::io::read_matrix(scans.join(format!("cloud_bin_{i}.info.txt"))).unwrap().value
        };
        let truth = info(pivot).inverse() * info(id);
        for r in 0..3 {
            let estimate = entry["world_from_scan"][r][3].as_f64().unwrap();
            assert!(
                (estimate - truth.translation.vector[r]).abs() < 0.05,
                "scan {id}: {estimate} against {truth}"
            );
        }
    }
    let report = json(one.join("report.json"));
    assert_eq!(report["placed"], 4);
    assert_eq!(report["seed"], 3);
    // Every placed scan, the pivot too, states its probability, and the centre of its covariance.
    for (row, entry) in report["evidence"].as_array().unwrap().iter().zip(poses["scans"].as_array().unwrap())
    {
        let probability = row["probability"].as_f64().unwrap();
        assert!((0.5..=1.0).contains(&probability), "{probability}");
        assert_eq!(row["probability"], entry["evidence"]["probability"]);
        assert_eq!(entry["pose_uncertainty"]["centre"].as_array().unwrap().len(), 3);
    }
    assert_eq!(report["sizes"][0]["features_reused"], false);
    assert!(report["timings"].as_array().unwrap().iter().any(|t| t["stage"] == "registration"));
    assert!(text(one.join("config.toml")).contains("seed = 3"));

    // A second run into the same folder is refused, and with --force skips the features.
    let before = std::fs::read(one.join("poses.json")).unwrap();
    register(&scans, &one, &["--seed", "3"])
        .code(5)
        .stderr(contains("already holds a result").and(contains("--force")));
    let output = register(&scans, &one, &["--seed", "3", "--force", "--json"]).success();
    assert_eq!(std::fs::read(one.join("poses.json")).unwrap(), before, "cached features change the result");
    assert_eq!(names(&one), FILES);
    let document: serde_json::Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
    assert_eq!(document["report"]["sizes"][3]["features_reused"], true);
    assert_eq!(document["poses"], poses);

    // The effective configuration is one that gives the same result.
    let again = place.path().join("again");
    let config = one.join("config.toml");
    register(&scans, &again, &["-q", "--config", config.to_str().unwrap()]).success().stdout("");
    assert_eq!(std::fs::read(again.join("poses.json")).unwrap(), before);

    // A damaged cache is computed again.
    let cache = one.join("cache");
    let entry = cache.join(&names(&cache)[0]);
    std::fs::write(&entry, b"not an archive").unwrap();
    register(&scans, &one, &["--seed", "3", "--force", "-q"]).success();
    assert_eq!(std::fs::read(one.join("poses.json")).unwrap(), before);
}

#[test]
fn an_unrelated_scan_is_declined_and_the_run_still_succeeds() {
    let place = folder();
    let set = place.path().join("set");
    let synth = ["synth", "-q", "--scans", "4", "--unrelated", "1", "--noise", "0.3", "-o"];
    scanweave().args(synth).arg(&set).assert().success();
    let result = place.path().join("result");
    register(&set, &result, &[]).success().stdout(contains("declined").and(contains("reason")));
    let poses = json(result.join("poses.json"));
    let scans = poses["scans"].as_array().unwrap();
    let declined: Vec<_> = scans.iter().filter(|s| s["outcome"] == "declined").collect();
    assert_eq!(declined.len(), 1);
    assert!(declined[0]["decline"]["reason"].is_string());
    // The truth has no pair with the unrelated scan.
    let id = declined[0]["id"].as_u64().unwrap();
    let pairs = text(set.join("gt_overlap.log"));
    assert!(
        pairs.lines().all(|l| l.split(',').take(2).all(|n| n != id.to_string())),
        "scan {id} is related:\n{pairs}"
    );
}

#[test]
fn both_presets_print_read_back_and_differ() {
    let print = |preset: &str| {
        let output = scanweave().args(["config", "--preset", preset]).assert().success();
        String::from_utf8(output.get_output().stdout.clone()).unwrap()
    };
    let (default, paper) = (print("default"), print("paper"));
    assert!(paper.contains("kind = \"ransac\"") && paper.contains("hypotheses = 1000"));
    assert_ne!(default, paper);
    let place = folder();
    let file = place.path().join("paper.toml");
    std::fs::write(&file, &paper).unwrap();
    scanweave().arg("config").arg("--config").arg(&file).assert().success().stdout(paper);
    let schema = scanweave().args(["config", "--schema"]).assert().success();
    let schema: serde_json::Value = serde_json::from_slice(&schema.get_output().stdout).unwrap();
    assert!(schema["properties"]["registration"].is_object());
}

#[test]
fn completions_and_man_pages_know_the_subcommands() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        scanweave()
            .args(["completions", shell])
            .assert()
            .success()
            .stdout(contains("register").and(contains("demo")));
    }
    scanweave().arg("man").assert().success().stdout(contains(".TH scanweave").and(contains("register")));
    let place = folder();
    scanweave().args(["man", "-o"]).arg(place.path()).assert().success();
    assert!(names(place.path()).contains(&"scanweave-register.1".to_owned()));
}

#[test]
fn a_global_method_is_chosen_by_a_flag_and_says_what_it_needs() {
    let place = folder();
    let scans = synth(place.path(), 4);
    let out = place.path().join("out");
    register(&scans, &out, &["--method", "sghr", "--graph", "full", "--json"]).success();
    let report = json(out.join("report.json"));
    assert_eq!(report["method"], "sghr");
    assert_eq!(report["registered_pairs"], 6);
    assert_eq!(report["placed"], 4);
    let config = text(out.join("config.toml"));
    assert!(config.contains("method = \"sghr\"") && config.contains("graph = \"full\""), "{config}");

    register(&scans, &out, &["--method", "hara", "--graph", "full", "--force"])
        .success()
        .stdout(contains("pairs    6 registered").and(contains("kept for hara")));
    let other = place.path().join("other");
    register(&scans, &other, &["--method", "magic"])
        .code(2)
        .stderr(contains("incremental").and(contains("pose-graph")));
    register(&scans, &other, &["--method", "incremental"]).success();
    assert_eq!(json(other.join("report.json"))["method"], "incremental");
    std::fs::remove_file(other.join("poses.json")).unwrap();
    register(&scans, &other, &["--method", "lits"]).code(4).stderr(contains("synchronization.lits_weights"));
    register(&scans, &other, &["--set", "synchronization.neighbours=0"])
        .code(4)
        .stderr(contains("synchronization.neighbours"));
    assert!(!other.join("poses.json").exists());
}
