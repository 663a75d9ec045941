//! A recording read back with Rerun's own decoder.

use re_chunk::Chunk;
use re_chunk::external::arrow::array::Array as _;
use re_log_encoding::DecoderApp;
use re_log_types::{EntityPath, LogMsg, TimelineName};
use scanweave_rerun::{Written, export};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Two models and a scan that was left out. The second scan is turned by a quarter about z.
const POSES: &str = r#"{
  "format": "scanweave-poses", "version": 2, "generator": "test",
  "components": [{"pivot": 0, "scans": [0, 1]}, {"pivot": 2, "scans": [2]}],
  "scans": [
    {"id": 0, "name": "a/b c", "file": null, "origin_m": [0,0,0], "outcome": "placed", "component": 0, "step": 0,
     "world_from_scan": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "quaternion_xyzw": [0,0,0,1],
     "parent": null, "matches": 0, "inliers": 0, "inlier_ratio": 0, "residual_m": 0, "evidence": null, "neighbours": []},
    {"id": 1, "name": "<b>", "file": null, "origin_m": [0,0,0], "outcome": "placed", "component": 0, "step": 1,
     "world_from_scan": [[0,-1,0,1],[1,0,0,2],[0,0,1,3],[0,0,0,1]], "quaternion_xyzw": [0,0,0.7071067811865476,0.7071067811865476],
     "parent": 0, "matches": 310, "inliers": 83, "inlier_ratio": 0.27, "residual_m": 0, "evidence": null, "neighbours": []},
    {"id": 2, "name": "c", "file": null, "origin_m": [0,0,0], "outcome": "placed", "component": 1, "step": 0,
     "world_from_scan": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "quaternion_xyzw": [0,0,0,1],
     "parent": null, "matches": 0, "inliers": 0, "inlier_ratio": 0, "residual_m": 0, "evidence": null, "neighbours": []},
    {"id": 3, "name": "d", "file": null, "origin_m": [0,0,0], "outcome": "declined",
     "decline": {"reason": "too-few-keypoints", "keypoints": 0, "needed": 3}, "explanation": "no keypoints"}
  ]
}"#;

/// Points with their scans, as `scanweave register` writes them.
fn ply(path: &Path, points: &[([f32; 3], i32)]) {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\ncomment lengths in metres\nelement vertex {}\nproperty float x\n\
         property float y\nproperty float z\nproperty int scan\nend_header\n",
        points.len()
    )
    .into_bytes();
    for (p, scan) in points {
        bytes.extend(p.iter().flat_map(|v| v.to_le_bytes()).chain(scan.to_le_bytes()));
    }
    std::fs::write(path, bytes).unwrap();
}

fn result(folder: &Path) {
    std::fs::write(folder.join("poses.json"), POSES).unwrap();
    // Of the second scan: (1 − y, 2 + x, 3 + z) of (5, 6, 7).
    ply(&folder.join("merged.ply"), &[([1.0, 1.0, 1.0], 0), ([-5.0, 7.0, 10.0], 1), ([2.0, 1.0, 1.0], 0)]);
    ply(&folder.join("merged_1.ply"), &[([4.0, 4.0, 4.0], 2)]);
}

/// Rows of every entity: at which step, and its components as text.
fn rows(file: &Path) -> BTreeMap<String, Vec<(Option<i64>, String)>> {
    let step = TimelineName::from("step");
    let mut found: BTreeMap<String, Vec<(Option<i64>, String)>> = BTreeMap::new();
    for message in DecoderApp::decode_lazy(BufReader::new(File::open(file).unwrap())) {
        let LogMsg::ArrowMsg(_, arrow) = message.unwrap() else { continue };
        let chunk = Chunk::from_arrow_msg(&arrow).unwrap();
        let times: Vec<Option<i64>> = match chunk.timelines().get(&step) {
            Some(column) => column.times_raw().iter().map(|&t| Some(t)).collect(),
            None => vec![None; chunk.num_rows()],
        };
        for (row, time) in times.into_iter().enumerate() {
            let mut text = String::new();
            for name in chunk.components_identifiers() {
                let list = chunk.components().get_array(name).unwrap();
                if list.is_valid(row) {
                    text.push_str(&format!("{name} {:?}\n", list.value(row)));
                }
            }
            found.entry(chunk.entity_path().to_string()).or_default().push((time, text));
        }
    }
    found
}

