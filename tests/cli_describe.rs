//! Local features at the prompt.

mod cli_common;

use cli_common::{corner, folder, names, scanweave, write_ply};
use ndarray::Array2;
use ndarray_npy::NpzReader;
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use scanweave::descriptor::mini_spin_net::{Architecture, Checkpoint, Meta, Weights};

use std::fs::File;
use std::path::{Path, PathBuf};

/// A small network with random weights.
fn network(path: &Path, seed: u64) -> PathBuf {
    let architecture = Architecture { point_channels: 16, channels: vec![16, 32], attention_channels: 16 };
    let meta = Meta {
        format_version: 1,
        descriptor: "mini-spin-net".into(),
        name: "random".into(),
        architecture: architecture.clone(),
        source: "a test".into(),
        licence: "none".into(),
        recipe: serde_json::Value::Null,
        metrics: Default::default(),
        steps: 0,
    };
    Checkpoint { meta, weights: Weights::initial(&architecture, seed) }.save(path).unwrap();
    path.to_path_buf()
}

/// `a.ply` and `b.ply`, a room's corner seen from two places, and `few.ply`: two points.
fn scans(place: &Path) -> PathBuf {
    let set = place.join("set");
    std::fs::create_dir_all(&set).unwrap();
    let points = corner();
    let moved: Vec<[f64; 3]> = points.iter().map(|[x, y, z]| [x - 0.2, y + 0.1, *z]).collect();
    write_ply(&set.join("a.ply"), &points);
    write_ply(&set.join("b.ply"), &moved);
    write_ply(&set.join("few.ply"), &[[0.0, 0.0, 1.0], [0.1, 0.0, 1.0]]);
    set
}

fn describe(set: &Path, output: &Path, more: &[&str]) -> assert_cmd::Command {
    let mut command = scanweave();
    command.arg("describe").arg(set).arg("-o").arg(output);
    command.args(["--set", "scale.voxel_m=0.05", "--set", "descriptor.keypoints.count=300"]).args(more);
    command
}

fn learned(weights: &Path) -> [String; 4] {
    let checkpoint = format!("descriptor.checkpoint={}", weights.display());
    ["--set".into(), "descriptor.kind=mini-spin-net".into(), "--set".into(), checkpoint]
}

fn array(path: &Path, name: &str) -> Array2<f32> {
    NpzReader::new(File::open(path).unwrap()).unwrap().by_name(name).unwrap()
}

#[test]
fn every_scan_gets_a_file_of_unit_descriptors_and_a_poor_one_is_named() {
    let place = folder();
    let (set, out) = (scans(place.path()), place.path().join("out"));
    let learned = learned(&network(&place.path().join("w.safetensors"), 1));
    let learned: Vec<&str> = learned.iter().map(String::as_str).collect();
    describe(&set, &out, &learned)
        .assert()
        .success()
        .stdout(contains("mini-spin-net of 3 scans").and(contains("few: no keypoint")));
    assert_eq!(names(&out), ["a.npz", "b.npz", "cache", "few.npz"]);
    let descriptors = array(&out.join("a.npz"), "descriptors");
    assert_eq!(descriptors.dim(), (300, 32));
    assert!(descriptors.outer_iter().all(|row| (row.dot(&row) - 1.0).abs() < 1e-5));
    assert_eq!(array(&out.join("few.npz"), "keypoints").dim(), (0, 3));

    // Not overwritten unasked; then from the cache, to the same bytes; not with other weights.
    describe(&set, &out, &learned).assert().code(5).stderr(contains("--force"));
    let first = std::fs::read(out.join("a.npz")).unwrap();
    let again: Vec<&str> = learned.iter().copied().chain(["--force", "--threads", "1"]).collect();
    describe(&set, &out, &again).assert().success().stdout(contains("3 not computed now"));
    assert_eq!(std::fs::read(out.join("a.npz")).unwrap(), first);
    network(&place.path().join("w.safetensors"), 2);
    describe(&set, &out, &again).assert().success().stdout(contains("0 not computed now"));
    assert_ne!(array(&out.join("a.npz"), "descriptors"), descriptors);
}

