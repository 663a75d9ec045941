//! Depth images in small folders of every layout, written by hand.

use super::*;
use crate::geometry::Point;
use crate::io::{discover, read_file};
use nalgebra::{UnitQuaternion, Vector3};
use std::fs;
use tempfile::TempDir;

/// A red and a blue block of 8×8 pixels: (199, 40, 10) and (20, 60, 181) as libjpeg decodes them,
/// which wrote it.
const JPEG_16X8: &str = "ffd8ffe000104a46494600010100000100010000ffdb0043000201010101010201010102020202020403020202020504\
    040304060506060605060606070908060709070606080b08090a0a0a0a0a06080b0c0b0a0c090a0a0affdb0043010202\
    02020202050303050a0706070a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a\
    0a0a0a0a0a0a0a0a0a0a0a0a0a0affc00011080008001003011100021101031101ffc400150001010000000000000000\
    0000000000000708ffc40014100100000000000000000000000000000000ffc400150101010000000000000000000000\
    0000000908ffc40014110100000000000000000000000000000000ffda000c03010002110311003f0093d2b948139b40\
    7effd9";

fn jpeg() -> Vec<u8> {
    (0..JPEG_16X8.len() / 2).map(|i| u8::from_str_radix(&JPEG_16X8[2 * i..2 * i + 2], 16).unwrap()).collect()
}

fn png_of(size: (u32, u32), color: png::ColorType, depth: png::BitDepth, data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size.0, size.1);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.write_header().unwrap().write_image_data(data).unwrap();
    bytes
}

fn depth_png(size: (u32, u32), values: &[u16]) -> Vec<u8> {
    let data: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
    png_of(size, png::ColorType::Grayscale, png::BitDepth::Sixteen, &data)
}

/// Two by one pixels at 1 and 2 m in millimetres.
fn small() -> Vec<u8> {
    depth_png((2, 1), &[1000, 2000])
}

fn rgb_png(size: (u32, u32), pixels: &[[u8; 3]]) -> Vec<u8> {
    png_of(size, png::ColorType::Rgb, png::BitDepth::Eight, &pixels.concat())
}

fn folder(files: &[(&str, &[u8])]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (name, content) in files {
        let path = dir.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
    }
    dir
}

fn read_in(dir: &TempDir, name: &str, options: &ReadOptions) -> Result<ScanFile> {
    read_file(&dir.path().join(name), options)
}

/// The cloud, the pose and the notes as one text.
fn read(dir: &TempDir, name: &str) -> (StoredScan, String) {
    let mut file = read_in(dir, name, &ReadOptions::default()).unwrap();
    let kind = |n: &Note| if n.warning { "warning: " } else { "info: " };
    let notes: Vec<String> = file.notes.iter().map(|n| format!("{}{}", kind(n), n.text)).collect();
    (file.scans.remove(0), notes.join("\n"))
}

fn depths(scan: &StoredScan) -> Vec<f32> {
    scan.cloud.points.iter().map(|p| p.z).collect()
}

