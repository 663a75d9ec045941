//! Finding scans, reading many, depth images.

use scanweave::geometry::Point;
use scanweave::io::{CameraMatrix, StoredDepth, read_depth_png, read_intrinsics};
use scanweave::io::{discover, read_cloud, read_scans, unique_names};

use scanweave::{Error, Monitor, Silent};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Ten rows, the fewest of a scan, of which no column grows as an index or times do.
const CLOUD: &str = "1 2 3\n4 5 6\n1 2 3\n4 5 6\n1 2 3\n4 5 6\n1 2 3\n4 5 6\n1 2 3\n4 5 6\n";

fn folder(files: &[&str]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    for file in files {
        let path = dir.path().join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, CLOUD).unwrap();
    }
    dir
}

fn find(dir: &Path, inputs: &[&str]) -> scanweave::Result<Vec<String>> {
    let inputs: Vec<String> = inputs
        .iter()
        .map(|i| match i.strip_prefix('@') {
            Some(list) => format!("@{}/{list}", dir.display()),
            None => format!("{}/{i}", dir.display()),
        })
        .collect();
    let found = discover(&inputs)?;
    Ok(found.iter().map(|p| fs::canonicalize(p).unwrap()).map(|p| relative(dir, &p)).collect())
}

fn relative(dir: &Path, path: &Path) -> String {
    path.strip_prefix(fs::canonicalize(dir).unwrap()).unwrap().to_string_lossy().into_owned()
}

#[test]
fn folders_are_sorted_naturally_and_hold_scans_only() {
    let dir = folder(&[
        "s10.ply",
        "s2.PLY",
        "s1.pcd",
        "README",
        "bun.conf",
        "poses.txt",
        ".s3.ply",
        "f.npz",
        "c.png",
        "sub/x.ply",
    ]);
    assert_eq!(find(dir.path(), &[""]).unwrap(), ["s1.pcd", "s2.PLY", "s10.ply"]);
    // Equal whatever the order of the inputs; a file by three names is one scan.
    let inputs = ["s10.ply", "*.pcd", "s2.PLY", "./sub/../s10.ply", "sub"];
    let expected = ["s1.pcd", "s2.PLY", "s10.ply", "sub/x.ply"];
    for turn in 0..inputs.len() {
        let mut turned = inputs;
        turned.rotate_left(turn);
        let mut found = find(dir.path(), &turned).unwrap();
        found.sort_by_key(|f| expected.iter().position(|e| e == f));
        assert_eq!(found, expected);
    }
    let one = discover(&[dir.path().join("s10.ply").display().to_string(), dir.path().display().to_string()])
        .unwrap();
    assert_eq!(one.len(), 3);
}

#[test]
fn data_set_layouts_and_lesser_formats() {
    let dir = folder(&[
        "PointCloud/cloud_bin_10.ply",
        "PointCloud/cloud_bin_9.ply",
        "PointCloud/cloud_bin_9.info.txt",
        "x.ply",
    ]);
    assert_eq!(
        find(dir.path(), &[""]).unwrap(),
        ["PointCloud/cloud_bin_9.ply", "PointCloud/cloud_bin_10.ply"]
    );
    let dir = folder(&["2.npy", "11.npy", "1.png"]);
    assert_eq!(find(dir.path(), &[""]).unwrap(), ["2.npy", "11.npy"]);
    let dir = folder(&["frame-2.depth.png", "frame-2.color.png", "frame-10.depth.png", "K.txt"]);
    assert_eq!(find(dir.path(), &[""]).unwrap(), ["frame-2.depth.png", "frame-10.depth.png"]);
    let dir = folder(&["depth/00010.png", "depth/00009.png", "K.txt", "poses.txt"]);
    assert_eq!(find(dir.path(), &[""]).unwrap(), ["depth/00009.png", "depth/00010.png"]);
}

#[test]
fn lists_and_globs() {
    let dir = folder(&["a 1.xyz", "b[2].xyz", "n.txt", "[odd]/c.ply", "[odd]/.hidden.ply"]);
    fs::write(dir.path().join("list.lst"), "# scans\nb[2].xyz\r\n\n  a 1.xyz\n[odd]\n").unwrap();
    assert_eq!(find(dir.path(), &["@list.lst"]).unwrap(), ["[odd]/c.ply", "a 1.xyz", "b[2].xyz"]);
    // A name that is there is a name, not a pattern.
    assert_eq!(find(dir.path(), &["b[2].xyz"]).unwrap(), ["b[2].xyz"]);
    assert_eq!(find(dir.path(), &["?.txt"]).unwrap(), ["n.txt"]);
    fs::write(dir.path().join("[odd]/list.txt"), "*.ply\n").unwrap();
    assert_eq!(find(dir.path(), &["@[odd]/list.txt"]).unwrap(), ["[odd]/c.ply"]);
}