#[test]
fn learned_values_and_histograms_stand_side_by_side() {
    let place = folder();
    let set = scans(place.path());
    let learned = learned(&network(&place.path().join("w.safetensors"), 1));
    let of = |kind: &str, checkpoint: &[String]| {
        let out = place.path().join(kind).join(checkpoint.len().to_string());
        let kind = format!("descriptor.kind={kind}");
        let mut all = vec!["--set", kind.as_str()];
        all.extend(checkpoint.iter().map(String::as_str));
        describe(&set, &out, &all).assert().success();
        assert_eq!(array(&out.join("few.npz"), "keypoints").dim(), (0, 3));
        (array(&out.join("a.npz"), "keypoints"), array(&out.join("a.npz"), "descriptors"))
    };
    let (keypoints, both) = of("mini-spin-net-fpfh", &learned[2..]);
    let (of_network, network) = of("mini-spin-net", &learned[2..]);
    let (of_histograms, histograms) = of("fpfh", &[]);
    assert_eq!((&keypoints, &keypoints), (&of_network, &of_histograms));
    assert_eq!(both.dim(), (300, 65));
    // Of unit length together, the histograms 2.3 times as long.
    let unit = (1.0f32 + 2.3 * 2.3).sqrt();
    for (row, (l, h)) in both.outer_iter().zip(network.outer_iter().zip(histograms.outer_iter())) {
        let expected = l.iter().map(|v| v / unit).chain(h.iter().map(|v| 2.3 * v / unit));
        assert!(row.iter().zip(expected).all(|(x, y)| (x - y).abs() < 1e-6));
    }
    // Without a file of weights the built-in ones, as for a plain call.
    let (_, built_in) = of("mini-spin-net", &[]);
    assert_eq!(built_in.dim(), (300, 32));
    assert_ne!(built_in, network);
    let out = place.path().join("default");
    describe(&set, &out, &[]).assert().success().stdout(contains("mini-spin-net-fpfh of 3 scans"));
    let default = array(&out.join("a.npz"), "descriptors");
    for (row, l) in default.outer_iter().zip(built_in.outer_iter()) {
        assert!(row.iter().zip(l).all(|(x, y)| (x - y / unit).abs() < 1e-6));
    }
}

#[test]
fn described_features_register_as_computed_ones_do() {
    let place = folder();
    let (set, out) = (scans(place.path()), place.path().join("out"));
    std::fs::remove_file(set.join("few.ply")).unwrap();
    describe(&set, &out, &[]).assert().success().stdout(contains("mini-spin-net-fpfh of 2 scans"));
    let converted = place.path().join("converted");
    describe(&set, &converted, &["--features", out.to_str().unwrap()]).assert().success();
    // Reading makes descriptors unit length again, which may change a last bit.
    let (again, once) =
        (array(&converted.join("b.npz"), "descriptors"), array(&out.join("b.npz"), "descriptors"));
    assert_eq!(again.dim(), once.dim());
    assert!(again.iter().zip(&once).all(|(x, y)| (x - y).abs() < 1e-6));
    scanweave()
        .arg("register")
        .arg(&set)
        .arg("-o")
        .arg(place.path().join("result"))
        .args(["--set", "scale.voxel_m=0.05", "--features"])
        .arg(&converted)
        .assert()
        .success();
}

#[test]
fn unusable_weights_and_settings_are_one_clear_error() {
    let place = folder();
    let (set, out) = (scans(place.path()), place.path().join("out"));
    let missing = learned(&place.path().join("none.safetensors"));
    let missing: Vec<&str> = missing.iter().map(String::as_str).collect();
    describe(&set, &out, &missing).assert().code(3).stderr(contains("none.safetensors: cannot read it"));
    let text = place.path().join("text.safetensors");
    std::fs::write(&text, "not weights").unwrap();
    let text = learned(&text);
    let text: Vec<&str> = text.iter().map(String::as_str).collect();
    describe(&set, &out, &text).assert().code(3).stderr(contains("a MiniSpinNet checkpoint"));
    let unused = ["--set", "descriptor.kind=fpfh", "--set", "descriptor.checkpoint=w.safetensors"];
    describe(&set, &out, &unused).assert().code(4).stderr(contains("no weights"));
    let head = Path::new(env!("CARGO_MANIFEST_DIR")).join("checkpoints/netvlad-fpfh.safetensors");
    let head = learned(&head);
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    describe(&set, &out, &head).assert().code(3).stderr(contains("metadata of another kind"));
}
