//! Layouts of data sets, and estimates for them, as files.

use super::super::dataset::{SetReport, evaluate_scene};
use super::super::estimate::SceneEstimate;
use super::*;
use crate::io::{InfoEntry, LogEntry, write_info, write_kitti, write_log, write_tum};
use crate::scan::ScanId;
use nalgebra::{Matrix6, Vector3};
use std::fs;

fn pose(k: usize) -> RigidMotion {
    let f = k as f64;
    RigidMotion::new(Vector3::new(f, -0.5 * f, 0.2 * f), Vector3::new(0.1 * f, 0.0, 0.3 * f))
}

/// Scan files of these numbers (their content is not looked at), and gt.log of these pairs in `truth`.
fn scene(folder: &Path, numbers: &[usize], truth: &Path, pairs: &[(usize, usize)]) {
    let clouds = folder.join("PointCloud");
    fs::create_dir_all(&clouds).unwrap();
    fs::create_dir_all(truth).unwrap();
    for n in numbers {
        fs::write(clouds.join(format!("cloud_bin_{n}.ply")), "").unwrap();
    }
    let n = numbers.iter().max().unwrap() + 1;
    let log = pairs.iter().map(|&(i, j)| LogEntry { i, j, n, pose: pose(i).inverse() * pose(j) });
    write_log(truth.join("gt.log"), &log.collect::<Vec<_>>()).unwrap();
    let information = Matrix6::identity() * 100.0;
    let info = pairs.iter().map(|&(i, j)| InfoEntry { i, j, n, information });
    write_info(truth.join("gt.info"), &info.collect::<Vec<_>>()).unwrap();
}

fn benchmark(protocol: Protocol, folder: Option<PathBuf>) -> Benchmark {
    Benchmark { name: protocol.name().to_owned(), protocol, folder }
}

#[test]
fn pairs_lie_apart_or_beside_the_scans_and_chain_into_poses() {
    let place = tempfile::tempdir().unwrap();
    let root = place.path();
    // Numbers with gaps, so that a number is not a place; three layouts of gt.log.
    let pairs = [(2, 5), (5, 9), (2, 30)];
    scene(&root.join("a"), &[2, 5, 9, 30], &root.join("pairs/a"), &pairs);
    scene(&root.join("b"), &[2, 5, 9, 30], &root.join("b"), &pairs);
    scene(&root.join("c"), &[2, 5, 9, 30], &root.join("c/PointCloud"), &pairs);
    let places = [Some(root.join("pairs")), None, None];
    for (name, folder) in ["a", "b", "c"].into_iter().zip(places) {
        let truth = SceneTruth::read(&root.join(name), &[benchmark(Protocol::Eth, folder)]).unwrap();
        assert_eq!(truth.numbers, [2, 5, 9, 30]);
        assert_eq!(truth.pairs[0].pairs.len(), 3);
        let poses = truth.world_from_scan.unwrap();
        for (place, number) in [2, 5, 9, 30].into_iter().enumerate() {
            let expected = pose(2).inverse() * pose(number);
            assert!((poses[place].to_homogeneous() - expected.to_homogeneous()).norm() < 1e-9);
        }
    }
    let found = find_scenes(root, &[]).unwrap();
    let names: Vec<_> = found.iter().map(|p| p.file_name().unwrap().to_str().unwrap()).collect();
    assert_eq!(names, ["a", "b", "c"]);
    assert_eq!(find_scenes(&root.join("a"), &[]).unwrap(), [root.join("a")]);
    let e = find_scenes(&root.join("pairs"), &[]).unwrap_err().to_string();
    assert!(e.contains("no scene"), "{e}");
    // Scans that no pair reaches have no poses, which only one protocol needs.
    scene(&root.join("d"), &[1, 2, 3], &root.join("d"), &[(1, 3)]);
    let read = |protocols: &[Protocol]| {
        let all: Vec<Benchmark> = protocols.iter().map(|&p| benchmark(p, None)).collect();
        SceneTruth::read(&root.join("d"), &all)
    };
    assert_eq!(read(&[Protocol::ThreeDMatch]).unwrap().world_from_scan, None);
    let e = read(&[Protocol::ThreeDMatch, Protocol::Scannet]).unwrap_err().to_string();
    assert!(e.contains("without true poses"), "{e}");
}

