//! `scanweave export`, and the files for other programs that `register` writes.

mod cli_common;

use cli_common::*;
use predicates::prelude::*;
use predicates::str::contains;
use std::path::Path;

const ALL: [&str; 4] = ["--trajectory", "tum,kitti,csv,colmap", "--pose-graph", "g2o,open3d"];
const FILES: [&str; 7] = [
    "images.txt",
    "pose_graph.g2o",
    "pose_graph.json",
    "trajectory.csv",
    "trajectory.tum",
    "trajectory_kitti.txt",
    "trajectory_kitti_names.txt",
];

fn exported(folder: &Path) -> Vec<String> {
    names(folder).into_iter().filter(|n| FILES.contains(&n.as_str())).collect()
}

#[test]
fn a_result_is_written_for_other_programs_with_it_or_later_and_goes_with_it() {
    let place = folder();
    let scans = synth(place.path(), 3);
    let (result, later) = (place.path().join("result"), place.path().join("later"));
    // Not ours: there is no result in the folder yet.
    std::fs::create_dir(&result).unwrap();
    std::fs::write(result.join("images.txt"), "mine").unwrap();
    let register = |more: &[&str]| {
        scanweave().args(["register", "-q"]).arg(&scans).arg("-o").arg(&result).args(more).assert().success();
    };
    register(&[]);
    assert_eq!(text(result.join("images.txt")), "mine");

    register(&[&["--force"][..], &ALL].concat());
    assert_eq!(exported(&result), FILES);
    scanweave()
        .arg("export")
        .arg(&result)
        .arg("-o")
        .arg(&later)
        .args(ALL)
        .assert()
        .success()
        .stdout(contains("trajectory.tum").and(contains("pose_graph.json")));
    assert_eq!(names(&later), FILES);

    // What is read back are the poses of the result.
    let poses = json(result.join("poses.json"));
    let entries = poses["scans"].as_array().unwrap();
    let names: Vec<String> = entries.iter().map(|s| s["name"].as_str().unwrap().to_owned()).collect();
    let files = vec![None; names.len()];
    for folder in [&result, &later] {
        for file in FILES.iter().filter(|f| !f.ends_with("_names.txt")) {
            let read = scanweave::io::initial_poses::read(folder.join(file), &names, &files).unwrap();
            for (pose, entry) in read.iter().zip(entries) {
                let matrix = pose.unwrap().to_homogeneous();
                for (r, c) in (0..3).flat_map(|r| (0..4).map(move |c| (r, c))) {
                    let stated = entry["world_from_scan"][r][c].as_f64().unwrap();
                    assert!((matrix[(r, c)] - stated).abs() < 1e-9, "{file}: {matrix} {entry}");
                }
            }
        }
    }
    let graph = json(later.join("pose_graph.json"));
    assert_eq!(graph["nodes"].as_array().unwrap().len(), 3);
    // Three scans hang together by two joins.
    let edges = graph["edges"].as_array().unwrap();
    assert_eq!(edges.iter().filter(|e| e["uncertain"] == false).count(), 2);

    // A result that replaces this one has no files of it.
    register(&["--force"]);
    assert_eq!(exported(&result), [""; 0]);
}

#[test]
fn export_says_what_it_can_write_and_what_it_needs() {
    let place = folder();
    let export = |more: &[&str]| scanweave().arg("export").arg(place.path()).args(more).assert();
    export(&[]).code(4).stderr(contains("--trajectory tum,kitti,csv,colmap"));
    export(&["--trajectory", "tum"]).code(3).stderr(contains("poses.json"));
    export(&["--trajectory", "tum,las"]).code(2).stderr(contains("'las'").and(contains("kitti")));
}