#[test]
fn a_result_becomes_a_recording_that_rerun_reads() {
    let place = tempfile::tempdir().unwrap();
    result(place.path());
    let file = place.path().join("growth.rrd");
    let written = export(place.path(), &file).unwrap();
    assert_eq!(written, Written { placed: 3, declined: 1, points: 4 });
    let left: Vec<_> = std::fs::read_dir(place.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 4, "{left:?}");

    let rows = rows(&file);
    let at = |model: &str, kind: &str, name: &str| -> Vec<(Option<i64>, String)> {
        let parts = ["world", model, kind, name].map(|p| re_log_types::EntityPathPart::new(p.to_owned()));
        rows.get(&EntityPath::new(parts.to_vec()).to_string()).cloned().unwrap_or_default()
    };
    for (model, name, step) in [("model_1", "a/b c", 0), ("model_1", "<b>", 1), ("model_2", "c", 0)] {
        let logged = at(model, "scans", name);
        assert!(!logged.is_empty() && logged.iter().all(|r| r.0 == Some(step)), "{name}: {logged:?}");
        let text: String = logged.iter().map(|r| r.1.as_str()).collect();
        for part in
            ["Points3D:positions", "Points3D:colors", "Transform3D:translation", "Transform3D:quaternion"]
        {
            assert!(text.contains(part), "{part} is missing in {text}");
        }
    }
    let text: String = at("model_1", "scans", "<b>").iter().map(|r| r.1.clone()).collect();
    // The point of the second scan in its own frame, and where the scan lies.
    for numbers in [["5.0", "6.0", "7.0"], ["1.0", "2.0", "3.0"]] {
        let lines: Vec<&str> = text.lines().map(str::trim).collect();
        let follows = |w: &&[&str]| (0..3).all(|k| w[k].trim_end_matches(',') == numbers[k]);
        assert!(lines.windows(3).any(|w| follows(&w)), "{numbers:?} is missing in {text}");
    }
    // Only the second scan joined another one.
    assert_eq!(at("model_1", "growth", "<b>").len(), 1);
    assert!(at("model_1", "growth", "a/b c").is_empty() && at("model_2", "growth", "c").is_empty());
    let log: String = rows["/log"].iter().map(|r| format!("{:?} {}", r.0, r.1)).collect();
    for said in
        ["<b> joins a/b c: 83 of 310 matches agree", "d was left out: no keypoints", "c begins model 2"]
    {
        assert!(log.contains(said), "{said} is missing in {log}");
    }
}

#[test]
fn what_does_not_fit_is_one_clear_error_and_nothing_is_written() {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("growth.rrd");
    let refused = |said: &str| {
        let error = format!("{:#}", export(place.path(), &file).unwrap_err());
        assert!(error.contains(said), "{said} is missing in {error}");
        let all: Vec<_> = std::fs::read_dir(place.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert!(!all.iter().any(|n| n.to_string_lossy().contains("rrd")), "{all:?}");
    };
    refused("poses.json: cannot read it");
    result(place.path());
    std::fs::write(place.path().join("poses.json"), POSES.replace("\"version\": 2", "\"version\": 3"))
        .unwrap();
    refused("version 3");
    std::fs::write(place.path().join("poses.json"), POSES.replace("\"parent\": 0", "\"parent\": 9")).unwrap();
    refused("<b>");
    result(place.path());
    ply(&place.path().join("merged.ply"), &[([0.0; 3], 3)]);
    refused("scan 3");
    std::fs::write(place.path().join("merged.ply"), "ply\n").unwrap();
    refused("merged.ply");
    result(place.path());
    let nowhere = place.path().join("no/such.rrd");
    assert!(format!("{:#}", export(place.path(), &nowhere).unwrap_err()).contains("cannot write"));
    // Without merged clouds the poses remain.
    for name in ["merged.ply", "merged_1.ply"] {
        std::fs::remove_file(place.path().join(name)).unwrap();
    }
    assert_eq!(export(place.path(), &file).unwrap(), Written { placed: 3, declined: 1, points: 0 });
}
