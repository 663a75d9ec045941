//! Depth images.

use super::place::{View, pose, room};
use super::registered::{CLOSE, Desk, Registered};
use nalgebra::{UnitQuaternion, Vector3};
use scanweave::geometry::RigidMotion;
use scanweave::scan::Intrinsics;
use scanweave::synthetic::render_depth;
use std::path::Path;

/// Units in a metre, as TUM RGB-D has them.
const UNITS: f64 = 5000.0;
const CAMERA: Intrinsics = Intrinsics { width: 160, height: 120, fx: 110.0, fy: 110.0, cx: 79.5, cy: 59.5 };

fn write_png(path: &Path, depth: &[u16]) {
    let mut encoder =
        png::Encoder::new(std::fs::File::create(path).unwrap(), CAMERA.width as u32, CAMERA.height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let bytes: Vec<u8> = depth.iter().flat_map(|v| v.to_be_bytes()).collect();
    encoder.write_header().unwrap().write_image_data(&bytes).unwrap();
}

/// Three images, 12° and a few decimetres apart.
fn write(desk: &Desk) -> Vec<View> {
    // A camera looks along z and has y down: from the axes of a scanner that looks along x.
    let axes = UnitQuaternion::from_matrix(&nalgebra::Matrix3::from_columns(&[
        -Vector3::y(),
        -Vector3::z(),
        Vector3::x(),
    ]));
    let image = |i: usize| {
        let k = i as f64;
        let at = pose([1.0 + 0.25 * k, 1.6 + 0.1 * k, 1.5], 10.0 + 12.0 * k, [2.0, 12.0 - 3.0 * k]);
        let world_from_file = at * RigidMotion::from_parts(Vector3::zeros().into(), axes);
        let image = render_depth(&room(), &world_from_file, &CAMERA, 12.0);
        let units: Vec<u16> = image.depth_m.iter().map(|z| (f64::from(*z) * UNITS).round() as u16).collect();
        std::fs::create_dir_all(desk.path("depth")).unwrap();
        write_png(&desk.path(&format!("depth/{i:05}.png")), &units);
        let ray = |p: usize| CAMERA.ray((p % CAMERA.width) as f64, (p / CAMERA.width) as f64);
        let measured = units.iter().enumerate().filter(|u| *u.1 > 0);
        let points = measured.map(|(p, &u)| (ray(p) * (f64::from(u) / UNITS)).into()).collect();
        View { world_from_file, points }
    };
    (0..3).map(image).collect()
}

#[test]
fn depth_images_have_the_scale_that_is_said() {
    let desk = Desk::new();
    let views = write(&desk);
    desk.file("K.txt", "110 110 79.5 59.5\n");
    let names = ["00000", "00001", "00002"];
    desk.register(&["--depth-scale", "5000"]).agrees(&names, &views, CLOSE);

    // Where nothing is said, a unit is a millimetre: everything is five times as large.
    let large: Registered = desk.register(&[]);
    let step = |run: &Registered| {
        (run.pose("00000").unwrap().inverse() * run.pose("00001").unwrap()).translation.vector.norm()
    };
    let truth = (views[0].world_from_file.inverse() * views[1].world_from_file).translation.vector.norm();
    assert!((step(&large) - 5.0 * truth).abs() < 5.0 * CLOSE.0, "{} against {truth}", step(&large));
}

#[test]
fn intrinsics_may_lie_elsewhere() {
    let desk = Desk::new();
    let views = write(&desk);
    // Not in a folder where they would be found without being named.
    let elsewhere = super::cli_common::folder();
    let camera = elsewhere.path().join("camera.txt");
    std::fs::write(&camera, "110 0 79.5\n0 110 59.5\n0 0 1\n").unwrap();
    let done = desk.register(&["--depth-scale", "5000", "--intrinsics", camera.to_str().unwrap()]);
    done.agrees(&["00000", "00001", "00002"], &views, CLOSE);
}
