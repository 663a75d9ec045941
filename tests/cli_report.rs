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

/// The same but for the last digit of numbers, which reading them back may change.
fn assert_same(one: &serde_json::Value, other: &serde_json::Value, at: &str) {
    use serde_json::Value::{Array, Number, Object};
    match (one, other) {
        (Number(x), Number(y)) => {
            let (x, y) = (x.as_f64().unwrap(), y.as_f64().unwrap());
            assert!((x - y).abs() <= 1e-14 * x.abs().max(y.abs()), "{at}: {x} {y}");
        }
        (Array(x), Array(y)) => {
            assert_eq!(x.len(), y.len(), "{at}");
            x.iter().zip(y).enumerate().for_each(|(k, (x, y))| assert_same(x, y, &format!("{at}/{k}")));
        }
        (Object(x), Object(y)) => {
            assert_eq!(x.keys().collect::<Vec<_>>(), y.keys().collect::<Vec<_>>(), "{at}");
            x.iter().for_each(|(key, value)| assert_same(value, &y[key], &format!("{at}/{key}")));
        }
        _ => assert_eq!(one, other, "{at}"),
    }
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

    // Names, outcomes and points are there: 16-bit coordinates of as many points as it says.
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
    assert_same(&data(&page), &first, "");

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

    // Without the scans --scans brings the points back.
    let moved: PathBuf = place.path().join("moved");
    std::fs::rename(&scans, &moved).unwrap();
    let other = place.path().join("other.html");
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

/// Points of a scan of a page, in the scan's frame: the layout that the viewer reads.
fn points(scan: &serde_json::Value) -> Vec<[f64; 3]> {
    let numbers = |name: &str| {
        let values = scan["points"][name].as_array().unwrap();
        values.iter().map(|v| v.as_f64().unwrap()).collect::<Vec<_>>()
    };
    let (low, size) = (numbers("low"), numbers("size"));
    let bytes = base64(scan["points"]["xyz"].as_str().unwrap());
    let at = |six: &[u8], a: usize| f64::from(u16::from_le_bytes([six[2 * a], six[2 * a + 1]])) / 65535.0;
    bytes.chunks_exact(6).map(|six| [0, 1, 2].map(|a| low[a] + size[a] * at(six, a))).collect()
}

/// RFC 4648.
fn base64(text: &str) -> Vec<u8> {
    let value = |c: u8| match c {
        b'A'..=b'Z' => c - b'A',
        b'a'..=b'z' => c - b'a' + 26,
        b'0'..=b'9' => c - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let text = text.trim_end_matches('=').as_bytes();
    text.chunks(4)
        .flat_map(|four| {
            let bits =
                four.iter().enumerate().fold(0u32, |v, (k, &c)| v | u32::from(value(c)) << (18 - 6 * k));
            bits.to_be_bytes()[1..four.len()].to_vec()
        })
        .collect()
}

#[test]
fn a_result_whose_scans_are_gone_shows_its_merged_cloud_and_says_so() {
    let place = folder();
    let scans = synth(place.path(), 3);
    // A scan that fits nowhere: nothing of it is in the merged cloud.
    write_ply(&scans.join("cloud_bin_9.ply"), &[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]);
    let result = place.path().join("result");
    scanweave().args(["register", "-q"]).arg(&scans).arg("-o").arg(&result).assert().success();
    let page = result.join("report.html");
    let first = data(&page);
    assert_eq!(first["headline"], "3 of 4 scans placed in one model; one was left out.");
    assert_eq!(first["scans"][0]["points_from"], "scan");
    std::fs::remove_dir_all(&scans).unwrap();

    let said = contains("4 scans").and(contains("of 3 of them")).and(contains("--scans"));
    report(&result).assert().success().stderr(said);
    let after = data(&page);
    let model = merged_points(&result.join("merged.ply"));
    let mut shown = 0;
    for (scan, before) in after["scans"].as_array().unwrap().iter().zip(first["scans"].as_array().unwrap()) {
        assert_eq!(scan["placed"], before["placed"]);
        let points = points(scan);
        if scan["placed"].is_null() {
            assert!(points.is_empty());
            continue;
        }
        assert_eq!(scan["points_from"], "merged");
        // Means over scans say nothing about the distance between them.
        assert!(scan["points"]["residual"].is_null() && before["points"]["residual"].is_string());
        assert!(points.len() > 500, "{} points", points.len());
        shown += points.len();
        // Moved by the pose, every point lies in the model: within half a diagonal of the page's
        // voxels (half the working voxel wide), whose mean it is.
        let near = 0.87 * 0.5 * after["scale"]["voxel_m"].as_f64().unwrap() + 1e-3;
        let pose = &scan["placed"]["world_from_scan"];
        let entry = |r: usize, c: usize| pose[r][c].as_f64().unwrap();
        for p in points.iter().step_by(97) {
            let world = [0, 1, 2].map(|r| (0..3).map(|c| entry(r, c) * p[c]).sum::<f64>() + entry(r, 3));
            let off = |q: &[f64; 3]| (0..3).map(|a| (world[a] - q[a]).powi(2)).sum::<f64>().sqrt();
            let least = model.iter().map(off).fold(f64::INFINITY, f64::min);
            assert!(least <= near, "{least} m from the model");
        }
    }
    // A voxel grid in another frame may join a few neighbours.
    assert!(shown <= model.len() && shown as f64 > 0.4 * model.len() as f64, "{shown} of {}", model.len());

    // A cloud of another result is an error; without any cloud the outcomes remain.
    let ply = std::fs::read(result.join("merged.ply")).unwrap();
    let last = ply.len() - 4;
    let mut other = ply.clone();
    other[last..].copy_from_slice(&3i32.to_le_bytes());
    std::fs::write(result.join("merged.ply"), other).unwrap();
    report(&result).assert().code(3).stderr(contains("merged.ply").and(contains("different runs")));
    assert_eq!(data(&page), after);
    std::fs::remove_file(result.join("merged.ply")).unwrap();
    report(&result).assert().success().stderr(contains("of 0 of them"));
    for scan in data(&page)["scans"].as_array().unwrap() {
        assert_eq!(scan["points"]["count"], 0);
    }
}

/// Points of a binary PLY of float x y z, with colours or not, and int scan.
fn merged_points(path: &Path) -> Vec<[f64; 3]> {
    let bytes = std::fs::read(path).unwrap();
    let end = b"end_header\n";
    let start = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let row = if String::from_utf8_lossy(&bytes[..start]).contains("uchar red") { 19 } else { 16 };
    let float = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    bytes[start..].chunks_exact(row).map(|r| [0, 4, 8].map(|at| float(&r[at..]))).collect()
}
