//! Readers against real files. They lie in the folder named by SCANWEAVE_DATA; without it these tests do nothing.
//!
//! Expected counts, first and last points, and means were computed with other readers: plyfile 1.1 (PLY),
//! pypcd4 (PCD), numpy.loadtxt (text, poses) and Pillow (PNG), means in double precision.

mod real_common;

use real_common::data;
use scanweave::Silent;
use scanweave::io::{discover, read_cloud, read_scans, scan_files};
use scanweave::io::{read_benchmark, read_scene};
use scanweave::scan::PointCloud;

struct Expected {
    rows: usize,
    finite: usize,
    first: [f32; 3],
    last: [f32; 3],
    mean: [f64; 3],
}

fn check(cloud: &PointCloud, e: &Expected) {
    assert_eq!((cloud.len(), cloud.len() + cloud.dropped_rows), (e.finite, e.rows));
    let near = |p: &scanweave::geometry::Point, e: [f32; 3]| {
        // Exact but for the last bit of f32, where the format holds text or the point is computed.
        p.iter().zip(e).all(|(a, b)| (a - b).abs() <= 2e-7 * b.abs().max(1.0))
    };
    assert!(near(&cloud.points[0], e.first), "{}", cloud.points[0]);
    assert!(near(&cloud.points[cloud.len() - 1], e.last), "{}", cloud.points[cloud.len() - 1]);
    for axis in 0..3 {
        let mean = cloud.points.iter().map(|p| f64::from(p[axis])).sum::<f64>() / cloud.len() as f64;
        // Means of rounded points: 1e-6 m is f32 rounding at tens of metres.
        assert!((mean - e.mean[axis]).abs() < 1e-6, "axis {axis}: {mean}");
    }
    assert_eq!(cloud.origin_m, nalgebra::Vector3::zeros());
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn clouds_of_every_kind() {
    let data = data();
    let cases = [
        (
            "bunny/bun000.ply",
            Expected {
                rows: 40256,
                finite: 40256,
                first: [-0.06325, 0.0359793, 0.0420873],
                last: [-0.018, 0.18794, -0.0197253],
                mean: [-0.024020704981733185, 0.09658480398427245, 0.035631735293574926],
            },
        ),
        (
            "bunny/ear_back.ply",
            Expected {
                rows: 32193,
                finite: 32193,
                first: [0.1065, 0.0257904, 0.0940729],
                last: [0.014, 0.187506, 0.0369117],
                mean: [-0.0035943217397321776, 0.10262581030384724, 0.07623873222120409],
            },
        ),
        (
            "formats/eth_gazebo_summer_Hokuyo_10.ply",
            Expected {
                rows: 109672,
                finite: 109672,
                first: [-10.131145, -12.904618, -0.5184146],
                last: [12.640579, 0.6032245, 8.432257],
                mean: [0.8965918491810941, 0.37623026810773136, 0.7839574977119113],
            },
        ),
        (
            "formats/eth_gazebo_summer_Hokuyo_12.ply",
            Expected {
                rows: 87944,
                finite: 87944,
                first: [-9.429193, -13.952263, -0.8069998],
                last: [10.043289, 1.6675944, 8.52583],
                mean: [1.0148677233141932, 1.4505939617501566, 0.8113685033470701],
            },
        ),
        (
            "kitchen_raw/cloud_bin_5.ply",
            Expected {
                rows: 313910,
                finite: 313910,
                first: [0.042000055, 0.45599997, 0.806],
                last: [1.266, 0.43799996, 3.05],
                mean: [0.024552400428261217, -0.2937646608187695, 2.4325826776566553],
            },
        ),
        (
            "facade/s0.pcd",
            Expected {
                rows: 44728,
                finite: 44728,
                first: [5.064433, 1.5731657, -0.12494463],
                last: [27.173975, 6.55488, 4.616_76],
                mean: [9.933624272090963, 3.153254237131815, 0.6252970507127777],
            },
        ),
        (
            "formats/capture0001.pcd",
            Expected {
                rows: 307200,
                finite: 249647,
                first: [-1.494803, -1.195277, 2.967],
                last: [0.8452801, 0.68112, 1.512],
                mean: [-0.02550650982003127, 0.0009460424034476776, 2.2441174990539277],
            },
        ),
        (
            "formats/capture0002.pcd",
            Expected {
                rows: 307200,
                finite: 249931,
                first: [-1.053547, -0.76704, 1.904],
                last: [0.8952801, 0.71896, 1.596],
                mean: [-0.015812598818193593, 0.002911136841619384, 2.2421110945894633],
            },
        ),
        (
            "formats/lionscan4approx.xyz",
            Expected {
                rows: 16429,
                finite: 16429,
                first: [36.306, -1.929, 13.461],
                last: [31.916, 14.187, -37.221],
                mean: [42.69611017103951, -2.150420049911751, -10.624400572158985],
            },
        ),
        (
            "hololens/depth/00003.png",
            Expected {
                rows: 540 * 360,
                finite: 152235,
                first: [-0.47628418, -0.716412, 2.098],
                last: [0.46421, 0.329443, 0.86],
                mean: [-0.0953092695555924, 0.053564469919161466, 1.7204816500804534],
            },
        ),
        (
            "7scenes/frame-000000.depth.png",
            Expected {
                rows: 640 * 480,
                finite: 273943,
                first: [-1.1181641, -0.84389746, 2.057],
                last: [0.46144956, 0.3546188, 0.868],
                mean: [-0.054501276443091454, -0.09499796229992444, 1.9231094315220325],
            },
        ),
    ];
    for (file, expected) in cases {
        println!("{file}");
        check(&read_cloud(data.join(file)).unwrap(), &expected);
    }
    // pypcd4's decode_rgb: every point of this scan has the same colour.
    let colors = read_cloud(data.join("facade/s0.pcd")).unwrap().colors.unwrap();
    assert!(colors.iter().all(|c| *c == [0, 215, 79]));
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn scenes_and_their_truth() {
    let data = data();
    // Folder, scans, with truth.
    let scenes = [
        ("bunny", 10, true),
        ("facade", 7, true),
        ("kitchen_raw", 6, false),
        ("hololens", 373, true),
        ("7scenes", 100, true),
        ("3dmatch/7-scenes-redkitchen", 60, true),
        ("3dmatch/sun3d-hotel_umd-maryland_hotel3", 37, true),
    ];
    for (folder, scans, truth) in scenes {
        let scene = read_scene(data.join(folder)).unwrap();
        assert_eq!(scene.scans.len(), scans, "{folder}");
        assert_eq!(scene.world_from_scan.is_some(), truth, "{folder}");
        assert!(scene.world_from_scan.is_none_or(|t| t.value.len() == scans));
    }
    let kitchen = read_scene(data.join("3dmatch/7-scenes-redkitchen")).unwrap();
    let truth = kitchen.world_from_scan.unwrap();
    // numpy: the largest |RᵀR − I| over the 60 files.
    assert!((truth.deviation - 6.174378173e-4).abs() < 1e-9, "{}", truth.deviation);
    // Every pair of the log must be what the scans' own poses say. 1e-3: the repair moves the
    // rotations by their deviation of 6e-4.
    let numbers: Vec<usize> = (0..60).collect();
    let found: Vec<usize> = kitchen
        .scans
        .iter()
        .map(|p| {
            let stem = p.file_stem().unwrap().to_str().unwrap();
            stem.trim_start_matches("cloud_bin_").parse().unwrap()
        })
        .collect();
    assert_eq!(found, numbers, "natural order");
    for (benchmark, pairs) in [("3DMatch", 506), ("3DLoMatch", 525)] {
        // Lines of gt.log over five: 2530 and 2625.
        let b = read_benchmark(data.join("benchmarks").join(benchmark).join("7-scenes-redkitchen")).unwrap();
        assert_eq!((b.scans, b.pairs.len()), (60, pairs));
        for pair in &b.pairs {
            let expected = truth.value[pair.i.0].inverse() * truth.value[pair.j.0];
            let angle = expected.rotation.angle_to(&pair.i_from_j.rotation);
            let shift = (expected.translation.vector - pair.i_from_j.translation.vector).norm();
            assert!(angle < 1e-3 && shift < 5e-3, "{} {}: {angle} {shift}", pair.i, pair.j);
            assert!(pair.information.is_some_and(|m| m[(0, 0)] > 0.0));
        }
    }
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn true_poses_bring_the_bunny_together() {
    let data = data();
    let scene = read_scene(data.join("bunny")).unwrap();
    let truth = scene.world_from_scan.unwrap().value;
    let scans = read_scans(&scene.scans, &Silent).unwrap();
    let at = |name: &str| scans.iter().position(|s| s.name == name).unwrap();
    let (a, b) = (at("bun000"), at("bun045"));
    let b_from_a = truth[b].inverse() * truth[a];
    let index = scanweave::geometry::PointIndex::new(&scans[b].cloud.points);
    let mover = scanweave::geometry::PointMover::new(&b_from_a);
    let near = scans[a]
        .cloud
        .points
        .iter()
        .filter(|p| index.nearest(&mover.point(p)).is_some_and(|n| n.1 < 0.0015f32.powi(2)));
    let share = near.count() as f64 / scans[a].cloud.len() as f64;
    // Neighbouring views overlap by more than half; with the quaternion read the other way round, hardly at all.
    assert!(share > 0.5, "{share}");
}

#[test]
#[ignore = "needs the real scans that SCANWEAVE_DATA names"]
fn folders_hold_only_scans() {
    let data = data();
    let bunny = discover(&[data.join("bunny").display().to_string()]).unwrap();
    assert_eq!(bunny.len(), 10);
    assert!(bunny.iter().all(|p| p.extension().is_some_and(|e| e == "ply")));
    let kitchen = scan_files(&data.join("kitchen_raw")).unwrap();
    let scans = read_scans(&kitchen, &Silent).unwrap();
    // "element vertex" of the six headers.
    let counts: Vec<usize> = scans.iter().map(|s| s.cloud.len()).collect();
    assert_eq!(counts, [258342, 268977, 291605, 268376, 313395, 313910]);
    assert_eq!(scans[3].name, "cloud_bin_3");
}
