//! `scanweave benchmark`, `evaluate --dataset` and `diagnose` on a tiny synthetic data set.

mod cli_common;

use cli_common::*;
use predicates::prelude::*;
use predicates::str::contains;
use std::path::{Path, PathBuf};

const SUITE: &str = r#"
name = "tiny"
keypoints = [300, 150]
computed_keypoints = 300
seeds = [0, 1]

[[datasets]]
name = "made"
synthetic = { scans = 4, rooms = 1, width = 120, height = 90, frames_per_scan = 3, voxel_m = 0.03 }
synthetic_seeds = [3, 4]
benchmarks = [
    { name = "hi", protocol = "3dmatch" },
    { name = "all", protocol = "scannet" },
]

[[methods]]
name = "paper"
preset = "paper"
set = ["registration.estimator.hypotheses=200"]

[[methods]]
name = "true, overlap"
similarity = "oracle"

[[quoted]]
source = "Somebody 1999"
method = "theirs"
benchmark = "hi"
scenes = 8
keypoints = [150]
recall_percent = [12.5]
"#;

/// Two scenes, two seeds, two methods, two counts.
const CELLS: usize = 16;

fn suite(place: &Path) -> PathBuf {
    let path = place.join("suite.toml");
    std::fs::write(&path, SUITE).unwrap();
    path
}

fn benchmark(place: &Path, output: &str, more: &[&str]) -> assert_cmd::assert::Assert {
    let mut command = scanweave();
    for name in ["SLURM_ARRAY_TASK_ID", "JOB_COMPLETION_INDEX"] {
        command.env_remove(name);
    }
    command
        .arg("benchmark")
        .arg("--suite")
        .arg(suite(place))
        .arg("-o")
        .arg(place.join(output))
        .args(more)
        .assert()
}

/// Everything in a table but what was timed: the last three columns.
fn figures(output: &Path) -> Vec<String> {
    let table = text(output.join("table.csv"));
    let line = |l: &str| l.rsplitn(4, ',').nth(3).unwrap_or_default().to_owned();
    table.lines().map(line).collect()
}

