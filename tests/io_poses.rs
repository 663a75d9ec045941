//! Poses, pairs, features and data set layouts.

use nalgebra::{Matrix6, Point3, Vector3};
use proptest::prelude::*;
use scanweave::geometry::RigidMotion;
use scanweave::geometry::{rotation_error_rad, translation_error_m};
use scanweave::io::ReadOptions;
use scanweave::io::read_cloud;
use scanweave::io::*;
use scanweave::io::{read_benchmark, read_scene};
use scanweave::io::{read_features, read_features_with, read_sghr_features, write_features};
use scanweave::scan::{Descriptors, Features, PointCloud, ScanId};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn save(dir: &TempDir, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = dir.path().join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(&path, bytes).unwrap();
    path
}

fn motions() -> impl Strategy<Value = Vec<RigidMotion>> {
    let one = prop::array::uniform6(-3.0f64..3.0).prop_map(|v| {
        RigidMotion::new(Vector3::new(v[0], v[1] * 100.0, v[2]), Vector3::new(v[3], v[4], v[5]))
    });
    prop::collection::vec(one, 1..8)
}

/// Close enough for a matrix written with all its digits: the repair by SVD costs a few ulps.
fn same(a: &RigidMotion, b: &RigidMotion) -> bool {
    // acos near 1 loses half of the digits, hence 1e-7 and not 1e-14.
    translation_error_m(a, b) < 1e-12 && rotation_error_rad(a, b) < 1e-7
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn every_pose_file_gives_back_what_was_written(poses in motions()) {
        let dir = folder();
        let path = dir.path().join("f");
        let named: Vec<(ScanId, RigidMotion)> = poses.iter().enumerate().map(|(i, p)| (ScanId(2 * i), *p)).collect();

        write_log_trajectory(&path, &named).unwrap();
        let log = read_log(&path).unwrap();
        prop_assert!(log.deviation < 1e-12);
        for ((id, pose), e) in named.iter().zip(&log.value) {
            prop_assert_eq!((e.i, e.j, e.n), (id.0, id.0, id.0 + 1));
            prop_assert!(same(pose, &e.pose));
        }
        write_kitti(&path, &poses).unwrap();
        let kitti = read_kitti(&path).unwrap().value;
        prop_assert_eq!(kitti.len(), poses.len());
        prop_assert!(poses.iter().zip(&kitti).all(|(a, b)| same(a, b)));
        prop_assert_eq!(fs::read_to_string(&path).unwrap().lines().next().unwrap().split(' ').count(), 12);

        write_tum(&path, &named).unwrap();
        let tum = read_tum(&path).unwrap().value;
        for ((id, pose), (stamp, back)) in named.iter().zip(&tum) {
            prop_assert_eq!(*stamp, id.0 as f64);
            prop_assert!(same(pose, back));
        }

        let info: Vec<InfoEntry> = poses.iter().enumerate().map(|(i, p)| InfoEntry {
            i, j: i + 1, n: 9, information: Matrix6::from_fn(|r, c| p.translation.x * (r * 6 + c) as f64),
        }).collect();
        write_info(&path, &info).unwrap();
        prop_assert_eq!(read_info(&path).unwrap(), info);
    }
}

const QUARTER: &str = "0 -1 0 1\n1 0 0 2\n0 0 1 3\n0 0 0 1\n";

/// A quarter turn about z, then a shift: (1,0,0) goes to (0,1,0) + (1,2,3).
fn check_quarter(pose: &RigidMotion) {
    let moved = pose * Point3::new(1.0, 0.0, 0.0);
    assert!((moved - Point3::new(1.0, 3.0, 3.0)).norm() < 1e-12, "{moved}");
}

#[test]
fn logs_with_tabs_spaces_and_crlf() {
    let dir = folder();
    let text =
        format!("0\t 1\t 60\t\r\n{}\n3 4 60\n{QUARTER}", QUARTER.replace(' ', " \t ").replace('\n', "\r\n"));
    let log = read_log(save(&dir, "gt.log", text)).unwrap().value;
    assert_eq!(log.iter().map(|e| (e.i, e.j, e.n)).collect::<Vec<_>>(), [(0, 1, 60), (3, 4, 60)]);
    log.iter().for_each(|e| check_quarter(&e.pose));
}

