//! Files of scanners: PTX, E57, LAS and LAZ, and the coordinates of surveyors.

use super::place::{SURVEY, View, pose, shift, surveyed, views};
use super::registered::{CLOSE, Desk, difference, rigid};
use nalgebra::{Matrix4, Point3};
use scanweave::geometry::{Point, RigidMotion};
use scanweave::io::{E57Scan, Held, Summary, read_cloud, write_e57, write_las};
use scanweave::scan::PointCloud;
use std::path::Path;

const NAMES: [&str; 3] = ["s0", "s1", "s2"];
const PARTS: [&str; 3] = ["project#1", "project#2", "project#3"];

fn cloud(view: &View, origin: [f64; 3]) -> PointCloud {
    let local = |p: &[f64; 3]| Point::from([0, 1, 2].map(|k| (p[k] - origin[k]) as f32));
    let points = view.points.iter().map(local).collect();
    PointCloud { origin_m: origin.into(), ..PointCloud::from_points(points) }
}

/// A cloud as writers take it.
fn held(cloud: PointCloud) -> (Summary, Held) {
    let mut held = Held(cloud);
    let summary = Summary::of(&mut held, &RigidMotion::identity(), &mut |_| Ok(())).unwrap();
    (summary, held)
}

/// A block of PTX: the pose twice, as Leica Cyclone writes it, the second time as the transposed matrix. Every fortieth measurement has no return.
fn ptx(view: &View, world_from_file: &RigidMotion) -> String {
    let matrix = world_from_file.to_homogeneous();
    let line = |values: &[f64]| values.iter().map(|v| format!("{v:.9}")).collect::<Vec<_>>().join(" ") + "\n";
    let mut text = "80\n32\n".to_owned() + &line(&matrix.column(3).as_slice()[..3]);
    for axis in 0..3 {
        text += &line(&matrix.column(axis).as_slice()[..3]);
    }
    for column in 0..4 {
        text += &line(matrix.column(column).as_slice());
    }
    for (i, [x, y, z]) in view.points.iter().enumerate() {
        text += &match i % 40 {
            7 => "0 0 0 0.5\n".to_owned(),
            _ => format!("{x:.3} {y:.3} {z:.3} {:.2}\n", (i % 90) as f64 / 100.0),
        };
    }
    text
}

#[test]
fn ptx_with_three_scans_keeps_their_poses() {
    let (desk, views) = (Desk::new(), views());
    let site = pose([30.0, -12.0, 2.0], 70.0, [0.0; 2]);
    let blocks = views.iter().map(|v| ptx(v, &(site * v.world_from_file)));
    desk.file("project.ptx", blocks.collect::<String>());
    let done = desk.register(&[]);
    done.agrees(&PARTS, &views, CLOSE);
    for (name, view) in PARTS.iter().zip(&views) {
        done.is_at(name, view, &(site * view.world_from_file), CLOSE);
    }
}

#[test]
fn e57_with_three_scans_keeps_their_poses() {
    let (desk, views) = (Desk::new(), views());
    let site = pose([30.0, -12.0, 2.0], 70.0, [0.0; 2]);
    let stored = views.iter().enumerate().map(|(i, view)| {
        let world_from_scan = site * view.world_from_file;
        let (summary, held) = held(cloud(view, [0.0; 3]));
        Ok(E57Scan { name: format!("station {i}"), world_from_scan, summary, blocks: Box::new(held) })
    });
    write_e57(desk.path("project.e57"), "three stations", stored).unwrap();
    let done = desk.register(&[]);
    done.agrees(&PARTS, &views, CLOSE);
    for (name, view) in PARTS.iter().zip(&views) {
        done.is_at(name, view, &(site * view.world_from_file), CLOSE);
    }
}

/// LAS 1.2, point format 0, by the specification of the ASPRS: millimetres from [`SURVEY`].
fn las(view: &View) -> Vec<u8> {
    let mut bytes = vec![0u8; 227];
    bytes[..4].copy_from_slice(b"LASF");
    bytes[24..26].copy_from_slice(&[1, 2]);
    bytes[94..96].copy_from_slice(&227u16.to_le_bytes());
    bytes[96..100].copy_from_slice(&227u32.to_le_bytes());
    bytes[105..107].copy_from_slice(&20u16.to_le_bytes());
    let count = (view.points.len() as u32).to_le_bytes();
    bytes[107..111].copy_from_slice(&count);
    bytes[111..115].copy_from_slice(&count);
    let range = |k: usize| {
        let values = view.points.iter().map(|p| p[k]);
        [values.clone().fold(f64::MIN, f64::max), values.fold(f64::MAX, f64::min)]
    };
    let doubles = [0.001; 3].into_iter().chain(SURVEY).chain((0..3).flat_map(range));
    for (i, value) in doubles.enumerate() {
        bytes[131 + 8 * i..139 + 8 * i].copy_from_slice(&value.to_le_bytes());
    }
    for point in &view.points {
        for k in 0..3 {
            bytes.extend((((point[k] - SURVEY[k]) * 1000.0).round() as i32).to_le_bytes());
        }
        // Intensity, first return of one, ground, straight down, no user data, first strip.
        bytes.extend([0x10, 0x00, 0b0000_1001, 2, 0, 0, 1, 0]);
    }
    bytes
}

