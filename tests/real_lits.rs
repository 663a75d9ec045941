//! The learned synchronisation against an independent recomputation. Needs `SCANWEAVE_DATA`,
//! with `../weights/lits` beside it.
//!
//! The expected poses were computed by scripts/lits_reference.py (numpy, double precision, its
//! own reader of the weights) on a graph of six scans, two of whose twelve edges are wrong.

mod real_common;

use nalgebra::Matrix4;
use real_common::beside_data;
use scanweave::Silent;
use scanweave::geometry::RigidMotion;
use scanweave::geometry::{motion_from_matrix, rotation_error_rad, translation_error_m};
use scanweave::scan::{DeclineReason, PairRegistration, PoseEdge, PoseGraph, ScanId};
use scanweave::synchronization::{LitsWeights, Method, synchronize};
use scanweave::weight_import::lits;
use serde::Deserialize;

#[derive(Deserialize)]
struct Reference {
    edges: Vec<Edge>,
    first_from_scan: Vec<[[f64; 4]; 4]>,
}

#[derive(Deserialize)]
struct Edge {
    i: usize,
    j: usize,
    i_from_j: [[f64; 4]; 4],
}

fn motion(rows: &[[f64; 4]; 4]) -> RigidMotion {
    motion_from_matrix(&Matrix4::from_fn(|r, c| rows[r][c]), 1e-6).unwrap().0
}

fn graph(reference: &Reference) -> PoseGraph {
    let edge = |e: &Edge| {
        let pair =
            PairRegistration { target_from_source: motion(&e.i_from_j), inliers: 10, ..Default::default() };
        PoseEdge { i: ScanId(e.i), j: ScanId(e.j), pair, similarity: 1.0 }
    };
    let reason = DeclineReason::TooFewInliers { inliers: 0, needed: 3, matches: 0 };
    PoseGraph {
        scans: 6,
        inlier_radius_m: 0.07,
        edges: reference.edges.iter().map(edge).collect(),
        without_edges: vec![reason; 6],
        registered_pairs: reference.edges.len(),
        registration_seconds: 0.0,
        reused_seconds: 0.0,
    }
}

fn assert_agrees(name: &str, reference: &str) {
    let path = beside_data("weights/lits").join(name);
    let weights = lits(&path).unwrap();
    // Through a file of our own, which must change nothing.
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("lits.safetensors");
    std::fs::write(&own, weights.to_bytes().unwrap()).unwrap();
    assert_eq!(LitsWeights::load(&own).unwrap(), weights);

    let reference: Reference = serde_json::from_str(reference).unwrap();
    let found = synchronize(&graph(&reference), Method::Lits, Some(&weights), &Silent).unwrap();
    for (scan, expected) in reference.first_from_scan.iter().enumerate() {
        let expected = motion(expected);
        let got = found.relative(ScanId(0), ScanId(scan)).unwrap();
        let (rad, m) = (rotation_error_rad(&got, &expected), translation_error_m(&got, &expected));
        assert!(rad < 1e-4 && m < 1e-4, "{name}, scan {scan}: {rad:.1e} rad, {m:.1e} m");
    }
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn poses_with_the_3dmatch_weights_agree_with_numpy() {
    assert_agrees("3dmatch.pth", include_str!("fixtures/lits_3dmatch.json"));
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn poses_with_the_scannet_weights_agree_with_numpy() {
    assert_agrees("scannet.pth", include_str!("fixtures/lits_scannet.json"));
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn other_files_are_refused_and_missing_weights_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights");
    std::fs::write(&path, b"not weights").unwrap();
    for error in [lits(&path).unwrap_err(), LitsWeights::load(&path).unwrap_err()] {
        assert!(error.to_string().contains("weights: found"), "{error}");
    }
    let reference: Reference = serde_json::from_str(include_str!("fixtures/lits_3dmatch.json")).unwrap();
    let error = synchronize(&graph(&reference), Method::Lits, None, &Silent).unwrap_err();
    assert!(error.to_string().contains("synchronization.lits_weights"), "{error}");
}