#[test]
fn nothing_found_says_what_was_looked_for() {
    let dir = folder(&["README", "notes.txt"]);
    let message = |inputs: &[&str]| find(dir.path(), inputs).unwrap_err().to_string();
    let empty = message(&[""]);
    assert!(empty.contains("2 files, none of them a scan") && empty.contains("PLY, PCD"), "{empty}");
    assert!(message(&["*.ply"]).contains("*.ply: found no file"));
    assert!(message(&["gone.ply"]).contains("gone.ply: cannot read it: no such file or folder"));
    assert!(message(&["@gone.txt"]).contains("gone.txt: cannot read it"));
    assert!(message(&["[x"]).contains("not valid"));
    fs::write(dir.path().join("l.txt"), "# none\n").unwrap();
    assert!(message(&["@l.txt"]).contains("l.txt: found no path"));
    assert!(discover(&[]).unwrap_err().to_string().contains("no scan"));
}

#[test]
fn sorting_is_total_and_natural() {
    // Leading zeros, case, numbers beyond 64 bits: each name once, numbers by value.
    let dir = folder(&[
        "v1.ply",
        "v01.ply",
        "V2.ply",
        "v99999999999999999999999.ply",
        "v100000000000000000000000.ply",
        "w.ply",
        "v010.ply",
    ]);
    assert_eq!(
        find(dir.path(), &[""]).unwrap(),
        [
            "v01.ply",
            "v1.ply",
            "V2.ply",
            "v010.ply",
            "v99999999999999999999999.ply",
            "v100000000000000000000000.ply",
            "w.ply"
        ]
    );
}

struct Count(AtomicUsize, bool);
impl Monitor for Count {
    fn advance(&self, items: usize) {
        self.0.fetch_add(items, Ordering::Relaxed);
    }
    fn cancelled(&self) -> bool {
        self.1
    }
}

#[test]
fn scans_come_in_order_with_unique_names() {
    let dir = folder(&["a/s1.xyz", "b/s1.xyz", "b/s2.xyz"]);
    fs::write(dir.path().join("b/s2.xyz"), "7 8 9\n".repeat(10)).unwrap();
    let paths: Vec<PathBuf> =
        ["b/s2.xyz", "b/s1.xyz", "a/s1.xyz"].iter().map(|p| dir.path().join(p)).collect();
    let monitor = Count(AtomicUsize::new(0), false);
    let scans = read_scans(&paths, &monitor).unwrap();
    let names: Vec<&str> = scans.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["s2", "b/s1", "a/s1"]);
    assert_eq!(scans.iter().map(|s| s.id.0).collect::<Vec<_>>(), [0, 1, 2]);
    assert_eq!(scans[0].cloud.points, [Point::new(7.0, 8.0, 9.0); 10]);
    assert_eq!(scans[2].path.as_ref(), Some(&paths[2]));
    assert_eq!(monitor.0.into_inner(), 3);
    assert!(matches!(read_scans(&paths, &Count(AtomicUsize::new(0), true)), Err(Error::Interrupted { .. })));
}

#[test]
fn names_stay_unique_for_the_same_stem_in_one_folder() {
    let names =
        unique_names(&["x/a.ply".into(), "x/a.pcd".into(), "x/b.ply".into(), "x/bell\u{7}.ply".into()]);
    assert_eq!(names, ["x/a.ply", "x/a.pcd", "b.ply", "bell\u{fffd}.ply"]);
}

#[test]
fn the_first_bad_scan_in_order_is_named() {
    let dir = folder(&["1.xyz", "2.xyz", "3.xyz"]);
    fs::write(dir.path().join("2.xyz"), "nan nan nan\ninf 0 0\n".repeat(5)).unwrap();
    fs::write(dir.path().join("3.xyz"), "no numbers here\n1 2\n").unwrap();
    let paths = discover(&[dir.path().display().to_string()]).unwrap();
    for _ in 0..20 {
        let message = read_scans(&paths, &Silent).unwrap_err().to_string();
        assert!(message.contains("2.xyz: found 0 finite points of 10 rows"), "{message}");
    }
}