#[test]
fn every_kind_of_trajectory_gives_the_same_figures() {
    let place = tempfile::tempdir().unwrap();
    let (root, results) = (place.path(), place.path().join("results"));
    let numbers = [4, 6, 8, 11];
    scene(&root.join("s"), &numbers, &root.join("s"), &[(4, 6), (4, 8), (6, 11), (8, 11)]);
    let truth = SceneTruth::read(&root.join("s"), &[benchmark(Protocol::ThreeDMatch, None)]).unwrap();
    let frame = RigidMotion::new(Vector3::new(3.0, 1.0, -2.0), Vector3::new(0.4, 1.0, 0.2));
    // Scan 11 is a metre off.
    let off = |n: usize| RigidMotion::translation(if n == 11 { 1.0 } else { 0.0 }, 0.0, 0.0);
    let poses: Vec<RigidMotion> = numbers.iter().map(|&n| frame * pose(n) * off(n)).collect();
    let named: Vec<(ScanId, RigidMotion)> = numbers.iter().map(|&n| ScanId(n)).zip(poses.clone()).collect();
    fs::create_dir_all(&results).unwrap();
    for kind in ["log", "txt", "tum"] {
        let file = results.join(format!("s.{kind}"));
        match kind {
            "log" => crate::io::write_log_trajectory(&file, &named).unwrap(),
            "txt" => write_kitti(&file, &poses).unwrap(),
            _ => write_tum(&file, &named).unwrap(),
        }
        let report = evaluate_scene(&truth, &SceneEstimate::read(&results, &truth).unwrap(), false).unwrap();
        let recall = &report.recalls["3dmatch"];
        // All four pairs are of numbers more than one apart; two have scan 11.
        assert_eq!((recall.counted, recall.succeeded), (4, 2), "{kind}");
        assert!((recall.pairs[3].rmse_m.unwrap() - 1.0).abs() < 1e-9);
        assert_eq!(report.pairs.len(), 6);
        let wrong = report.pairs.iter().filter(|p| p.error.unwrap().translation_m > 0.5);
        assert!(wrong.map(|p| p.j.0).eq([11, 11, 11]), "{kind}");
        fs::remove_file(file).unwrap();
    }
    let quirky = {
        crate::io::write_log_trajectory(results.join("s.log"), &named[1..]).unwrap();
        let estimate = SceneEstimate::read(&results, &truth).unwrap();
        let report = evaluate_scene(&truth, &estimate, true).unwrap();
        assert_eq!(report.declined.len(), 1);
        assert_eq!((report.scans, report.placed, report.declined[0].scan.as_str()), (4, 3, "cloud_bin_4"));
        // 4 6 is dropped; 4 8 has a declined scan, and two are wrong.
        assert_eq!((report.recalls["3dmatch"].counted, report.recalls["3dmatch"].succeeded), (3, 0));
        report
    };
    let set = SetReport::new(vec![quirky.clone(), quirky]);
    assert_eq!(set.errors.unwrap().missing, 6);
    assert_eq!(set.recalls["3dmatch"].pooled, Some(0.0));

    let refused = |text: &str| {
        fs::write(results.join("s.log"), text).unwrap();
        SceneEstimate::read(&results, &truth).unwrap_err().to_string()
    };
    let e = refused("5 5 6\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
    assert!(e.contains("a pose of scan 5") && e.contains("4 scans of s"), "{e}");
    fs::remove_file(results.join("s.log")).unwrap();
    write_kitti(results.join("s.txt"), &poses[1..]).unwrap();
    let e = SceneEstimate::read(&results, &truth).unwrap_err().to_string();
    assert!(e.contains("3 poses") && e.contains("4, one for each"), "{e}");
}

#[test]
fn scans_that_cannot_be_told_apart_by_number_are_refused_where_pairs_name_them() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path();
    for name in ["a_1.ply", "b_1.ply", "c_2.ply"] {
        fs::write(folder.join(name), "").unwrap();
    }
    fs::write(folder.join("gt.log"), "1 2 3\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n").unwrap();
    let e = SceneTruth::read(folder, &[benchmark(Protocol::ThreeDMatch, None)]).unwrap_err().to_string();
    assert!(e.contains("2 different numbers") && e.contains("cloud_bin_12.ply"), "{e}");
    assert_eq!(SceneTruth::read(folder, &[]).unwrap().numbers, [0, 1, 2]);
}