#[test]
fn single_matrices_with_and_without_header() {
    let dir = folder();
    for text in [
        QUARTER.to_owned(),
        format!("7-scenes-redkitchen\t seq-01\t 50\t 99\n{QUARTER}"),
        format!("0 1 2 3\n{QUARTER}"),
        QUARTER.replace('\n', "\r\n"),
        QUARTER.lines().take(3).collect::<Vec<_>>().join("\n"),
    ] {
        check_quarter(&read_matrix(save(&dir, "p.txt", &text)).unwrap().value);
    }
    let line = QUARTER.replace('\n', " ");
    for line in [line.as_str(), &line.replace("0 0 0 1 ", "")] {
        let poses = read_kitti(save(&dir, "poses.txt", format!("{line}\n\n{line}"))).unwrap().value;
        assert_eq!(poses.len(), 2);
        poses.iter().for_each(check_quarter);
    }
    // The same turn as a quaternion: (0, 0, sin 45°, cos 45°), and its inverse in a .conf.
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let tum = format!("# stamp tx ty tz qx qy qz qw\n1305031.5 1 2 3 0 0 {h} {h}\n");
    let tum = read_tum(save(&dir, "t.txt", tum)).unwrap().value;
    assert_eq!(tum[0].0, 1305031.5);
    check_quarter(&tum[0].1);
    let conf = format!("camera 0 0 0 0 0 0 1\nbmesh a.ply 1 2 3 0 0 {} {h}\n", -h);
    let conf = read_conf(save(&dir, "b.conf", conf)).unwrap().value;
    assert_eq!(conf[0].0, "a.ply");
    check_quarter(&conf[0].1);
}

#[test]
fn rounded_rotations_are_repaired_and_reported() {
    let dir = folder();
    let pose = read_matrix(save(&dir, "p.txt", "1.0003 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")).unwrap();
    // RᵀR − I at the first entry: 1.0003² − 1.
    assert!((pose.deviation - 6.0009e-4).abs() < 1e-12, "{}", pose.deviation);
    assert_eq!(pose.value.rotation.angle(), 0.0);
}

#[test]
fn damaged_pose_files_say_where() {
    let dir = folder();
    let log = |text: &str| read_log(save(&dir, "x.log", text)).unwrap_err().to_string();
    assert!(log(&format!("0 1\n{QUARTER}")).contains("line 1 '0 1'"));
    assert!(log(&format!("0 1 2\n{}", QUARTER.replace("1 0 0 2", "1 0 0"))).contains("line 3 '1 0 0'"));
    assert!(
        log(&format!("0 1 2\n{QUARTER}1 2 2\n1 0 0 0\n")).contains("1 rows after the last header '1 2 2'")
    );
    assert!(
        log(&format!("0 1 2\n{}", QUARTER.replace("1 0 0 2", "2 0 0 2")))
            .contains("at entry '0 1' the matrix")
    );
    assert!(log(&format!("0 1 2\n{}", QUARTER.replace("1 0 0 2", "nan 0 0 2"))).contains("the matrix"));
    assert!(log("").contains("no entry"));
    let matrix = |text: &str| read_matrix(save(&dir, "p.txt", text)).unwrap_err().to_string();
    assert!(matrix("1 0 0 0\n0 1 0 0\n").contains("2 rows"));
    assert!(
        matrix("1 0 0 0\n0 1 0 0\n0 0 -1 0\n0 0 0 1\n").contains("expected a rigid motion"),
        "a reflection"
    );
    let tum = |text: &str| read_tum(save(&dir, "t.txt", text)).unwrap_err().to_string();
    assert!(tum("1 0 0 0 0 0 0 0\n").contains("unit length"));
    assert!(tum("1 0 0 0 0 0 1\n").contains("8 numbers"));
    assert!(read_conf(save(&dir, "b.conf", "camera 1\n")).unwrap_err().to_string().contains("no bmesh line"));
    assert!(read_info(save(&dir, "g.info", format!("0 1 2\n{}", "0 0 0 0 0 inf\n".repeat(6)))).is_err());
    assert!(read_log(dir.path().join("none")).is_err());
}

fn information(value: f64) -> String {
    (0..6)
        .map(|r| (0..6).map(|c| format!("{} ", if r == c { value } else { 0.0 })).collect::<String>() + "\n")
        .collect()
}

