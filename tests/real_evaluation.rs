//! Whole data sets against published files and an independent evaluator's numbers.
//!
//! Reads the data folder from `SCANWEAVE_DATA`; does nothing where that is unset.

mod real_common;

use real_common::data;
use scanweave::evaluation::Protocol;
use scanweave::evaluation::SceneEstimate;
use scanweave::evaluation::{Benchmark, SceneTruth, find_scenes};
use scanweave::evaluation::{SetReport, evaluate_scene};
use scanweave::geometry::RigidMotion;
use scanweave::geometry::motion_from_matrix;
use std::path::Path;

const NAMES: [(&str, Protocol); 2] =
    [("3DMatch", Protocol::ThreeDMatch), ("3DLoMatch", Protocol::ThreeDLoMatch)];

fn scenes(data: &Path) -> Vec<SceneTruth> {
    let benchmarks = NAMES.map(|(name, protocol)| Benchmark {
        name: name.to_owned(),
        protocol,
        folder: Some(data.join("benchmarks").join(name)),
    });
    let folders = find_scenes(&data.join("3dmatch"), &[]).unwrap();
    folders.iter().map(|f| SceneTruth::read(f, &benchmarks).unwrap()).collect()
}

fn estimate(poses: Vec<RigidMotion>) -> SceneEstimate {
    SceneEstimate {
        reasons: vec![None; poses.len()],
        poses: poses.into_iter().map(|p| Some((0, p))).collect(),
    }
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn the_independent_evaluators_counts_come_out_of_the_data_set() {
    let data = data();
    let path = data.join("../reference/recall_perturbed.json");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let scenes = scenes(&data);
    for reference in json["scenes"].as_array().unwrap() {
        let name = reference["scene"].as_str().unwrap();
        let truth = scenes.iter().find(|s| s.name == name).unwrap();
        let pose = |rows: &serde_json::Value| {
            let at = |r: usize, c: usize| rows[r][c].as_f64().unwrap();
            motion_from_matrix(&nalgebra::Matrix4::from_fn(at), 1e-2).unwrap().0
        };
        // Poses of the reference are by the scans' numbers.
        let by_number: Vec<RigidMotion> =
            reference["world_from_scan"].as_array().unwrap().iter().map(pose).collect();
        let poses = truth.numbers.iter().map(|&n| by_number[n]).collect();
        let report = evaluate_scene(truth, &estimate(poses), false).unwrap();
        for (benchmark, _) in NAMES {
            let (found, expected) = (&report.recalls[benchmark], &reference[benchmark]);
            assert_eq!(
                found.counted as u64,
                expected["counted_pairs"].as_u64().unwrap(),
                "{name} {benchmark}"
            );
            assert_eq!(found.succeeded as u64, expected["successes"].as_u64().unwrap(), "{name} {benchmark}");
            for (pair, want) in found.pairs.iter().zip(expected["rmse_m_first_20_pairs"].as_array().unwrap())
            {
                assert!((pair.rmse_m.unwrap() - want[2].as_f64().unwrap()).abs() < 1e-6, "{name} {pair:?}");
            }
        }
    }
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn truth_against_itself_is_perfect_and_a_destroyed_scan_fails_its_own_pairs() {
    let data = data();
    let (mut perfect, mut broken) = (Vec::new(), Vec::new());
    for truth in scenes(&data) {
        let poses = truth.world_from_scan.clone().unwrap();
        perfect.push(evaluate_scene(&truth, &estimate(poses.clone()), false).unwrap());
        let mut destroyed = poses;
        let lost = destroyed.len() / 2;
        destroyed[lost] = RigidMotion::translation(30.0, -20.0, 50.0);
        let report = evaluate_scene(&truth, &estimate(destroyed), false).unwrap();
        for (benchmark, _) in NAMES {
            let recall = &report.recalls[benchmark];
            let number = truth.numbers[lost];
            let its_own = recall.pairs.iter().filter(|p| p.i.0 == number || p.j.0 == number);
            let own: usize = its_own.clone().filter(|p| !p.zero_information).count();
            assert_eq!(recall.succeeded, recall.counted - own, "{} {benchmark}", truth.name);
            assert!(its_own.filter(|p| !p.zero_information).all(|p| !p.success));
        }
        // n − 1 of n (n − 1) / 2 pairs.
        let n = truth.scans.len();
        let cdf = report.errors.as_ref().unwrap().translation_cdf;
        assert!(cdf.iter().all(|c| (c - (1.0 - 2.0 / n as f64)).abs() < 1e-9), "{cdf:?}");
        broken.push(report);
    }
    let perfect = SetReport::new(perfect);
    for (benchmark, _) in NAMES {
        let summary = &perfect.recalls[benchmark];
        assert_eq!((summary.mean_of_scenes, summary.pooled), (Some(1.0), Some(1.0)));
        assert!(summary.scenes >= 5);
    }
    let errors = perfect.errors.unwrap();
    assert_eq!((errors.missing, errors.rotation_cdf, errors.translation_cdf), (0, [1.0; 5], [1.0; 5]));
    // The kitchen's published rotations are orthonormal to 6e-4 only.
    let deviation = perfect.scenes.iter().map(|s| s.truth_deviation).fold(0.0, f64::max);
    assert!((1e-4..2e-3).contains(&deviation), "{deviation}");
    assert!(SetReport::new(broken).recalls["3DMatch"].mean_of_scenes.unwrap() < 1.0);
}
