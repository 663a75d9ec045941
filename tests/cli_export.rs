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
            let read = scanweave::io::read_initial_poses(folder.join(file), &names, &files).unwrap();
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

#[cfg(unix)]
#[test]
fn exported_scans_are_whole_or_not_there_and_those_without_a_pose_are_named() {
    let place = folder();
    let scans = synth(place.path(), 2);
    // A third that has nothing in common with them: one small flat square.
    let square: Vec<[f64; 3]> =
        (0..3600).map(|k| [f64::from(k % 60) * 0.05, f64::from(k / 60) * 0.05, 0.0]).collect();
    write_ply(&scans.join("square.ply"), &square);
    let result = place.path().join("result");
    let registered =
        scanweave().args(["register", "-q"]).arg(&scans).arg("-o").arg(&result).output().unwrap();
    assert!(registered.status.code().is_some_and(|code| code < 2), "{registered:?}");
    let poses = json(result.join("poses.json"));
    let of = |outcome: &str| {
        let scans = poses["scans"].as_array().unwrap().iter().filter(|s| s["outcome"] == outcome);
        scans.map(|s| s["name"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!((of("placed").len(), of("declined")), (2, vec!["square".to_owned()]));
    let out = place.path().join("out");
    // What is hidden lists them.
    let visible = |name: &String| !name.starts_with('.');
    let files = || if out.exists() { names(&out).into_iter().filter(visible).count() } else { 0 };
    for format in ["ply", "pcd", "las", "laz", "e57"] {
        // A disk that is full after a few kilobytes: what goes beyond the limit is an error of writing.
        let program = scanweave().get_program().to_owned();
        let script =
            "trap '' XFSZ; ulimit -f 8; exec \"$0\" export \"$1\" --export-scans \"$2\" --format \"$3\"";
        let full = std::process::Command::new("sh")
            .args(["-c", script])
            .args([program.as_os_str(), result.as_os_str(), out.as_os_str(), format.as_ref()])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&full.stderr).into_owned();
        assert!(full.status.code() == Some(5) && said.contains("cannot write it"), "{format}: {full:?}");
        assert_eq!(files(), 0, "{format}");
        scanweave()
            .arg("export")
            .arg(&result)
            .arg("--export-scans")
            .arg(&out)
            .args(["--format", format])
            .assert()
            .success()
            .stdout(contains("left out square: no pose"));
        assert_eq!(files(), if format == "e57" { 1 } else { 2 });
        std::fs::remove_dir_all(&out).unwrap();
    }
}