#[test]
fn benchmark_joins_log_and_info() {
    let dir = folder();
    save(&dir, "gt.log", format!("0\t1\t3\n{QUARTER}0\t2\t3\n{QUARTER}"));
    let bare = read_benchmark(dir.path()).unwrap();
    assert!(bare.pairs.iter().all(|p| p.information.is_none()));
    save(&dir, "gt.info", format!("0 1 3\n{}0 2 3\n{}", information(5.0), information(0.0)));
    let benchmark = read_benchmark(dir.path()).unwrap();
    assert_eq!((benchmark.scans, benchmark.pairs.len()), (3, 2));
    assert_eq!((benchmark.pairs[1].i, benchmark.pairs[1].j), (ScanId(0), ScanId(2)));
    check_quarter(&benchmark.pairs[0].i_from_j);
    assert_eq!(benchmark.pairs[0].information, Some(Matrix6::identity() * 5.0));
    assert_eq!(
        benchmark.pairs[1].information,
        Some(Matrix6::zeros()),
        "an entry without information is legal"
    );

    save(&dir, "gt.info", format!("0 2 3\n{}0 1 3\n{}", information(5.0), information(5.0)));
    let message = read_benchmark(dir.path()).unwrap_err().to_string();
    assert!(message.contains("pair 0 2 in place 1") && message.contains("0 1 as in gt.log"), "{message}");
    save(&dir, "gt.info", format!("0 1 3\n{}", information(5.0)));
    assert!(
        read_benchmark(dir.path())
            .unwrap_err()
            .to_string()
            .contains("found 1 pairs, expected 2 as in gt.log")
    );
    fs::remove_file(dir.path().join("gt.info")).unwrap();
    save(&dir, "gt.log", format!("0 3 3\n{QUARTER}"));
    assert!(read_benchmark(dir.path()).unwrap_err().to_string().contains("'0 3 3'"));
}

#[test]
fn features_unpack_to_no_more_than_the_options_say() {
    let dir = folder();
    let path = dir.path().join("a.npz");
    // 100 000 keypoints of 12 bytes and descriptors of 4: 1.5 MiB.
    let keypoints = (0..100_000).map(|i| [i as f32, 0.0, 0.0].into()).collect();
    let features = Features::new(keypoints, None, Descriptors::new(1, vec![1.0; 100_000]).unwrap()).unwrap();
    write_features(&path, &features).unwrap();
    let read = |mib| {
        read_features_with(&path, &{
            let mut changed = ReadOptions::default();
            changed.unpack_limit_mib = Some(mib);
            changed
        })
    };
    let message = read(1).unwrap_err().to_string();
    assert!(message.contains("a.npz") && message.contains("input.unpack_limit_mib"), "{message}");
    assert_eq!(read(2).unwrap().len(), 100_000);
}