#[test]
fn the_unit_is_the_users_else_what_lies_beside_else_millimetres() {
    let dir = folder(&[("depth/1.png", &small()), ("K.txt", b"500 500 0 0")]);
    let (scan, notes) = read(&dir, "depth/1.png");
    assert_eq!(depths(&scan), [1.0, 2.0]);
    assert_eq!(notes, "info: depth in millimetres (1000 units a metre): pass --depth-scale for another");
    fs::write(dir.path().join("depth_scale.txt"), "scale = 2000\n").unwrap();
    let (scan, notes) = read(&dir, "depth/1.png");
    assert_eq!(depths(&scan), [0.5, 1.0]);
    assert!(notes.starts_with("info: depth in 2000 units a metre"), "{notes}");
    // Metres in a unit, as RealSense states it: 0.0005 m is 2000 units in a metre.
    fs::write(dir.path().join("depth_scale.txt"), "0.0005").unwrap();
    assert_eq!(depths(&read(&dir, "depth/1.png").0), [0.5, 1.0]);
    let options = ReadOptions { depth_units_per_m: Some(5000.0), ..ReadOptions::default() };
    let file = read_in(&dir, "depth/1.png", &options).unwrap();
    assert_eq!((depths(&file.scans[0]), file.notes), (vec![0.2, 0.4], vec![]));
    fs::write(dir.path().join("depth_scale.txt"), "none").unwrap();
    let error = read_in(&dir, "depth/1.png", &ReadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("depth_scale.txt: found 0 numbers") && error.contains("--depth-scale"), "{error}");
    // A scale in a file that is asked for nothing else, in metric frames too.
    fs::remove_file(dir.path().join("depth_scale.txt")).unwrap();
    fs::write(dir.path().join("camera.json"), r#"{"depth_scale": 4000}"#).unwrap();
    assert_eq!(depths(&read(&dir, "depth/1.png").0), [0.25, 0.5]);
    let frame = |options: &ReadOptions| read_frame(dir.path().join("depth/1.png"), options).unwrap();
    assert_eq!(frame(&ReadOptions::default()).0.depth_m, [0.25, 0.5]);
    // What is asked for goes before, and then there is nothing to tell.
    let (image, notes) = frame(&options);
    assert_eq!((image.depth_m, notes), (vec![0.2, 0.4], vec![]));
}

#[test]
fn an_assumed_unit_that_no_depth_camera_fits_is_a_warning() {
    let notes = |median: u16| {
        let dir = folder(&[("1.png", &depth_png((3, 1), &[0, median, median])), ("K.txt", b"9 9 1 0")]);
        read(&dir, "1.png").1
    };
    assert!(notes(10_000).contains("warning: with 1000 units a metre the median depth is more than 10 m"));
    assert!(notes(10_000).contains("--depth-scale 5000"));
    assert!(!notes(9_999).contains("warning") && !notes(50).contains("warning"));
    assert!(notes(49).contains("less than 5 cm"));
    // Not assumed: nothing to warn of.
    let dir = folder(&[("1.png", &depth_png((1, 1), &[60_000])), ("K.txt", b"9 9 1 0")]);
    let options = ReadOptions { depth_units_per_m: Some(1000.0), ..ReadOptions::default() };
    assert_eq!(read_in(&dir, "1.png", &options).unwrap().notes, []);
}

#[test]
fn named_intrinsics_come_before_those_beside() {
    let dir = folder(&[("1.png", &small()), ("K.txt", b"500 500 0 0"), ("other/cam.txt", b"100 100 0 0")]);
    let x = |options: &ReadOptions| read_in(&dir, "1.png", options).unwrap().scans[0].cloud.points[1].x;
    // (1 - 0) 2 m / f
    assert!((x(&ReadOptions::default()) - 0.004).abs() < 1e-7);
    let named =
        |file: &str| ReadOptions { intrinsics: Some(dir.path().join(file)), ..ReadOptions::default() };
    assert!((x(&named("other/cam.txt")) - 0.02).abs() < 1e-7);
    let error = read_in(&dir, "1.png", &named("gone.txt")).unwrap_err().to_string();
    assert!(error.contains("gone.txt: cannot read it"), "{error}");
}

#[test]
fn intrinsics_are_found_up_to_two_folders_up_and_other_files_are_passed_over() {
    for place in ["s/depth/K.txt", "s/K.txt", "K.txt", "s/s.txt", "s/camera.txt"] {
        let dir = folder(&[
            ("s/depth/1.png", &small()),
            ("s/calibration.json", br#"{"serial": 7, "depth_scale": 1000}"#),
            (place, b"fx_depth = 8\nfy_depth = 9\nmx_depth = 1\nmy_depth = 2\n"),
        ]);
        let found = find_intrinsics(&dir.path().join("s/depth/1.png")).unwrap();
        assert_eq!(found, CameraMatrix { fx: 8.0, fy: 9.0, cx: 1.0, cy: 2.0 }, "{place}");
    }
    let dir = folder(&[("a/b/1.png", &small()), ("K.txt", b"8 9 1 2")]);
    let error = find_intrinsics(&dir.path().join("a/b/1.png")).unwrap_err().to_string();
    assert!(
        error.contains("--intrinsics") && error.contains("K.txt") && !error.contains("freiburg"),
        "{error}"
    );
}

#[test]
fn the_layout_of_tum() {
    let color = rgb_png((2, 1), &[[1, 2, 3], [4, 5, 6]]);
    let other = rgb_png((2, 1), &[[9; 3], [9; 3]]);
    let dir = folder(&[
        ("depth/1305031102.160407.png", &depth_png((2, 1), &[5000, 10_000])),
        ("depth.txt", b"# depth maps\n1305031102.160407 depth/1305031102.160407.png\n"),
        ("rgb/1305031102.175304.png", &color),
        ("rgb/1305031102.211214.png", &other),
        (
            "rgb.txt",
            b"# color\n1305031102.211214 rgb/1305031102.211214.png\n1305031102.175304 rgb/1305031102.175304.png\n",
        ),
        // A half turn about z, 5 ms after the image; the other pose is 10 ms before it.
        (
            "groundtruth.txt",
            b"# timestamp tx ty tz qx qy qz qw\n1305031102.1504 9 9 9 0 0 0 1\n1305031102.1654 1 2 3 0 0 1 0\n",
        ),
    ]);
    let name = "depth/1305031102.160407.png";
    let error = read_in(&dir, name, &ReadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("535.4 539.2 320.1 247.6 (freiburg3)"), "{error}");
    fs::write(dir.path().join("calibration.txt"), "500 500 0 0 0.26 -0.95 -0.005 0.003 1.16").unwrap();
    let (scan, notes) = read(&dir, name);
    assert_eq!(depths(&scan), [1.0, 2.0]);
    assert!(
        notes.contains("info: depth in 5000 units a metre") && notes.contains("lens distortion"),
        "{notes}"
    );
    assert_eq!(scan.cloud.colors, Some(vec![[1, 2, 3], [4, 5, 6]]));
    let pose = scan.pose.unwrap();
    assert!((pose.translation.vector - Vector3::new(1.0, 2.0, 3.0)).norm() < 1e-12);
    let half_turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    assert!(pose.rotation.angle_to(&half_turn) < 1e-9);

    // A list of pairs comes first, whichever column the depth is in.
    for pair in [
        "1305031102.21 rgb/1305031102.211214.png 1305031102.16 depth/1305031102.160407.png",
        "1305031102.16 depth/1305031102.160407.png 1305031102.21 rgb/1305031102.211214.png",
    ] {
        fs::write(dir.path().join("associations.txt"), pair).unwrap();
        assert_eq!(read(&dir, name).0.cloud.colors, Some(vec![[9; 3]; 2]));
    }
    // Neither within 20 ms.
    fs::remove_file(dir.path().join("associations.txt")).unwrap();
    fs::write(dir.path().join("rgb.txt"), "1305031102.181 rgb/1305031102.175304.png\n").unwrap();
    fs::write(dir.path().join("groundtruth.txt"), "1305031102.181 1 2 3 0 0 1 0\n").unwrap();
    let scan = read(&dir, name).0;
    assert!(scan.cloud.colors.is_none() && scan.pose.is_none());
}

#[test]
fn the_layout_of_7_scenes() {
    let pose = b"0 -1 0 0.5\n1 0 0 -2\n0 0 1 3\n0 0 0 1\n";
    let lost = b"-1.#IND -1.#IND -1.#IND -1.#IND\nnan nan nan nan\n0 0 inf 0\n0 0 0 1\n";
    let dir = folder(&[
        ("camera-intrinsics.txt", b"500 0 0\n0 500 0\n0 0 1\n"),
        ("frame-000000.depth.png", &depth_png((2, 1), &[65535, 2000])),
        ("frame-000000.color.png", &rgb_png((2, 1), &[[1; 3], [2; 3]])),
        ("frame-000000.pose.txt", pose),
        ("frame-000010.depth.png", &small()),
        ("frame-000010.pose.txt", lost),
        ("frame-000020.depth.png", &small()),
        ("frame-000020.pose.txt", b"2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n"),
    ]);
    let (scan, notes) = read(&dir, "frame-000000.depth.png");
    assert_eq!(notes, "");
    assert_eq!((depths(&scan), scan.cloud.dropped_rows), (vec![2.0], 1));
    assert_eq!(scan.cloud.colors, Some(vec![[2; 3]]));
    // A quarter turn about z: x goes to y.
    let moved = scan.pose.unwrap() * nalgebra::Point3::new(1.0, 0.0, 0.0);
    assert!((moved - nalgebra::Point3::new(0.5, -1.0, 3.0)).norm() < 1e-12, "{moved}");
    let (scan, notes) = read(&dir, "frame-000010.depth.png");
    assert_eq!((scan.pose, notes.as_str()), (None, ""));
    let (scan, notes) = read(&dir, "frame-000020.depth.png");
    assert!(scan.pose.is_none() && notes.starts_with("warning: pose files"), "{notes}");
    let found = discover(&[dir.path().display().to_string()]).unwrap();
    assert_eq!(found.len(), 3);
}

#[test]
fn the_layout_of_scannet() {
    let dir = folder(&[
        ("depth/0.png", &small()),
        ("color/0.jpg", &jpeg()),
        ("intrinsic/intrinsic_depth.txt", b"500 0 0 0\n0 500 0 0\n0 0 1 0\n0 0 0 1\n"),
        ("intrinsic/intrinsic_color.txt", b"900 0 0 0\n0 900 0 0\n0 0 1 0\n0 0 0 1\n"),
        ("pose/0.txt", b"1 0 0 7\n0 1 0 8\n0 0 1 9\n0 0 0 1\n"),
    ]);
    let (scan, notes) = read(&dir, "depth/0.png");
    assert!((scan.cloud.points[1] - Point::new(0.004, 0.0, 2.0)).norm() < 1e-6);
    assert_eq!(scan.pose.unwrap().translation.vector, Vector3::new(7.0, 8.0, 9.0));
    // Pixel 0 of 2 falls on column 4 of 16, pixel 1 on column 12. Decoders may round by one.
    let colors = scan.cloud.colors.unwrap();
    for (found, expected) in colors.iter().zip([[199, 40, 10], [20, 60, 181]]) {
        assert!(found.iter().zip(expected).all(|(a, b): (&u8, u8)| a.abs_diff(b) <= 1), "{found:?}");
    }
    assert_eq!(
        notes,
        "info: colour images of 16x8 pixels are scaled to depth images of 2x1, as registered to them"
    );
}

#[test]
fn the_layout_of_open3d_and_redwood() {
    let camera = br#"{"width": 4, "height": 2, "intrinsic_matrix": [500, 0, 0, 0, 600, 0, 1.5, 0.5, 1]}"#;
    let dir = folder(&[
        ("depth/0000001-000000033369.png", &small()),
        ("image/0000001-000000000000.png", &rgb_png((2, 1), &[[5; 3], [6; 3]])),
        ("image/0000010-000000033369.png", &rgb_png((2, 1), &[[7; 3], [7; 3]])),
        ("camera_intrinsic.json", camera),
    ]);
    let (scan, notes) = read(&dir, "depth/0000001-000000033369.png");
    assert_eq!(scan.cloud.colors, Some(vec![[5; 3], [6; 3]]));
    assert_eq!(notes, "info: intrinsics for 4x2 pixels are scaled to depth images of 2x1");
    // Half the size: f = 250, cx = (1.5 + 0.5) / 2 - 0.5 = 0.5; x = (1 - 0.5) 2 / 250.
    assert!((scan.cloud.points[1] - Point::new(0.004, 0.0, 2.0)).norm() < 1e-6);
    let camera =
        String::from_utf8_lossy(camera).replace("\"height\": 2", "\"height\": 3, \"depth_scale\": 500");
    fs::write(dir.path().join("camera_intrinsic.json"), &camera).unwrap();
    let error = read_in(&dir, "depth/0000001-000000033369.png", &ReadOptions::default()).unwrap_err();
    assert!(error.to_string().contains("found intrinsics for images of 4x3 pixels"), "{error}");
    fs::write(dir.path().join("camera_intrinsic.json"), camera.replace("\"width\": 4", "\"width\": 6"))
        .unwrap();
    assert_eq!(depths(&read(&dir, "depth/0000001-000000033369.png").0), [2.0, 4.0]);
}

#[test]
fn colours_that_do_not_fit_are_left_out_with_a_warning() {
    let png = |color, data: &[u8]| png_of((2, 1), color, png::BitDepth::Eight, data);
    let dir = folder(&[("1_depth.png", &small()), ("K.txt", b"9 9 0 0")]);
    let put = |bytes: &[u8]| {
        fs::write(dir.path().join("1_rgb.png"), bytes).unwrap();
        let (scan, notes) = read(&dir, "1_depth.png");
        (scan.cloud.colors, notes)
    };
    assert_eq!(
        put(&png(png::ColorType::Rgba, &[1, 2, 3, 0, 4, 5, 6, 9])).0,
        Some(vec![[1, 2, 3], [4, 5, 6]])
    );
    assert_eq!(put(&png(png::ColorType::Grayscale, &[7, 8])).0, Some(vec![[7; 3], [8; 3]]));
    let (colors, notes) = put(&rgb_png((2, 2), &[[1; 3]; 4]));
    assert!(
        colors.is_none() && notes.contains("warning: colour images of 2x2 pixels are left out"),
        "{notes}"
    );
    let (colors, notes) = put(b"no image");
    assert!(colors.is_none() && notes.contains("cannot be read"), "{notes}");
}

#[test]
fn a_header_is_not_believed_more_than_its_bytes_can_hold() {
    // 100 gigapixels in a chunk of 11 bytes: the compressed form of a few zeros.
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 0x6400_7fff, 0x7fff_ffff);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let zeros = [0x78, 0x9c, 0x63, 0x60, 0x80, 0x01, 0x00, 0x00, 0x0a, 0x00, 0x01];
    encoder.write_header().unwrap().write_chunk(png::chunk::IDAT, &zeros).unwrap();
    let dir = folder(&[("1.png", &bytes), ("K.txt", b"9 9 0 0")]);
    let error = read_in(&dir, "1.png", &ReadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("a damaged PNG (") && error.contains("bytes can hold"), "{error}");
    // An image of one value, which deflate packs the most, is read: 2 MB of pixels in 2 kB.
    let flat = depth_png((1024, 1024), &vec![1500; 1 << 20]);
    assert!(flat.len() < 20_000, "{}", flat.len());
    fs::write(dir.path().join("1.png"), flat).unwrap();
    assert_eq!(read(&dir, "1.png").0.cloud.len(), 1 << 20);
}

#[test]
fn a_pgm_of_16_bits_is_depth_and_other_images_are_not() {
    let mut pgm = b"P5\n# made by hand\n2 1\n65535\n".to_vec();
    pgm.extend([0x03, 0xe8, 0x07, 0xd0]);
    let dir = folder(&[("1.pgm", &pgm), ("K.txt", b"500 500 0 0")]);
    assert_eq!(depths(&read(&dir, "1.pgm").0), [1.0, 2.0]);
    let error = |bytes: &[u8]| {
        fs::write(dir.path().join("1.pgm"), bytes).unwrap();
        read_in(&dir, "1.pgm", &ReadOptions::default()).unwrap_err()
    };
    assert!(error(&pgm[..pgm.len() - 1]).to_string().contains("3 bytes for 2x1 pixels"));
    assert!(error(b"P5 99999999999 99999999999 65535 ab").to_string().contains("damaged PGM"));
    assert!(error(b"P5 2").to_string().contains("its header"));
    assert!(matches!(error(b"P5\n2 1\n255\nab"), Error::NotAScan { .. }));
    assert!(matches!(error(&rgb_png((1, 1), &[[1; 3]])), Error::NotAScan { .. }));
    for (bytes, kind) in
        [(&b"II*\0...."[..], "TIFF"), (b"\x76\x2f\x31\x01..", "OpenEXR"), (b"Pf\n1 1\n", "PFM")]
    {
        let error = error(bytes).to_string();
        assert!(error.contains(kind) && error.contains("convert it to a 16-bit greyscale PNG"), "{error}");
    }
}

#[test]
fn names_tell_depth_from_other_images() {
    let find = |names: &[&str]| {
        let files: Vec<(&str, &[u8])> = names.iter().map(|n| (*n, &b"x"[..])).collect();
        let dir = folder(&files);
        let found = discover(&[dir.path().display().to_string()]);
        let name = |p: &std::path::PathBuf| p.file_name().unwrap().to_string_lossy().into_owned();
        found.map(|f| f.iter().map(name).collect::<Vec<_>>()).unwrap_or_default()
    };
    assert_eq!(
        find(&["1.png", "1.mask.png", "color-1.png", "rgb1.png", "1_label.png", "2.pgm"]),
        ["1.png", "2.pgm"]
    );
    assert_eq!(find(&["0001.png", "0001_depth.png", "0001_depth_rgb.png"]), ["0001_depth.png"]);
    assert_eq!(find(&["rgbd-1.png", "1.tif"]), ["rgbd-1.png"]);
    assert_eq!(find(&["1.tif"]), ["1.tif"]);
    assert!(is_depth(Path::new("rgb_dataset/1.png")) && !is_depth(Path::new("color_images/1.png")));
    assert!(!is_depth(Path::new("label-filt/1.png")) && is_depth(Path::new("1.png")));
    // Letters inside another word of a folder say nothing, as a temporary folder's may be any.
    assert!(is_depth(Path::new(".tmprgbiKG/frame-1.depth.png")) && is_depth(Path::new("colorado/1.png")));
    assert!(!is_depth(Path::new("colors/1.png")) && !is_depth(Path::new("scan/frame-1.color.png")));
}

#[test]
fn the_layouts_of_phones() {
    // Stray Scanner: the matrix is of colour images 7.5 times as large, 1920x1440 for 256x192.
    let matrix = b"1600.0, 0.0, 957.8\n0.0, 1600.0, 719.5\n0.0, 0.0, 1.0\n";
    let image = depth_png((256, 192), &[2000; 256 * 192]);
    let dir = folder(&[
        ("s/depth/000000.png", &image),
        ("s/camera_matrix.csv", matrix),
        ("s/odometry.csv", b"timestamp, frame, x, y, z, qx, qy, qz, qw\n"),
    ]);
    let found = discover(&[dir.path().join("s").display().to_string()]).unwrap();
    assert_eq!(found, [dir.path().join("s/depth/000000.png")]);
    let (scan, notes) = read(&dir, "s/depth/000000.png");
    assert!(notes.contains("warning: the principal point is that of images 7.5 times as large"), "{notes}");
    // f = 1600/7.5; cx + 0.5 = (957.8 + 0.5)/7.5 and cy + 0.5 = (719.5 + 0.5)/7.5; at 2 m.
    let first = Point::new(2.0 * (0.5 - 958.3 / 7.5) * 7.5 / 1600.0, 2.0 * (0.5 - 96.0) * 7.5 / 1600.0, 2.0);
    assert!((scan.cloud.points[0] - first).norm() < 1e-5, "{}", scan.cloud.points[0]);
    // ARKitScenes: width, height and four numbers for every image, a millisecond beside its time.
    let dir = folder(&[
        ("v/lowres_depth/4_10.500.png", &small()),
        ("v/lowres_wide_intrinsics/4_10.501.pincam", b"4 2 8 8 3 0.5"),
        ("v/lowres_wide_intrinsics/4_10.483.pincam", b"4 2 80 80 3 0.5"),
    ]);
    let (scan, notes) = read(&dir, "v/lowres_depth/4_10.500.png");
    assert!(notes.contains("intrinsics for 4x2 pixels are scaled to depth images of 2x1"), "{notes}");
    // f = 4, cx = 1.25, cy = 0: pixel 1 at 2 m.
    assert!((scan.cloud.points[1] - Point::new(-0.125, 0.0, 2.0)).norm() < 1e-6, "{}", scan.cloud.points[1]);
    let far = folder(&[("v/d/4_10.500.png", &small()), ("v/intrinsics/4_10.530.pincam", b"4 2 8 8 3 0.5")]);
    assert!(read_in(&far, "v/d/4_10.500.png", &ReadOptions::default()).is_err());
}