#[test]
fn a_suite_goes_on_where_it_stopped_and_parts_make_the_whole() {
    let place = folder();
    let whole = place.path().join("whole");
    benchmark(place.path(), "whole", &["--threads", "2"])
        .success()
        .stdout(contains(format!("computed {CELLS} cells, 0 were there")))
        .stdout(contains("*theirs: quoted, Somebody 1999*").and(contains("12.5")))
        .stdout(contains("Recall by scene: made").and(contains("Relative pose errors")));
    let cells = names(&whole.join("cells"));
    assert_eq!(cells.len(), CELLS);
    for file in [
        "cost.svg",
        "errors_150.svg",
        "recall_by_keypoints.svg",
        "recall_by_overlap_300.svg",
        "reliability_300.svg",
    ] {
        assert!(text(whole.join(file)).contains("<circle") || file.starts_with("errors"), "{file}");
    }
    let page = text(whole.join("report.html"));
    let plots = names(&whole).iter().filter(|n| n.ends_with(".svg")).count();
    assert_eq!(page.matches("<svg").count(), plots);
    assert!(page.contains("All 16 cells are computed.") && !page.contains("Cells that are not there"));
    // One row in the table of recalls is quoted, and is called so.
    assert_eq!(page.matches("<tr class=\"quoted\">").count(), 1);
    assert!(page.contains("theirs: quoted, Somebody 1999"), "{page}");
    for part in ["Registration recall", "Recall by scene: made", "Relative pose errors", "true, overlap"] {
        assert!(page.contains(part), "{part}");
    }
    let expected = figures(&whole);
    // Recall and pooled for each method and count, within all components and in the largest, 14 error
    // figures for each, the quoted row.
    assert_eq!(expected.len(), 1 + 4 * 4 + 14 * 4 + 1);
    let figure = |name: &str| expected.iter().filter(|l| l.contains(&format!(",{name},"))).count();
    assert_eq!([figure("recall"), figure("recall in largest"), figure("pooled in largest")], [5, 4, 4]);
    let cell = json(whole.join("cells").join(&cells[0]));
    assert_eq!(cell["poses"]["scans"].as_array().unwrap().len(), 4);
    assert!(cell["timings"].as_array().unwrap().iter().any(|t| t["stage"] == "registration"));

    // Some cells are missing, one is damaged, one is of other settings.
    for cell in cells.iter().step_by(2) {
        std::fs::remove_file(whole.join("cells").join(cell)).unwrap();
    }
    std::fs::write(whole.join("cells").join(&cells[1]), "{\"format\": ").unwrap();
    let stale = whole.join("cells").join(&cells[3]);
    let mut old = json(&stale);
    old["hash"] = "0".into();
    std::fs::write(&stale, old.to_string()).unwrap();
    benchmark(place.path(), "whole", &["--jobs", "2", "--threads", "2"]).success().stdout(contains(format!(
        "computed {} cells, {} were there",
        CELLS / 2 + 2,
        CELLS / 2 - 2
    )));
    assert_eq!(figures(&whole), expected);

    // Killed outright again and again, wherever it happens to be, it goes on and ends the same.
    let killed = place.path().join("killed");
    let done = || if killed.join("cells").is_dir() { names(&killed.join("cells")).len() } else { 0 };
    for wanted in [1, 4, 9] {
        let mut run = std::process::Command::new(assert_cmd::cargo::cargo_bin("scanweave"))
            .args(["benchmark", "-q", "--threads", "2", "--suite"])
            .arg(suite(place.path()))
            .arg("-o")
            .arg(&killed)
            .spawn()
            .unwrap();
        while done() < wanted && run.try_wait().unwrap().is_none() {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        run.kill().unwrap();
        run.wait().unwrap();
        assert!(done() >= wanted, "{} cells when it was killed", done());
    }
    assert!(done() < CELLS, "killed too late to show anything");
    benchmark(place.path(), "killed", &["--threads", "2"]).success();
    assert_eq!(figures(&killed), expected);

    // In three parts, one of them named by a scheduler, the cells of different jobs in parallel.
    benchmark(place.path(), "a", &["-q", "--shard", "0/3"]).success().stdout("");
    benchmark(place.path(), "b", &["--shard", "1/3", "--jobs", "2"])
        .success()
        .stdout(contains("Not finished"));
    let mut scheduled = scanweave();
    scheduled
        .env("SLURM_ARRAY_TASK_ID", "3")
        .env("SLURM_ARRAY_TASK_MIN", "1")
        .env("SLURM_ARRAY_TASK_COUNT", "3");
    scheduled.args(["benchmark", "--suite"]).arg(suite(place.path())).arg("-o").arg(place.path().join("c"));
    scheduled.assert().success();
    let merge = |parts: &[&str]| {
        let mut command = scanweave();
        command.args(["benchmark", "merge", "-o"]).arg(place.path().join("merged"));
        command.args(parts.iter().map(|p| place.path().join(p))).assert()
    };
    merge(&["a", "b"]).success().stdout(contains("Not finished"));
    // 16 cells in three parts are 5, 5 and 6.
    let page = text(place.path().join("merged/report.html"));
    assert!(page.contains("Not finished: 10 of 16 cells") && page.contains("6 missing or out-of-date cells"));
    merge(&["a", "b", "c"]).success().stdout(contains(format!("{CELLS} of {CELLS} cells")));
    assert_eq!(figures(&place.path().join("merged")), expected);

    // Parts of different suites do not mix.
    let other = place.path().join("other");
    std::fs::create_dir_all(&other).unwrap();
    std::fs::write(other.join("suite.toml"), SUITE.replace("[0, 1]", "[0]")).unwrap();
    merge(&["a", "other"]).code(3).stderr(contains("another suite"));

    let cell = whole.join("cells").join(&cells[0]);
    let found = place.path().join("found");
    scanweave().arg("diagnose").arg(cell).arg("-o").arg(&found).assert().success().stdout(contains("# made"));
    assert_eq!(names(&found), ["diagnosis.md", "growth.svg", "pairs.csv", "scans.csv"]);
    assert_eq!(text(found.join("scans.csv")).lines().count(), 5);
}

#[test]
fn a_suite_that_cannot_run_says_what_is_wrong() {
    let place = folder();
    let output = place.path().join("out");
    let refused = |text: &str, code: i32, said: &[&str]| {
        let path = place.path().join("bad.toml");
        std::fs::write(&path, text).unwrap();
        let mut command = scanweave();
        command.args(["benchmark", "--suite"]).arg(&path).arg("-o").arg(&output);
        command.args(["--data-root"]).arg(place.path());
        let mut assert = command.assert().code(code);
        for word in said {
            assert = assert.stderr(contains(*word));
        }
    };
    refused("nmae = \"x\"", 4, &["bad.toml", "nmae", "`name`"]);
    refused("name = \"x\"", 4, &["datasets", "an empty list"]);
    refused(&SUITE.replace("preset = \"paper\"", "preset = \"papr\""), 4, &["methods: paper", "papr"]);
    let unknown = SUITE.replace("registration.estimator.hypotheses", "registration.estimator.hypothesis");
    refused(&unknown, 4, &["methods: paper", "hypotheses"]);
    refused(&SUITE.replace("[300, 150]", "[301]"), 4, &["keypoints", "301", "computed_keypoints"]);
    refused(&SUITE.replace("\"true, overlap\"", "\"paper\""), 4, &["methods", "`paper` twice"]);
    let folder = SUITE.replace("synthetic = {", "folder = \"nowhere\" #").replace("synthetic_seeds", "#");
    refused(&folder, 3, &["nowhere", "cannot read it"]);
    assert!(!output.join("table.md").exists());
}

/// A data set of two synthetic scenes in the published layout: scenes/<name>/PointCloud, gt.log beside it.
fn dataset(place: &Path) -> PathBuf {
    let root = place.join("scenes");
    for (scene, seed) in [("one", "5"), ("two", "6")] {
        let synth = ["synth", "-q", "--noise", "0.3", "--scans", "4", "--rooms", "1", "--seed", seed, "-o"];
        scanweave().args(synth).arg(root.join(scene)).assert().success();
    }
    root
}

/// The true poses of a scene as a trajectory, the last scan moved.
fn trajectory(scene: &Path, file: &Path, moved: bool) {
    use scanweave::geometry::RigidMotion;
    use scanweave::scan::ScanId;
    let poses: Vec<(ScanId, RigidMotion)> = (0..4)
        .map(|i| {
            let info = scene.join(format!("PointCloud/cloud_bin_{i}.info.txt"));
            let away = RigidMotion::translation(if moved && i == 3 { 5.0 } else { 0.0 }, 0.0, 0.0);
            (ScanId(i), away * scanweave::io::read_matrix(info).unwrap().value)
        })
        .collect();
    scanweave::io::write_log_trajectory(file, &poses).unwrap();
}

#[test]
fn a_data_set_is_evaluated_scene_by_scene() {
    let place = folder();
    let root = dataset(place.path());
    let results = place.path().join("results");
    std::fs::create_dir_all(results.join("one")).unwrap();
    trajectory(&root.join("one"), &results.join("one/trajectory.log"), false);
    trajectory(&root.join("two"), &results.join("two.log"), true);
    let evaluate = |more: &[&str]| {
        let mut command = scanweave();
        command.arg("evaluate").arg(&results).arg("--dataset").arg(&root).args(more).assert()
    };
    let output = evaluate(&["--protocol", "3dmatch", "--protocol", "scannet", "--json"]).success();
    let report: serde_json::Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
    let (one, two) = (&report["scenes"][0], &report["scenes"][1]);
    assert_eq!((&one["scene"], &two["scene"]), (&"one".into(), &"two".into()));
    // A trajectory is one component.
    for scene in [one, two] {
        let recall = &scene["recalls"]["3dmatch"];
        assert_eq!(recall["succeeded_in_largest"], recall["succeeded"]);
    }
    // The counted pairs are those of gt.log whose numbers differ by more than one.
    let log = scanweave::io::read_log(root.join("two/gt.log")).unwrap().value;
    let counted = log.iter().filter(|e| e.i.abs_diff(e.j) > 1).count();
    let wrong = log.iter().filter(|e| e.i.abs_diff(e.j) > 1 && (e.i == 3 || e.j == 3)).count();
    assert!(wrong > 0, "the moved scan is in no counted pair");
    assert_eq!(one["recalls"]["3dmatch"]["succeeded"], one["recalls"]["3dmatch"]["counted"]);
    assert_eq!(two["recalls"]["3dmatch"]["counted"], counted);
    assert_eq!(two["recalls"]["3dmatch"]["succeeded"], counted - wrong);
    let mean = report["recalls"]["3dmatch"]["mean_of_scenes"].as_f64().unwrap();
    assert!((mean - 0.5 * (1.0 + (counted - wrong) as f64 / counted as f64)).abs() < 1e-12);
    // Of the six pairs of scene two, three are with the moved scan: half are off by 5 m.
    let cdf = report["errors"]["translation_cdf"].as_array().unwrap();
    assert!(cdf.iter().all(|v| (v.as_f64().unwrap() - 0.75).abs() < 1e-9), "{cdf:?}");
    evaluate(&["--scene", "one"])
        .success()
        .stdout(contains("100.0 %").and(contains("pooled")).and(contains("two").not()));

    // The page says the same, and that a trajectory does not tell what went wrong first.
    let page = place.path().join("page.html");
    let page_name = page.to_str().unwrap();
    evaluate(&["--report", page_name]).success().stdout(contains("written").and(contains("page.html")));
    let shown = text(&page);
    let recall = format!("Registration recall {:.1} % on 3dmatch; 8 of 8 scans placed.", 100.0 * mean);
    assert!(shown.contains(&recall), "{recall}");
    assert!(shown.contains("does not tell how the model grew") && shown.contains("Errors of the poses"));
    // Counted pairs of scene two with the moved scan, each a row.
    assert_eq!(shown.matches("<th scope=\"row\" class=\"text\">3dmatch</th>").count(), wrong);
    evaluate(&["--overlap-radius", "0.1"]).code(2).stderr(contains("--report"));

    // A scan without a pose is declined and listed.
    let lines = text(results.join("one/trajectory.log"));
    let shorter: Vec<&str> = lines.lines().take(15).collect();
    std::fs::write(results.join("one/trajectory.log"), shorter.join("\n")).unwrap();
    evaluate(&["--scene", "one"]).success().stdout(contains("declined  one cloud_bin_3: no pose"));
}

#[test]
fn bad_data_sets_are_one_clear_error() {
    let place = folder();
    let root = dataset(place.path());
    let results = place.path().join("results");
    std::fs::create_dir_all(&results).unwrap();
    trajectory(&root.join("one"), &results.join("one.log"), false);
    let evaluate = |more: &[&str]| {
        let mut command = scanweave();
        command.arg("evaluate").arg(&results).arg("--dataset").arg(&root).args(more).assert()
    };
    evaluate(&[])
        .code(3)
        .stderr(contains("two").and(contains("no estimated poses")).and(contains("--scene")));
    evaluate(&["--scene", "three"]).code(3).stderr(contains("three").and(contains("no such folder")));

    // Rotations that are a little off are repaired, and that is said.
    let log = root.join("one/gt.log");
    let published = text(&log);
    let entries = scanweave::io::read_log(&log).unwrap().value;
    let mut rows: Vec<String> = published.lines().map(str::to_owned).collect();
    let first: Vec<f64> = rows[1].split_whitespace().map(|v| v.parse().unwrap()).collect();
    rows[1] = format!("{} {} {} {}", first[0] * 1.0005, first[1] * 1.0005, first[2] * 1.0005, first[3]);
    std::fs::write(&log, rows.join("\n")).unwrap();
    evaluate(&["--scene", "one"]).success().stdout(contains("from orthonormal, replaced"));
    rows[1] = format!("{} {} {} {}", first[0] * 1.5, first[1] * 1.5, first[2] * 1.5, first[3]);
    std::fs::write(&log, rows.join("\n")).unwrap();
    evaluate(&["--scene", "one"]).code(3).stderr(contains("gt.log").and(contains("rigid motion")));
    std::fs::write(&log, &published).unwrap();

    // A pair whose scan is missing; then one scan alone.
    let clouds = root.join("one/PointCloud");
    let remove = |i: usize| {
        std::fs::remove_file(clouds.join(format!("cloud_bin_{i}.ply"))).unwrap();
        std::fs::remove_file(clouds.join(format!("cloud_bin_{i}.info.txt"))).unwrap();
    };
    assert!(entries.iter().any(|e| e.i == 3 || e.j == 3));
    remove(3);
    evaluate(&["--scene", "one"]).code(3).stderr(contains("gt.log").and(contains("there is no scan 3")));
    (0..2).for_each(remove);
    evaluate(&["--scene", "one"]).code(3).stderr(contains("one scan").and(contains("at least two")));

    // An empty folder of benchmarks.
    let empty = place.path().join("empty");
    std::fs::create_dir_all(&empty).unwrap();
    let empty = empty.to_str().unwrap();
    evaluate(&["--scene", "two", "--benchmark", empty])
        .code(3)
        .stderr(contains("no gt.log").and(contains("empty")));
    evaluate(&["--protocol", "kitti"]).code(2).stderr(contains("scannet"));
}

#[test]
fn the_page_of_a_result_names_the_scan_that_went_wrong_first() {
    let place = folder();
    let root = dataset(place.path());
    let (scene, results) = (root.join("one"), place.path().join("results"));
    let result = results.join("one");
    let register = ["register", "-q", "--threads", "1"];
    scanweave().args(register).arg(scene.join("PointCloud")).arg("-o").arg(&result).assert().success();
    // A scan that no other joined to is moved by 5 m.
    let mut poses = json(result.join("poses.json"));
    let parents: Vec<Option<u64>> =
        poses["scans"].as_array().unwrap().iter().map(|s| s["parent"].as_u64()).collect();
    let moved = (0..4).find(|&i| parents[i].is_some() && !parents.contains(&Some(i as u64))).unwrap();
    let name = format!("cloud_bin_{moved}");
    let x = poses["scans"][moved]["world_from_scan"][0][3].as_f64().unwrap();
    poses["scans"][moved]["world_from_scan"][0][3] = (x + 5.0).into();
    std::fs::write(result.join("poses.json"), poses.to_string()).unwrap();

    let (one, set) = (place.path().join("one.html"), place.path().join("set.html"));
    let mut command = scanweave();
    command.arg("evaluate").arg(&result).arg("--truth").arg(scene.join("PointCloud"));
    command.arg("--benchmark").arg(&scene).arg("--report").arg(&one).assert().success();
    let mut command = scanweave();
    command.arg("evaluate").arg(&results).arg("--dataset").arg(&root).args(["--scene", "one", "--report"]);
    command.arg(&set).assert().success();
    for page in [one, set].map(text) {
        assert!(page.contains("4 of 4 scans placed"), "{page}");
        // It joined rightly (evidence.parent_from_scan is as it was) and is off in the end; the other
        // three are right.
        let row = page
            .split("<th scope=\"row\" class=\"text\">")
            .find(|r| r.starts_with(&format!("{name}</th><td class=\"text\">placed")));
        assert!(row.unwrap().contains("<td class=\"text\">moved by refinement</td>"), "{row:?}");
        assert_eq!(page.matches("<td class=\"text\">right</td>").count(), 3);
        assert!(page.contains("failed pair") && page.contains("joined to"), "{page}");
    }

    judged(&result, &scene.join("PointCloud"), moved);

    // Nothing is half-written.
    let nowhere = place.path().join("no/page.html");
    let mut command = scanweave();
    command.arg("evaluate").arg(&result).arg("--truth").arg(scene.join("PointCloud"));
    command.arg("--report").arg(nowhere).assert().code(5);
}

/// What `evaluate` says of four scans of which `moved` is 5 m off and the others are right.
fn judged(result: &Path, truth: &Path, moved: usize) {
    let evaluate = |more: &[&str]| {
        let mut command = scanweave();
        command.arg("evaluate").arg(result).arg("--truth").arg(truth).args(more).assert()
    };
    let report = |more: &[&str]| -> serde_json::Value {
        let output = evaluate(&[more, &["--json"]].concat()).success();
        serde_json::from_slice(&output.get_output().stdout).unwrap()
    };
    // Half of the six pairs are with the moved scan.
    evaluate(&[])
        .success()
        .stdout(contains("at the source scan's centre").and(contains("(three inlier radii) and 5°")))
        .stdout(contains("pairs right     3 of 6 (50.0 %), 3 wrong within components"))
        .stdout(
            contains("wrongly placed  1 of 4 placed").and(contains("over 2 scans (expected 0.89 and 1)")),
        );
    let all = &report(&[])["judgement"];
    assert_eq!(all["wrongly_placed"].as_array().unwrap().len(), 1);
    assert_eq!(all["wrongly_placed"][0]["scan"], moved);
    assert_eq!(all["stated_error"]["scans"].as_array().unwrap().len(), 2);
    let radius_m = json(result.join("report.json"))["scale"]["inlier_radius_m"].as_f64().unwrap();
    assert!((all["limits"]["max_translation_m"].as_f64().unwrap() - 3.0 * radius_m).abs() < 1e-12);
    // Limits that every pair, and that no pair, keeps.
    let right = |more: &[&str]| report(more)["judgement"]["right_pairs"].as_u64().unwrap();
    assert_eq!(right(&["--max-translation", "100", "--max-rotation", "180"]), 6);
    assert_eq!(right(&["--max-translation", "1e-9"]), 0);
    assert_eq!(report(&["--within", "1e-6"])["judgement"]["judged_pairs"], 0);
    assert_eq!(report(&["--within", "1000"])["judgement"]["judged_pairs"], 6);
    evaluate(&["--within", "0"]).code(4).stderr(contains("--within").and(contains("positive")));

    // A declined scan's pairs count, and its centre is read from its file.
    let file = result.join("poses.json");
    let before = std::fs::read(&file).unwrap();
    let mut poses = json(file.clone());
    let declined = serde_json::json!({"reason": "too-few-keypoints", "keypoints": 1, "needed": 3});
    let entry = poses["scans"][moved].as_object_mut().unwrap();
    entry.retain(|key, _| ["id", "name", "file"].contains(&key.as_str()));
    entry.extend([
        ("outcome".to_owned(), "declined".into()),
        ("decline".to_owned(), declined),
        ("explanation".to_owned(), "lost".into()),
    ]);
    // Nothing names it as placed any more.
    poses["components"][0]["scans"].as_array_mut().unwrap().retain(|s| s != moved);
    for entry in poses["scans"].as_array_mut().unwrap() {
        if let Some(neighbours) = entry.get_mut("neighbours").and_then(serde_json::Value::as_array_mut) {
            neighbours.retain(|n| n["scan"] != moved);
        }
    }
    std::fs::write(&file, poses.to_string()).unwrap();
    let r = &report(&["--within", "1000"])["judgement"];
    assert_eq!((&r["judged_pairs"], &r["right_pairs"], &r["wrong_pairs"]), (&6.into(), &3.into(), &0.into()));

    // A file of an earlier version states no centre.
    let scans = poses["scans"].as_array_mut().unwrap().iter_mut();
    for uncertainty in scans.filter_map(|s| s.get_mut("pose_uncertainty")?.as_object_mut()) {
        uncertainty.remove("centre").unwrap();
    }
    std::fs::write(&file, poses.to_string()).unwrap();
    evaluate(&[])
        .success()
        .stdout(contains("at the zero of the source scan's file").and(contains("pairs right     3 of 6")))
        .stdout(contains("not compared: no scan that is not wrongly placed states its centre"));
    std::fs::write(&file, before).unwrap();

    // Without report.json a limit has to be named.
    let (run, away) = (result.join("report.json"), result.join("away.json"));
    std::fs::rename(&run, &away).unwrap();
    evaluate(&[]).success().stdout(contains("not judged").and(contains("--max-translation")));
    evaluate(&["--max-translation", "0.5"]).success().stdout(contains("limits          0.500 m and 5°"));
    std::fs::rename(away, run).unwrap();
}