#[cfg(unix)]
#[test]
fn names_that_are_not_utf8_or_try_to_trick_a_terminal() {
    use std::os::unix::ffi::OsStrExt;
    let dir = tempfile::tempdir().unwrap();
    let hostile: [&[u8]; 5] = [b"\xff.ply.xyz", b"\xfe.ply.xyz", b"-rf.xyz", b"a\nb\x1b[2J.xyz", b"*.xyz"];
    for name in hostile {
        fs::write(dir.path().join(std::ffi::OsStr::from_bytes(name)), CLOUD).unwrap();
    }
    let paths = discover(&[dir.path().display().to_string()]).unwrap();
    let scans = read_scans(&paths, &Silent).unwrap();
    assert_eq!(scans.len(), 5);
    let mut names: Vec<&String> = scans.iter().map(|s| &s.name).collect();
    assert!(names.iter().all(|n| !n.contains(char::is_control)), "{names:?}");
    names.sort();
    names.dedup();
    assert_eq!(names.len(), 5);
}

fn save_png(path: &Path, width: u32, height: u32, color: png::ColorType, depth: png::BitDepth, data: &[u8]) {
    let mut encoder = png::Encoder::new(fs::File::create(path).unwrap(), width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.write_header().unwrap().write_image_data(data).unwrap();
}

#[test]
fn a_depth_image_becomes_the_points_of_a_pinhole_camera() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("1.png");
    let values = [0u16, 1000, 65535, 2500, 65534, 1];
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
    save_png(&path, 3, 2, png::ColorType::Grayscale, png::BitDepth::Sixteen, &bytes);
    let image = read_depth_png(&path).unwrap();
    assert_eq!(image, StoredDepth { width: 3, height: 2, values: values.to_vec() });
    let message = read_cloud(&path).unwrap_err().to_string();
    assert!(message.contains("1.png") && message.contains("K.txt"), "{message}");
    fs::write(dir.path().join("K.txt"), "500 250 1 0.5\n").unwrap();
    let cloud = read_cloud(&path).unwrap();
    // By hand: (u - 1) z / 500, (v - 0.5) z / 250, z.
    let expected = [
        Point::new(0.0, -0.002, 1.0),
        Point::new(-0.005, 0.005, 2.5),
        Point::new(0.0, 0.131068, 65.534),
        Point::new(2e-6, 2e-6, 1e-3),
    ];
    assert_eq!((cloud.points.len(), cloud.dropped_rows), (4, 2));
    for (p, e) in cloud.points.iter().zip(expected) {
        assert!((p - e).norm() < 1e-6, "{p} {e}");
    }
    let scaled = image.to_cloud(&CameraMatrix { fx: 500.0, fy: 250.0, cx: 1.0, cy: 0.5 }, 5000.0).unwrap();
    assert!((scaled.points[1] - Point::new(-0.001, 0.001, 0.5)).norm() < 1e-7);
    assert!(image.to_cloud(&CameraMatrix { fx: 0.0, fy: 1.0, cx: 0.0, cy: 0.0 }, 1000.0).is_err());

    save_png(&path, 1, 1, png::ColorType::Rgb, png::BitDepth::Eight, &[1, 2, 3]);
    assert!(read_depth_png(&path).unwrap_err().to_string().contains("Rgb pixels, 8 bits"));
    save_png(&path, 3, 2, png::ColorType::Grayscale, png::BitDepth::Sixteen, &bytes);
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() - 20]).unwrap();
    assert!(read_depth_png(&path).unwrap_err().to_string().contains("damaged PNG"));
}

#[test]
fn intrinsics_in_both_forms() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("K.txt");
    let read = |text: &str| {
        fs::write(&path, text).unwrap();
        read_intrinsics(&path)
    };
    let expected = CameraMatrix { fx: 585.0, fy: 586.0, cx: 320.0, cy: 240.5 };
    assert_eq!(read("# fx fy cx cy\n585 586 320 240.5\n").unwrap(), expected);
    assert_eq!(read("585,586,320,240.5").unwrap(), expected);
    assert_eq!(read("5.85e2 0 320\n0 586 240.5\n0 0 1\n").unwrap(), expected);
    assert_eq!(read("[[585, 0, 320], [0, 586, 240.5], [0, 0, 1]]").unwrap(), expected);
    assert!(read("585 586 320").unwrap_err().to_string().contains("3 numbers"));
    assert!(read("585 2 320 0 586 240 0 0 1").unwrap_err().to_string().contains("a matrix"));
    assert!(read("-585 586 320 240").unwrap_err().to_string().contains("fx -585"));
    assert!(read("focal length").unwrap_err().to_string().contains("not numbers"));
}
