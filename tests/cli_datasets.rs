//! `scanweave fuse`, `sample` and `ground-truth` on a synthetic walk with a depth camera.

mod cli_common;

use cli_common::*;
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use scanweave::evaluation::{RecallConfig, registration_recall};
use scanweave::geometry::RigidMotion;
use scanweave::io;
use scanweave::scan::ScanId;
use scanweave::synthetic::{Site, SynthConfig, render_depth};
use std::fmt::Write;
use std::path::Path;

const FRAMES: usize = 24;

/// A walk of 24 exact depth images through one room, four close to each other at each of six
/// places, in millimetres with poses and intrinsics beside them.
fn walk(folder: &Path) -> (Site, Vec<RigidMotion>) {
    let config = SynthConfig { frames_per_scan: 4, noise: 0.0, ..SynthConfig::default() };
    let site = Site::new(&config, 5, 1, FRAMES / 4);
    let poses: Vec<RigidMotion> = (0..site.len()).flat_map(|s| site.camera_poses(s).to_vec()).collect();
    let k = *site.intrinsics();
    std::fs::create_dir_all(folder.join("depth")).unwrap();
    std::fs::write(folder.join("K.txt"), format!("{} {} {} {}", k.fx, k.fy, k.cx, k.cy)).unwrap();
    let mut lines = String::new();
    for (i, pose) in poses.iter().enumerate() {
        let image = render_depth(site.scene(), pose, &k, 6.0);
        let pixels: Vec<u8> =
            image.depth_m.iter().flat_map(|z| ((z * 1000.0).round() as u16).to_be_bytes()).collect();
        let file = std::fs::File::create(folder.join(format!("depth/{i:04}.png"))).unwrap();
        let mut encoder = png::Encoder::new(file, k.width as u32, k.height as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
        let m = pose.to_homogeneous();
        let row = (0..16).map(|e| format!("{:e}", m[(e / 4, e % 4)])).collect::<Vec<_>>();
        writeln!(lines, "{}", row.join(" ")).unwrap();
    }
    std::fs::write(folder.join("poses.txt"), lines).unwrap();
    (site, poses)
}

fn run(command: &str, input: &Path, output: &Path, more: &[&str]) -> assert_cmd::assert::Assert {
    scanweave().arg(command).arg(input).arg("-o").arg(output).args(more).assert()
}

fn difference(a: &RigidMotion, b: &RigidMotion) -> f64 {
    (a.to_homogeneous() - b.to_homogeneous()).abs().max()
}

#[test]
fn fragments_are_the_surface_in_the_frame_of_their_first_image() {
    let place = folder();
    let (site, poses) = walk(place.path());
    let fuse = |name: &str, threads: &str| {
        let output = place.path().join(name);
        let flags = ["--frames-per-fragment", "4", "--voxel", "0.01", "--threads", threads];
        run("fuse", place.path(), &output, &flags).success().stdout(contains("6 fragments"));
        output
    };
    let (one, two) = (fuse("one", "1"), fuse("two", "3"));
    assert_eq!(names(&one), ["PointCloud"]);
    let scene = io::read_scene(&one).unwrap();
    let truth = scene.world_from_scan.unwrap().value;
    assert_eq!(scene.scans.len(), 6);
    let mut off = Vec::new();
    for (number, path) in scene.scans.iter().enumerate() {
        let bytes = std::fs::read(path).unwrap();
        assert!(bytes == std::fs::read(two.join("PointCloud").join(path.file_name().unwrap())).unwrap());
        assert!(difference(&truth[number], &poses[4 * number]) < 1e-12);
        let cloud = io::read_cloud(path).unwrap();
        for p in cloud.points.iter().step_by(9) {
            let world = poses[4 * number] * p.cast::<f64>();
            let distances = site.scene().primitives().iter().map(|s| s.signed_distance(&world).abs());
            off.push(distances.fold(f64::INFINITY, f64::min) / 0.01);
        }
    }
    let share = |limit: f64| off.iter().filter(|d| **d > limit).count() as f64 / off.len() as f64;
    eprintln!(
        "{} points; share beyond a quarter, half, one, two voxels: {:?}",
        off.len(),
        [0.25, 0.5, 1.0, 2.0].map(share)
    );
    assert!(off.len() > 20_000);
    // Only where a voxel meets an edge or an outline, or a solid is thinner than the truncation, is
    // a point farther off.
    assert!(share(0.25) < 0.1 && share(0.5) < 0.04 && share(1.0) < 0.02, "{}", share(0.5));

    run("fuse", place.path(), &one, &[]).code(5).stderr(contains("--force"));
    let all = ["--force", "--frames-per-fragment", "100", "--voxel", "0.02"];
    run("fuse", place.path(), &one, &all).success().stdout(contains("1 fragments"));
    assert_eq!(names(&one.join("PointCloud")).len(), 2);
}

/// Unit and intrinsics that the images do not say come from flags, and what is assumed is said.
#[test]
fn fuse_takes_the_unit_and_the_intrinsics_of_images() {
    let place = folder();
    walk(place.path());
    let few = ["--frames-per-fragment", "4", "--step", "12", "--voxel", "0.04"];
    let fuse = |name: &str, more: &[&str]| {
        let output = place.path().join(name);
        let done = run("fuse", place.path(), &output, &[&few[..], more].concat());
        (done, output.join("PointCloud/cloud_bin_0.ply"))
    };
    let (assumed, first) = fuse("assumed", &[]);
    assumed.success().stderr(contains("8 images: depth in millimetres"));
    let points = std::fs::read(first).unwrap();

    let away = place.path().join("away.yaml");
    std::fs::rename(place.path().join("K.txt"), &away).unwrap();
    fuse("none", &[]).0.code(3).stderr(contains("--intrinsics"));
    let camera = std::fs::read_to_string(&away).unwrap();
    let [fx, fy, cx, cy] = camera.split(' ').collect::<Vec<_>>()[..] else { panic!("{camera}") };
    std::fs::write(&away, format!("fx: {fx}\nfy: {fy}\ncx: {cx}\ncy: {cy}\n")).unwrap();
    let named = ["--intrinsics", away.to_str().unwrap(), "--depth-scale"];
    let (same, first) = fuse("named", &[&named[..], &["1000"]].concat());
    same.success().stderr(contains("images:").not());
    assert!(std::fs::read(first).unwrap() == points);
    // Half as deep: other surface.
    let (half, first) = fuse("half", &[&named[..], &["2000"]].concat());
    half.success();
    assert!(std::fs::read(first).unwrap() != points);
    fuse("zero", &[&named[..], &["0"]].concat()).0.code(4);
}

#[test]
fn a_sample_forgets_the_order_and_keeps_the_poses() {
    let place = folder();
    let (_, poses) = walk(place.path());
    let sample = |name: &str, seed: &str| {
        let output = place.path().join(name);
        run("sample", place.path(), &output, &["--frames", "6", "--every", "4", "--seed", seed]).success();
        output
    };
    let (one, two, other) = (sample("one", "3"), sample("two", "3"), sample("other", "4"));
    let frames = |set: &Path| -> Vec<usize> {
        let scene = io::read_scene(set).unwrap();
        let truth = scene.world_from_scan.unwrap().value;
        let frame = |pose: &RigidMotion| poses.iter().position(|p| difference(p, pose) < 1e-12).unwrap();
        truth.iter().map(frame).collect()
    };
    let picked = frames(&one);
    assert_eq!(picked, frames(&two));
    assert_ne!(picked, frames(&other));
    let mut sorted = picked.clone();
    sorted.sort_unstable();
    assert_eq!(sorted, [0, 4, 8, 12, 16, 20]);
    assert_ne!(picked, sorted);
    // Each scan is the image of its frame.
    for (number, frame) in picked.iter().enumerate() {
        let scan = io::read_cloud(one.join(format!("PointCloud/cloud_bin_{number}.ply"))).unwrap();
        let image = io::read_cloud(place.path().join(format!("depth/{frame:04}.png"))).unwrap();
        assert_eq!(scan.points, image.points);
    }
    let result = place.path().join("result");
    scanweave().arg("register").arg(&one).arg("-o").arg(&result).assert().success();
    scanweave()
        .arg("evaluate")
        .arg(&result)
        .arg("--truth")
        .arg(&one)
        .assert()
        .success()
        .stdout(contains("of 6 scans"));
}

#[test]
fn a_walk_that_is_too_short_names_what_fits() {
    let place = folder();
    walk(place.path());
    let output = place.path().join("sample");
    // 29 steps of 20 need 581 frames.
    run("sample", place.path(), &output, &[])
        .code(4)
        .stderr(contains("found 30 of them 20 apart").and(contains("at most 2 frames")));
    run("sample", place.path(), &output, &["--frames", "6", "--every", "5"])
        .code(4)
        .stderr(contains("at most 4 apart, or at most 5 of them"));
    run("sample", place.path(), &output, &["--first", "24", "--frames", "2"]).code(4);
    assert!(!output.exists());
    std::fs::remove_file(place.path().join("poses.txt")).unwrap();
    for command in ["sample", "fuse", "ground-truth"] {
        run(command, place.path(), &output, &[]).code(3).stderr(contains("without true poses"));
    }
    assert!(!output.exists());
}

#[test]
fn ground_truth_is_read_back_as_it_was_and_agrees_with_itself() {
    let place = folder();
    let set = synth(place.path(), 8);
    let output = place.path().join("truth");
    run("ground-truth", &set, &output, &[]).success().stdout(contains("3DMatch").and(contains("3DLoMatch")));
    assert_eq!(names(&output), ["3DLoMatch", "3DMatch", "overlap.csv"]);
    let poses = io::read_scene(&set).unwrap().world_from_scan.unwrap().value;
    let matrix: Vec<Vec<f64>> = text(output.join("overlap.csv"))
        .lines()
        .skip(1)
        .map(|l| l.split(',').skip(1).map(|v| v.parse().unwrap()).collect())
        .collect();
    let mut pairs = 0;
    for (name, low, high) in [("3DMatch", 0.3, 1.0), ("3DLoMatch", 0.1, 0.3)] {
        let benchmark = io::read_benchmark(output.join(name)).unwrap();
        assert_eq!(benchmark.scans, 8);
        let lines = text(output.join(name).join("gt_overlap.log"));
        let published: Vec<Vec<f64>> =
            lines.lines().map(|l| l.split(',').map(|v| v.parse().unwrap()).collect()).collect();
        assert_eq!(published.len(), 8 * 7 / 2);
        let of_first =
            |i: usize, j: usize| published.iter().find(|l| (l[0], l[1]) == (i as f64, j as f64)).unwrap()[2];
        // Of two scans that share nothing, neither shares anything.
        assert!((0..8).all(|j| (0..j).all(|i| (of_first(i, j) > 0.0) == (matrix[i][j] > 0.0))));
        // Every pair of the range and no other.
        let expected: Vec<(usize, usize)> = (0..8)
            .flat_map(|i| (i + 1..8).map(move |j| (i, j)))
            .filter(|&(i, j)| of_first(i, j) > low && of_first(i, j) <= high)
            .collect();
        let found: Vec<(usize, usize)> = benchmark.pairs.iter().map(|p| (p.i.0, p.j.0)).collect();
        assert_eq!(found, expected);
        pairs += found.len();
        let relative = |i: ScanId, j: ScanId| Some((0, poses[i.0].inverse() * poses[j.0]));
        let recall = registration_recall(&benchmark.pairs, relative, &RecallConfig::default()).unwrap();
        assert_eq!(recall.succeeded, recall.counted);
        assert_eq!(recall.succeeded_in_largest, Some(recall.counted));
        assert!(benchmark.pairs.iter().all(|p| p.information.is_some_and(|m| m[(0, 0)] > 0.0)));
    }
    assert!(pairs > 5, "{pairs}");

    run("ground-truth", &set, &output, &[]).code(5).stderr(contains("--force"));
    // Points a millimetre apart or less are hardly ever common: no pair, and none left over.
    run("ground-truth", &set, &output, &["--force", "--radius", "0.0001"])
        .success()
        .stdout(contains("0 pairs, nothing written"));
    assert!(!output.join("3DMatch/gt.log").exists());
    run("ground-truth", &set, &output, &["--force", "--radius", "0"]).code(4).stderr(contains("radius"));
}
