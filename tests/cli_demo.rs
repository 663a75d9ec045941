//! `scanweave demo` and `synth`.

mod cli_common;

use cli_common::*;
use predicates::prelude::*;
use predicates::str::contains;

#[test]
fn a_small_demo_succeeds_and_draws_its_result() {
    let place = folder();
    let result = place.path().join("demo");
    scanweave()
        .args(["demo", "--scans", "5", "--unrelated", "1", "--seed", "1", "-o"])
        .arg(&result)
        .assert()
        .success()
        .stdout(contains("the demo succeeded").and(contains("declined")).and(contains("WRONG").not()));
    assert!(text(result.join("top_view.svg")).starts_with("<svg"));
    assert_eq!(json(result.join("poses.json"))["scans"].as_array().unwrap().len(), 6);
}

#[test]
fn a_demo_that_misses_the_truth_says_so_and_fails() {
    // No inlier count suffices: everything is declined.
    scanweave()
        .args(["demo", "--scans", "3", "--set", "registration.verification.min_inliers=100000"])
        .assert()
        .code(6)
        .stdout(contains("the demo FAILED").and(contains("WRONG")));
}

#[test]
fn a_synthetic_set_is_laid_out_like_3dmatch_and_repeats() {
    let place = folder();
    let make = |name: &str, seed: &str, threads: &str| {
        let set = place.path().join(name);
        let flags = ["--scans", "3", "--seed", seed, "--threads", threads, "-o"];
        scanweave().arg("synth").args(flags).arg(&set).assert().success().stdout(contains("3 scans"));
        set
    };
    let (one, two, other) = (make("one", "7", "1"), make("two", "7", "2"), make("other", "8", "1"));
    assert_eq!(names(&one), ["PointCloud", "gt.info", "gt.log", "gt_overlap.log"]);
    for file in ["PointCloud/cloud_bin_2.ply", "PointCloud/cloud_bin_2.info.txt", "gt.info", "gt.log"] {
        let read = |set: &std::path::Path| std::fs::read(set.join(file)).unwrap();
        assert!(read(&one) == read(&two), "{file} depends on the number of threads");
        assert!(read(&one) != read(&other), "{file} does not depend on the seed");
    }
    // gt.log is info_i⁻¹ · info_j, as in the published data.
    let scene = scanweave::io::read_scene(&one).unwrap();
    let poses = scene.world_from_scan.unwrap().value;
    let log = scanweave::io::read_log(one.join("gt.log")).unwrap().value;
    assert!(!log.is_empty());
    for entry in log {
        let expected = poses[entry.i].inverse() * poses[entry.j];
        assert!((expected.to_homogeneous() - entry.pose.to_homogeneous()).abs().max() < 1e-9);
    }
    scanweave().args(["synth", "-o"]).arg(&one).assert().code(5).stderr(contains("--force"));
}