#[test]
fn las_and_laz_keep_the_coordinates_of_a_survey() {
    // Only the third strip is not where it belongs: it is to be moved, and the others to stay.
    let off = pose([0.4, -0.3, 0.1], 4.0, [0.0; 2]);
    let at_the_room = |off: &RigidMotion| shift([3.0, 2.0, 0.0]) * off * shift([-3.0, -2.0, 0.0]);
    let views = surveyed(&[RigidMotion::identity(), RigidMotion::identity(), at_the_room(&off)]);
    let belongs = |view: &View| shift(SURVEY) * view.world_from_file;
    let (las_files, laz_files) = (Desk::new(), Desk::new());
    for (name, view) in NAMES.iter().zip(&views) {
        las_files.file(&format!("{name}.las"), las(view));
        let (summary, mut held) = held(cloud(view, SURVEY));
        write_las(laz_files.path(&format!("{name}.laz")), &summary, &mut held, true).unwrap();
    }
    for desk in [las_files, laz_files] {
        let done = desk.register(&[]);
        done.agrees(&NAMES, &views, CLOSE);
        for (name, view) in NAMES.iter().zip(&views) {
            done.is_at(name, view, &belongs(view), CLOSE);
        }
    }
}

/// Poses of a Redwood trajectory in the order of the scans: a line of three numbers, then the matrix.
fn trajectory(path: &Path) -> Vec<RigidMotion> {
    let text = std::fs::read_to_string(path).unwrap();
    let lines: Vec<Vec<f64>> =
        text.lines().map(|l| l.split_whitespace().map(|n| n.parse().unwrap()).collect()).collect();
    lines.chunks(5).map(|c| rigid(&Matrix4::from_fn(|r, k| c[1 + r][k]))).collect()
}

#[test]
fn georeferenced_text_comes_back_in_its_own_coordinates() {
    let at_the_room = |yaw, by| shift([3.0, 2.0, 0.0]) * pose(by, yaw, [0.0; 2]) * shift([-3.0, -2.0, 0.0]);
    let rough =
        [at_the_room(3.0, [0.3, 0.0, 0.0]), at_the_room(-6.0, [0.0, 0.4, 0.1]), at_the_room(9.0, [0.0; 3])];
    let views = surveyed(&rough);
    let desk = Desk::new();
    for (name, view) in NAMES.iter().zip(&views) {
        desk.file(&format!("{name}.xyz"), view.text(" ", ""));
    }
    let done = desk.register(&[]);
    // Sparse scans, too, are placed to millimetres.
    let close = (0.005, 0.1);
    done.agrees(&NAMES, &views, close);

    // The trajectory is for the coordinates of the files, six and seven digits before the point.
    let poses = trajectory(&done.output.join("trajectory.log"));
    assert_eq!(poses.len(), 3);
    for (i, (view, pose)) in views.iter().zip(&poses).enumerate() {
        let to_first = poses[0].inverse() * pose;
        let truth = views[0].world_from_file.inverse() * view.world_from_file;
        let (far, turned) = difference(view, &to_first, &truth);
        assert!(far < close.0 && turned < close.1, "scan {i} is off by {far} m, {turned}°");
        // Nobody moves by more than the rough coordinates are off from each other: 15° and a metre.
        let (moved, _) = difference(view, pose, &RigidMotion::identity());
        assert!(moved < 1.5, "scan {i} is moved by {moved} m");
    }
    // So is the merged cloud: its points are the scans', averaged in voxels of a few centimetres.
    let placed: Vec<Point3<f64>> = views
        .iter()
        .zip(&poses)
        .flat_map(|(view, pose)| view.points.iter().map(move |p| pose * Point3::from(*p)))
        .collect();
    let merged = read_cloud(done.output.join("merged.ply")).unwrap();
    assert!(merged.points.len() > 1000);
    for point in merged.points.iter().step_by(37) {
        let point = Point3::from(point.coords.cast::<f64>() + merged.origin_m);
        let nearest = placed.iter().map(|p| (p - point).norm()).fold(f64::MAX, f64::min);
        assert!(nearest < 0.15, "{point} of merged.ply is {nearest} m from every placed point");
    }
}
