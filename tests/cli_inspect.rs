//! `scanweave inspect` on what the other subcommands write.

mod cli_common;

use cli_common::*;
use predicates::prelude::*;
use predicates::str::contains;

#[test]
fn scans_features_checkpoints_and_results_tell_what_they_are() {
    let place = folder();
    let scans = synth(place.path(), 3);
    let (result, features) = (place.path().join("result"), place.path().join("features"));
    scanweave().args(["register", "-q", "--seed", "5"]).arg(&scans).arg("-o").arg(&result).assert().success();
    scanweave()
        .args(["describe", "-q", "--seed", "5"])
        .arg(&scans)
        .arg("-o")
        .arg(&features)
        .assert()
        .success();

    let checkpoint = concat!(env!("CARGO_MANIFEST_DIR"), "/checkpoints/netvlad-fpfh.safetensors");
    let mut all = scanweave();
    // Short names, which no table wraps.
    all.current_dir(place.path()).args(["inspect", "set/PointCloud", "features", "result"]).arg(checkpoint);
    all.assert().success().stdout(
        contains("cloud_bin_2.ply")
            .and(contains("cloud_bin_2.npz"))
            .and(contains("placed     3 of 3 scans"))
            .and(contains("preset default, method agglomerative, seed 5"))
            .and(contains("checksum right")),
    );
    let output = all.arg("--json").assert().success();
    let found: serde_json::Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
    let kinds: Vec<&str> = found.as_array().unwrap().iter().map(|f| f["kind"].as_str().unwrap()).collect();
    let (s, f) = ("scan", "features");
    assert_eq!(kinds, [s, s, s, f, f, f, "result", "checkpoint"]);
    // The same numbers as the run itself wrote down.
    let report = json(result.join("report.json"));
    for i in 0..3 {
        assert_eq!(found[i]["points"], report["sizes"][i]["points"]);
        assert_eq!(found[3 + i]["keypoints"], report["sizes"][i]["keypoints"]);
        assert_eq!(
            found[i]["bytes"],
            std::fs::metadata(place.path().join(found[i]["path"].as_str().unwrap())).unwrap().len()
        );
    }
    assert_eq!(found[6]["components"], serde_json::json!([3]));

    let junk = place.path().join("notes.doc");
    std::fs::write(&junk, [0u8, 1, 2]).unwrap();
    scanweave().arg("inspect").arg(&junk).assert().code(3).stdout("").stderr(contains("notes.doc"));
}