#[test]
fn scenes_in_every_layout() {
    let shifted = |x: usize| format!("1 0 0 {x}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
    let shifts = |dir: &TempDir| {
        let scene = read_scene(dir.path()).unwrap();
        let truth = scene
            .world_from_scan
            .clone()
            .map(|t| t.value.iter().map(|p| p.translation.x).collect::<Vec<_>>());
        (scene.scans.len(), scene.numbers(), truth)
    };
    // Scan k is shifted by k, so that order and assignment show.
    let dir = folder();
    for k in [2, 10] {
        save(&dir, &format!("PointCloud/cloud_bin_{k}.ply"), "");
        save(&dir, &format!("PointCloud/cloud_bin_{k}.info.txt"), format!("scene a 0 {k}\n{}", shifted(k)));
    }
    assert_eq!(shifts(&dir), (2, vec![Some(2), Some(10)], Some(vec![2.0, 10.0])));
    fs::remove_file(dir.path().join("PointCloud/cloud_bin_10.info.txt")).unwrap();
    let message = read_scene(dir.path()).unwrap_err().to_string();
    assert!(message.contains("cloud_bin_10.info.txt") && message.contains("1 of 2 scans"), "{message}");

    let dir = folder();
    for k in [2, 10] {
        save(&dir, &format!("s{k}.pcd"), "");
        save(&dir, &format!("poses/pose{k}.txt"), shifted(k));
    }
    assert_eq!(shifts(&dir), (2, vec![Some(2), Some(10)], Some(vec![2.0, 10.0])));

    let dir = folder();
    for k in ["000020", "000110"] {
        save(&dir, &format!("frame-{k}.depth.png"), "");
        save(&dir, &format!("frame-{k}.pose.txt"), shifted(k.parse().unwrap()));
    }
    assert_eq!(shifts(&dir), (2, vec![Some(20), Some(110)], Some(vec![20.0, 110.0])));

    let dir = folder();
    save(&dir, "a.ply", "");
    save(&dir, "b.ply", "");
    assert_eq!(shifts(&dir), (2, vec![None, None], None));
    save(&dir, "x.conf", "bmesh b.ply 2 0 0 0 0 0 1\nbmesh c.ply 3 0 0 0 0 0 1\nbmesh a.ply 1 0 0 0 0 0 1\n");
    assert_eq!(shifts(&dir).2, Some(vec![1.0, 2.0]));
    fs::remove_file(dir.path().join("x.conf")).unwrap();
    let lines = [shifted(5), shifted(6)].map(|m| m.replace('\n', " ")).join("\n");
    save(&dir, "poses.txt", &lines);
    assert_eq!(shifts(&dir).2, Some(vec![5.0, 6.0]));
    save(&dir, "poses.txt", format!("{lines}\n{}", lines.lines().next().unwrap()));
    assert!(read_scene(dir.path()).unwrap_err().to_string().contains("found 3 poses, expected 2"));
}

fn cloud() -> PointCloud {
    let dir = folder();
    let vertices = "0 0 0\n1 1 1\n2 2 2\n3 3 3\n";
    let head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    read_cloud(save(&dir, "c.ply", format!("{head}{vertices}"))).unwrap()
}

fn descriptors(dir: &TempDir, name: &str, rows: usize) {
    let path = dir.path().join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let array = ndarray::Array2::from_shape_fn((rows, 2), |(r, c)| (3 * (r + 1) + (r + 1) * c) as f64);
    ndarray_npy::write_npy(path, &array).unwrap();
}

#[test]
fn npz_features_round_trip_and_complain() {
    let dir = folder();
    let path = dir.path().join("f.npz");
    let descriptors = Descriptors::new(2, vec![0.6, 0.8, 1.0, 0.0]).unwrap();
    let keypoints = vec![[1.0f32, 2.0, 3.0].into(), [4.0f32, 5.0, 6.5].into()];
    for normals in [None, Some(vec![Vector3::z(), Vector3::new(0.0f32, 0.6, 0.8)])] {
        let features = Features::new(keypoints.clone(), normals, descriptors.clone()).unwrap();
        write_features(&path, &features).unwrap();
        assert_eq!(read_features(&path).unwrap(), features);
    }
    let write = |keypoints: &ndarray::Array2<f64>, descriptors: &ndarray::Array2<f64>| {
        let mut npz = ndarray_npy::NpzWriter::new(fs::File::create(&path).unwrap());
        npz.add_array("keypoints", keypoints).unwrap();
        npz.add_array("descriptors", descriptors).unwrap();
        npz.finish().unwrap();
        read_features(&path)
    };
    use ndarray::array;
    let read = write(&array![[1.0, 2.0, 3.0]], &array![[3.0, 4.0]]).unwrap();
    assert_eq!(read.descriptors.values(), [0.6, 0.8], "scaled to unit length");
    let message = write(&array![[1.0, 2.0, 3.0]], &array![[3.0, 4.0], [1.0, 0.0]]).unwrap_err().to_string();
    assert!(message.contains("f.npz: found 1 keypoints, expected 2"), "{message}");
    assert!(
        write(&array![[1.0, 2.0]], &array![[3.0, 4.0]])
            .unwrap_err()
            .to_string()
            .contains("keypoints of shape [1, 2]")
    );
    assert!(
        write(&array![[1.0, 2.0, f64::NAN]], &array![[3.0, 4.0]]).unwrap_err().to_string().contains("f.npz")
    );
    let mut npz = ndarray_npy::NpzWriter::new(fs::File::create(&path).unwrap());
    npz.add_array("keypoints", &array![[1.0, 2.0, 3.0]]).unwrap();
    npz.finish().unwrap();
    assert!(
        read_features(&path)
            .unwrap_err()
            .to_string()
            .contains("found arrays [keypoints], expected an array 'descriptors'")
    );
}

#[test]
fn sghr_folders_with_indices_or_points() {
    let dir = folder();
    descriptors(&dir, "yoho_desc/7.npy", 2);
    let read = |name: &str, text: &str, cloud: &PointCloud| {
        fs::remove_dir_all(dir.path().join("Keypoints")).ok();
        save(&dir, &format!("Keypoints/{name}"), text);
        read_sghr_features(dir.path(), "yoho", 7, cloud)
    };
    let expected = vec![[3.0f32, 3.0, 3.0].into(), [1.0f32, 1.0, 1.0].into()];
    for text in ["3\n1\n", "3.000000000000000000e+00\n1.000000000000000000e+00\n", "3 3 3\n1 1 1\n"] {
        let features = read("cloud_bin_7Keypoints.txt", text, &cloud()).unwrap();
        assert_eq!(features.keypoints, expected, "{text}");
        // Rows (3, 4) and (6, 8), scaled.
        assert!(
            features
                .descriptors
                .values()
                .iter()
                .zip([0.6f32, 0.8, 0.6, 0.8])
                .all(|(a, b)| (a - b).abs() < 1e-6)
        );
    }
    let message =
        |name: &str, text: &str, cloud: &PointCloud| read(name, text, cloud).unwrap_err().to_string();
    assert!(message("cloud_bin_7Keypoints.txt", "3\n4\n", &cloud()).contains("index 4 in row 2"));
    assert!(message("cloud_bin_7Keypoints.txt", "3\n-1\n", &cloud()).contains("index -1"));
    let lengths = message("cloud_bin_7Keypoints.txt", "3\n1\n0\n", &cloud());
    let both = Path::new("yoho_desc").join("7.npy");
    assert!(lengths.contains("cloud_bin_7Keypoints.txt: found 3 keypoints, expected 2"), "{lengths}");
    assert!(lengths.contains(both.to_str().unwrap()), "{lengths}");
    // Indices count the rows of the file: with rows dropped they would point elsewhere.
    let holed = PointCloud { dropped_rows: 1, ..cloud() };
    assert!(message("cloud_bin_7Keypoints.txt", "3\n1\n", &holed).contains("1 rows are left out"));
    assert!(message("cloud_bin_8Keypoints.txt", "3\n1\n", &cloud()).contains("no keypoints of scan 7"));
    fs::remove_dir_all(dir.path().join("Keypoints")).unwrap();
    fs::create_dir(dir.path().join("Keypoints")).unwrap();
    ndarray_npy::write_npy(dir.path().join("Keypoints/cloud_bin_7Keypoints.npy"), &ndarray::array![3i64, 1])
        .unwrap();
    assert_eq!(read_sghr_features(dir.path(), "yoho", 7, &cloud()).unwrap().keypoints, expected);
    assert!(
        read_sghr_features(dir.path(), "fcgf", 7, &cloud()).unwrap_err().to_string().contains("fcgf_desc")
    );
}

#[test]
fn one_table_of_poses_by_file_name_is_a_truth_and_one_that_lacks_a_scan_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let scans = folder.path().join("scans");
    std::fs::create_dir(&scans).unwrap();
    for name in ["b_2.xyz", "b_10.xyz"] {
        std::fs::write(scans.join(name), "0 0 0\n1 0 0\n0 1 0\n").unwrap();
    }
    let quarter = "[[0,-1,0,1],[1,0,0,2],[0,0,1,3],[0,0,0,1]]";
    let one = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let truth = folder.path().join("truth.json");
    let read = |text: &str| {
        std::fs::write(&truth, text).unwrap();
        scanweave::io::read_scene(folder.path())
    };
    let scene = read(&format!("{{\"b_10.xyz\": {quarter}, \"b_2.xyz\": {one}}}")).unwrap();
    let poses = scene.world_from_scan.unwrap().value;
    // In the order of the scans: 2 before 10. A quarter turn about z takes x to y.
    assert_eq!(poses[0], RigidMotion::identity());
    let moved = poses[1] * nalgebra::Point3::new(1.0, 0.0, 0.0);
    assert!((moved - nalgebra::Point3::new(1.0, 3.0, 3.0)).norm() < 1e-12);
    let lacking = read(&format!("{{\"b_2.xyz\": {one}}}")).unwrap_err().to_string();
    assert!(lacking.contains("truth.json") && lacking.contains("no pose of b_10.xyz"), "{lacking}");
    let mirrored = read(&format!("{{\"b_2.xyz\": {one}, \"b_10.xyz\": {}}}", one.replacen('1', "-1", 1)));
    assert!(mirrored.unwrap_err().to_string().contains("no rigid motion"));
    assert!(read("[1, 2]").unwrap_err().to_string().contains("a table from file names"));
}
