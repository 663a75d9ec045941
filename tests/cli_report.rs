//! `scanweave report`, and the report.html that `register` writes.

mod cli_common;

use cli_common::*;
use predicates::prelude::*;
use predicates::str::contains;
use std::path::{Path, PathBuf};

/// The data that a page holds, without what differs from run to run.
fn data(page: impl AsRef<Path>) -> serde_json::Value {
    let page = text(page);
    let (_, rest) = page.split_once("<script type=\"application/json\" id=\"data\">").expect("data");
    let (json, _) = rest.split_once("</script>").expect("an end");
    let mut data: serde_json::Value = serde_json::from_str(json).expect("JSON");
    for key in ["timings", "total_seconds", "peak_memory_bytes"] {
        data[key] = serde_json::Value::Null;
    }
    data
}

fn report(result: &Path) -> assert_cmd::Command {
    let mut command = scanweave();
    command.arg("report").arg(result);
    command
}

#[test]
fn a_result_gives_the_page_that_register_wrote_and_every_problem_is_named() {
    let place = folder();
    let scans = synth(place.path(), 3);
    let hostile = "<img src=x onerror=alert(1)> \"'&.ply";
    std::fs::rename(scans.join("cloud_bin_1.ply"), scans.join(hostile)).unwrap();
    let result = place.path().join("result");
    scanweave()
        .args(["register", "-q", "--threads", "1"])
        .arg(&scans)
        .arg("-o")
        .arg(&result)
        .assert()
        .success();
    let page = result.join("report.html");
    let first = data(&page);
    assert!(!text(&page).contains("<img"), "a name became an element");

    // Names, verdicts and points are there: 16-bit coordinates of as many points as it says.
    let entries = first["scans"].as_array().unwrap();
    assert!(entries.iter().any(|s| s["name"] == hostile.strip_suffix(".ply").unwrap()));
    assert_eq!(first["headline"], "All 3 scans placed in one model.");
    for scan in entries {
        let count = scan["points"]["count"].as_u64().unwrap() as usize;
        assert!(count > 1000, "{count} points");
        assert_eq!(scan["points"]["xyz"].as_str().unwrap().len(), (6 * count).div_ceil(3) * 4);
        assert!(scan["points"]["residual"].is_string());
        assert!(scan["placed"]["world_from_scan"].is_array());
    }

    // The same page from the files alone, on another number of threads.
    std::fs::remove_file(&page).unwrap();
    report(&result).args(["--threads", "2"]).assert().success().stdout(contains("All 3 scans placed"));
    assert_eq!(data(&page), first);

    // With the truth that `synth` wrote every scan tells its error (a few mm; see cli_register.rs).
    let judged = place.path().join("judged.html");
    std::fs::rename(scans.join("cloud_bin_1.info.txt"), scans.join(hostile.replace(".ply", ".info.txt")))
        .unwrap();
    report(&result).arg("-o").arg(&judged).arg("--truth").arg(&scans).assert().success();
    for scan in data(&judged)["scans"].as_array().unwrap() {
        let error = scan["error"]["translation_m"].as_f64().unwrap();
        assert!(error < 0.05, "{error} m");
    }
    assert_eq!(first["scans"][0]["error"], serde_json::Value::Null);
    report(&result).arg("--truth").arg(&result).assert().code(3).stderr(contains("result"));

    // Without the scans the verdicts remain; --scans brings the points back.
    let moved: PathBuf = place.path().join("moved");
    std::fs::rename(&scans, &moved).unwrap();
    let other = place.path().join("other.html");
    report(&result).arg("-o").arg(&other).assert().success().stderr(contains("--scans"));
    let bare = data(&other);
    assert_eq!(bare["scans"][0]["points"]["count"], 0);
    assert_eq!(bare["scans"][0]["placed"], first["scans"][0]["placed"]);
    report(&result).arg("-o").arg(&other).arg("--scans").arg(&moved).assert().success().stderr("");
    assert_eq!(data(&other), first);

    // One clear error each, and the old page stays.
    let one = moved.join("cloud_bin_0.ply");
    report(&result)
        .arg("--scans")
        .arg(&one)
        .assert()
        .code(4)
        .stderr(contains("--scans").and(contains("3 scans")));
    report(&moved).assert().code(3).stderr(contains("poses.json"));
    report(&result)
        .arg("-o")
        .arg(place.path().join("no/such.html"))
        .arg("--scans")
        .arg(&moved)
        .assert()
        .code(5);
    let overlap = result.join("overlap.csv");
    let whole = text(&overlap);
    assert!(whole.starts_with("scan_a,scan_b,predicted,verified\n0,1,"), "{whole}");
    std::fs::write(&overlap, "0,1\n").unwrap();
    report(&result).assert().code(3).stderr(contains("overlap.csv"));
    std::fs::remove_file(&overlap).unwrap();
    report(&result).arg("-o").arg(&other).arg("--scans").arg(&moved).assert().success();
    assert_eq!(data(&other)["similarity"], serde_json::Value::Null);
    std::fs::write(result.join("report.json"), "{}").unwrap();
    report(&result).assert().code(3).stderr(contains("report.json"));
    assert_eq!(data(&page), first);
}
