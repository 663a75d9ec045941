//! Real scans through the command line, compared with their truth.
//!
//! Needs the folder of real scans in SCANWEAVE_DATA; without the variable nothing is tested.

mod real_common;

use assert_cmd::Command;
use real_common::data;
use serde_json::Value;
use std::path::{Path, PathBuf};

struct Outcome {
    /// What `evaluate --json` says.
    evaluation: Value,
    /// `report.json` of the registration.
    report: Value,
}

/// Registers `scans` without a flag and compares with `truth`.
fn register(scans: &Path, truth: &Path, benchmarks: &[PathBuf]) -> Outcome {
    let place = tempfile::tempdir().unwrap();
    let result = place.path().join("result");
    let scanweave = || Command::cargo_bin("scanweave").unwrap();
    scanweave().arg("register").arg(scans).arg("-o").arg(&result).arg("-q").assert().success();
    let mut evaluate = scanweave();
    evaluate.arg("evaluate").arg(&result).arg("--json").arg("--truth").arg(truth);
    for benchmark in benchmarks {
        evaluate.arg("--benchmark").arg(benchmark);
    }
    let output = evaluate.assert().success().get_output().stdout.clone();
    let report = std::fs::read(result.join("report.json")).unwrap();
    Outcome {
        evaluation: serde_json::from_slice(&output).unwrap(),
        report: serde_json::from_slice(&report).unwrap(),
    }
}

impl Outcome {
    fn placed(&self) -> u64 {
        self.evaluation["poses"]["placed"].as_u64().unwrap()
    }

    fn components(&self) -> u64 {
        self.evaluation["poses"]["components"].as_u64().unwrap()
    }

    /// Largest rotation (degrees) and translation (metres) error over all pairs.
    fn largest(&self) -> (f64, f64) {
        let s = &self.evaluation["poses"]["pair_summary"];
        (s["max_rotation_deg"].as_f64().unwrap(), s["max_translation_m"].as_f64().unwrap())
    }
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn six_kitchen_fragments_are_placed_within_ten_centimetres_and_three_degrees() {
    let data = data();
    let o = register(&data.join("kitchen_raw"), &data.join("3dmatch/7-scenes-redkitchen"), &[]);
    let (deg, m) = o.largest();
    println!("kitchen_raw: placed {}, largest error {deg:.2}°, {m:.3} m", o.placed());
    assert_eq!((o.placed(), o.components()), (6, 1));
    assert!(deg < 3.0 && m < 0.10);
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn the_bunny_needs_no_flag_though_it_is_a_hundred_times_smaller() {
    let data = data();
    let o = register(&data.join("bunny"), &data.join("bunny"), &[]);
    let (deg, m) = o.largest();
    println!("bunny: placed {}, largest error {deg:.2}°, {:.2} mm", o.placed(), 1000.0 * m);
    assert_eq!((o.placed(), o.components()), (10, 1));
    // One percent of the object and a degree.
    assert!(deg < 1.0 && m < 0.0025);
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn the_facade_needs_no_flag_though_it_is_ten_times_larger() {
    let data = data();
    let o = register(&data.join("facade"), &data.join("facade"), &[]);
    let (deg, m) = o.largest();
    println!("facade: placed {}, largest error {deg:.2}°, {m:.3} m", o.placed());
    assert_eq!((o.placed(), o.components()), (7, 1));
    // The truth is itself an estimate with a residual of 7 cm.
    assert!(deg < 1.5 && m < 0.5);
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn a_hotel_of_37_fragments_within_five_minutes_and_two_gigabytes() {
    let data = data();
    let scene = "sun3d-hotel_umd-maryland_hotel3";
    let benchmarks = ["3DMatch", "3DLoMatch"].map(|b| data.join("benchmarks").join(b).join(scene));
    let o = register(&data.join("3dmatch").join(scene), &data.join("3dmatch").join(scene), &benchmarks);
    let seconds: f64 =
        o.report["timings"].as_array().unwrap().iter().map(|t| t["seconds"].as_f64().unwrap()).sum();
    for (folder, r) in o.evaluation["benchmarks"].as_object().unwrap() {
        let (succeeded, counted) = (r["succeeded"].as_u64().unwrap(), r["counted"].as_u64().unwrap());
        println!("hotel3: {succeeded} of {counted} pairs, {folder}");
        // FPFH's published prototype reached 92 % and 73 % over all scenes.
        let least = if folder.contains("3DLoMatch") { 0.70 } else { 0.92 };
        assert!(succeeded as f64 >= least * counted as f64);
    }
    let peak_mib = o.report["peak_memory_bytes"].as_u64().map(|b| b >> 20);
    println!("hotel3: {seconds:.1} s, peak {peak_mib:?} MiB");
    // Half a minute on two cores with nothing else to do: other tests run beside this one, on any machine.
    assert!(seconds < 300.0);
    assert!(peak_mib.is_none_or(|m| m < 2048));
}

/// Sixteen fragments each of three places and an unrelated scan, shuffled: no model may contain two places.
/// (Not of hotel1 and hotel3 together: fragment 30 of the one fits into the other by 94 matches and 84 % of
/// its surface, so the two show the same room or rooms furnished alike.)
#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn a_shuffled_pile_of_three_places_and_a_stranger_falls_apart_into_them() {
    let data = data();
    let place = tempfile::tempdir().unwrap();
    let pile = place.path().join("pile");
    std::fs::create_dir(&pile).unwrap();
    let of = |scene: &'static str, numbers: std::ops::Range<usize>| numbers.map(move |k| (scene, k));
    let scans: Vec<(&str, usize)> = of("7-scenes-redkitchen", 0..16)
        .chain(of("sun3d-home_at-home_at_scan1_2013_jan_1", 0..16))
        .chain(of("sun3d-hotel_umd-maryland_hotel3", 0..16))
        .chain(of("sun3d-home_md-home_md_scan9_2012_sep_30", 30..31))
        .collect();
    let n = scans.len();
    let mut scene_of = vec![""; n];
    for (k, (scene, number)) in scans.iter().enumerate() {
        // 29 and 49 share no factor: every name once.
        let name = k * 29 % n;
        scene_of[name] = scene;
        let source = data.join("3dmatch").join(scene).join(format!("PointCloud/cloud_bin_{number}.ply"));
        std::fs::copy(source, pile.join(format!("{name:03}.ply"))).unwrap();
    }
    let result = place.path().join("result");
    let mut register = Command::cargo_bin("scanweave").unwrap();
    register.arg("register").arg(&pile).arg("-o").arg(&result);
    register.args(["-q", "--set", "descriptor.keypoints.count=1500"]).assert().success();
    let poses: Value = serde_json::from_slice(&std::fs::read(result.join("poses.json")).unwrap()).unwrap();
    let mut places: std::collections::BTreeMap<u64, std::collections::BTreeSet<&str>> = Default::default();
    let (mut placed, mut strangers) = (0, 0);
    for (scan, scene) in poses["scans"].as_array().unwrap().iter().zip(&scene_of) {
        let Some(component) = scan["component"].as_u64() else { continue };
        places.entry(component).or_default().insert(scene);
        placed += 1;
        strangers += usize::from(scene.contains("home_md"));
    }
    println!("pile: {placed} of {n} placed in {} models, {strangers} stranger among them", places.len());
    assert!(places.values().all(|p| p.len() == 1), "{places:?}");
    assert_eq!(strangers, 0);
    assert!(placed >= 44, "{placed}");
}
