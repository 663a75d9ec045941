//! Sizes that only a header states must not decide how much memory is taken.
//!
//! The table that the tests print (`cargo test --test memory_limits -- --nocapture`) has the peaks.

mod allocations;
mod files;

use allocations::{Cost, cost_of};
use files::*;
use scanweave_core::Error;
use scanweave_core::io::{self, ReadOptions, read_file};
use std::path::Path;
use std::time::Duration;
use zip::CompressionMethod::{Deflated, Stored};

/// What a file of a kilobyte may cost.
const SMALL_MIB: usize = 16;
/// What a file may cost that unpacks to gigabytes: it may unpack to 64 MiB and 100 times its size, here 1 MiB.
const BOMB_MIB: usize = 200;
/// Refusing takes milliseconds. More only where a machine is busy.
const LONGEST: Duration = Duration::from_secs(1);
const INTRINSICS: &str = "500 500 4 3";

fn assert_cheap(name: &str, cost: Cost, most_mib: usize) {
    assert!(cost.peak_bytes < most_mib << 20, "{name}: {} MiB", cost.peak_bytes >> 20);
    assert!(cost.took < LONGEST, "{name}: {:?}", cost.took);
}

fn print(what: &str, file_bytes: usize, cost: Cost) {
    let (kib, ms) = (cost.peak_bytes.div_ceil(1024), cost.took.as_secs_f64() * 1e3);
    println!("{what:<62} {file_bytes:>9} bytes  peak {kib:>7} KiB  {ms:>7.1} ms");
}

/// Reads a file of these bytes, which is an error; its message has `said`.
fn refused(folder: &Path, what: &str, name: &str, bytes: &[u8], said: &str, most_mib: usize) {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    let (read, cost) = cost_of(|| read_file(&path, &ReadOptions::default()));
    let message = read.map(|_| ()).expect_err(what).to_string();
    assert!(message.contains(name) && message.contains(said), "{what}: {message}");
    print(what, bytes.len(), cost);
    assert_cheap(what, cost, most_mib);
}

#[test]
fn a_size_that_only_a_header_states_is_an_error_and_takes_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let (place, made) = (folder.path(), folder.path().join("made"));
    std::fs::write(place.join("K.txt"), INTRINSICS).unwrap();
    const HUGE: &str = "1000000000000";
    let list = "property list uint uint64 extra\n";
    let with_list = [&[1; 12][..], &u32::MAX.to_le_bytes(), &[0; 8]].concat();
    let wide_header = [b"\x93NUMPY\x02\x00\xff\xff\xff\xff{".to_vec(), vec![b' '; 64]].concat();
    let stated = npy("'<f8'", "False", &format!("({HUGE}, 3)"), &[0; 64]);
    let pages = |at: usize, value: u64| {
        let mut bytes = e57(&made, "12");
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
        bytes
    };
    let las_of = |compressed: bool, points: u32| {
        let mut bytes = las(&made, compressed);
        // The number of points of LAS 1.2.
        bytes[107..111].copy_from_slice(&points.to_le_bytes());
        bytes
    };
    let binary = "binary_little_endian";
    let cases: Vec<(&str, &str, Vec<u8>, &str)> = vec![
        ("PLY binary, 10^12 vertices", "a.ply", ply(binary, HUGE, PLY_XYZ, &[0; 24]), "2 of 1000000000000"),
        ("PLY ASCII, 10^12 vertices", "b.ply", ply("ascii", HUGE, PLY_XYZ, b"1 2 3\n"), "1 of 1000000000000"),
        (
            "PLY, a list of 2^32 values",
            "c.ply",
            ply(binary, "1", &format!("{PLY_XYZ}{list}"), &with_list),
            "0 of 1",
        ),
        ("PCD ASCII, 10^12 points", "a.pcd", pcd("ascii", HUGE, b"1 2 3\n"), HUGE),
        ("PCD binary, 10^12 points", "b.pcd", pcd("binary", HUGE, &[0; 24]), HUGE),
        (
            "PCD packed, 4 GiB stated",
            "c.pcd",
            pcd("binary_compressed", "357913941", &lzf(u32::MAX, &[0; 24])),
            "points of more than 65 MiB",
        ),
        (
            "PCD packed, 60 MiB stated",
            "d.pcd",
            pcd("binary_compressed", "5242880", &lzf(62_914_560, &[0; 24])),
            "damaged",
        ),
        ("PTX, 10^5 x 10^6 rows", "a.ptx", ptx("100000", "1000000"), "100000000000"),
        ("NPY, 10^12 rows", "a.npy", stated.clone(), "64 bytes of data"),
        ("NPY, 2^60 x 0 by columns", "b.npy", npy("'<f8'", "True", "(1152921504606846976, 0)", &[]), "shape"),
        ("NPY, a header of 4 GiB", "c.npy", wide_header, "no NPY array"),
        ("NPZ, 10^12 rows stored", "a.npz", archive("points.npy", &stated, Stored, 0), "64 bytes of data"),
        (
            "NPZ, 10^12 rows deflated",
            "b.npz",
            archive("points.npy", &stated, Deflated, 0),
            "64 bytes of data",
        ),
        ("LAS, 2^32 points", "a.las", las_of(false, u32::MAX), "4294967295"),
        ("LAZ, 2^32 points", "a.laz", las_of(true, u32::MAX), "4294967295"),
        ("LAZ, 2.5 million points", "b.laz", las_of(true, 2_500_000), "b.laz"),
        ("E57, 10^11 points", "a.e57", e57(&made, "100000000000"), "points of more than 65 MiB"),
        ("E57, a description of 2^63 bytes", "b.e57", pages(32, u64::MAX / 2), "b.e57"),
        ("E57, pages of 2^40 bytes", "c.e57", pages(40, 1 << 40), "c.e57"),
        ("GLB, 10^12 positions", "a.glb", glb(1_000_000_000_000, 144), "1000000000000"),
        ("GLB, a chunk of 4 GiB", "b.glb", glb(12, u32::MAX), "cut short"),
        ("STL, 2^32 triangles", "a.stl", stl(u32::MAX), "a.stl"),
        ("OFF, 10^12 vertices", "a.off", [b"OFF\n", HUGE.as_bytes(), b" 0 0\n1 2 3\n"].concat(), "a.off"),
        (
            "PNG, 2^31 x 2^31 pixels",
            "a.png",
            png(i32::MAX as u32, i32::MAX as u32, &pixels(8, 6), 0),
            "pixels",
        ),
        ("PNG, a row of 2^31 pixels", "b.png", png(i32::MAX as u32, 1, &pixels(8, 6), 0), "pixels"),
        (
            "PNG, 3 GB that its bytes might hold",
            "c.png",
            png(40_000, 40_000, &pixels(8, 6), 4 << 20),
            "--unpack-limit",
        ),
        ("PGM, 10^12 pixels", "a.pgm", b"P5 1000000 1000000 65535\n\x03\xe8".to_vec(), "1000000x1000000"),
        (
            "ZIP, cut short within",
            "a.zip",
            archive("a.ply", &ply(binary, HUGE, PLY_XYZ, &[0; 24]), Deflated, 0),
            HUGE,
        ),
        (
            "gzip of a PLY of 10^12 vertices",
            "a.ply.gz",
            gzip(&ply(binary, HUGE, PLY_XYZ, &[0; 24]), 0, 0),
            HUGE,
        ),
    ];
    for (what, name, bytes, said) in &cases {
        refused(place, what, name, bytes, said, SMALL_MIB);
    }
}

#[test]
fn what_unpacks_to_gigabytes_is_refused_at_the_limit() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path();
    let gib = 1 << 30;
    let array = npy("'|u1'", "False", "(357913941, 3)", &[]);
    let header = ply("binary_little_endian", "89478485", PLY_XYZ, &[]);
    for (what, name, bytes) in [
        ("gzip of a text of 1 GiB", "a.xyz.gz", gzip(b"1 2 3\n", b' ', gib)),
        ("gzip of a PLY of 1 GiB", "a.ply.gz", gzip(&header, 0, gib)),
        ("ZIP of a PLY of 1 GiB", "a.zip", archive("a.ply", &header, Deflated, gib)),
        ("NPZ of bytes of 1 GiB", "a.npz", archive("points.npy", &array, Deflated, gib)),
    ] {
        let path = place.join(name);
        std::fs::write(&path, &bytes).unwrap();
        let (read, cost) = cost_of(|| read_file(&path, &ReadOptions::default()));
        let message = read.map(|_| ()).unwrap_err().to_string();
        for part in [name, "when unpacked", "input.unpack_limit_mib", "--unpack-limit"] {
            assert!(message.contains(part), "{what}: {message}");
        }
        print(what, bytes.len(), cost);
        assert!(cost.peak_bytes < BOMB_MIB << 20, "{what}: {} MiB", cost.peak_bytes >> 20);
    }
}

#[test]
fn arrays_that_are_not_read_are_not_unpacked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    let mut npz = ndarray_npy::NpzWriter::new_compressed(std::fs::File::create(&path).unwrap());
    npz.add_array("unused", &ndarray::Array2::<f64>::zeros((4 << 20, 4))).unwrap();
    npz.add_array("points", &ndarray::Array2::<f32>::eye(3)).unwrap();
    npz.finish().unwrap();
    let (read, cost) = cost_of(|| read_file(&path, &ReadOptions::default()));
    assert_eq!(read.unwrap().scans[0].cloud.len(), 3);
    print("NPZ, an unused array of 128 MiB", std::fs::metadata(&path).unwrap().len() as usize, cost);
    assert_cheap("NPZ", cost, SMALL_MIB);
}

#[test]
fn features_caches_and_checkpoints_take_no_more() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let huge = |key: &str, columns: usize| {
        let array = npy("'<f4'", "False", &format!("(1000000000000, {columns})"), &[0; 64]);
        write(&format!("{key}.npz"), &archive(&format!("{key}.npy"), &array, Deflated, 0))
    };
    let packed = npy("'<f4'", "False", "(8388608, 32)", &[]);
    let packed = write("packed.npz", &archive("pairs.npy", &packed, Deflated, 1 << 30));
    // The length of the JSON that follows, and a tensor beyond the file.
    let endless = write("a.safetensors", &[&(u64::MAX / 2).to_le_bytes()[..], b"{}"].concat());
    let json = r#"{"a":{"dtype":"F32","shape":[1000000000000],"data_offsets":[0,4000000000000]}}"#;
    let beyond = [&(json.len() as u64).to_le_bytes()[..], json.as_bytes(), &[0; 8]].concat();
    let beyond = write("b.safetensors", &beyond);
    let load = |path: &Path| scanweave_core::files::load_arrays::<String>(path, "a checkpoint").map(|_| ());
    let keypoints = huge("keypoints", 3);
    let pairs = huge("pairs", 32);
    type Read<'a> = Box<dyn Fn() -> Result<(), Error> + 'a>;
    let cases: Vec<(&str, &Path, Read<'_>)> = vec![
        ("features, 10^12 keypoints", &keypoints, Box::new(|| io::read_features(&keypoints).map(|_| ()))),
        ("kept pairs, 10^12", &pairs, Box::new(|| io::read_pairs(&pairs, "").map(|_| ()))),
        ("kept pairs, 1 GiB packed", &packed, Box::new(|| io::read_pairs(&packed, "").map(|_| ()))),
        ("checkpoint, a description of 2^63 bytes", &endless, Box::new(|| load(&endless))),
        ("checkpoint, a tensor of 4 TB", &beyond, Box::new(|| load(&beyond))),
    ];
    for (what, path, read) in &cases {
        let (read, cost) = cost_of(read);
        let message = read.expect_err(what).to_string();
        assert!(message.contains(path.file_name().unwrap().to_str().unwrap()), "{message}");
        print(what, std::fs::metadata(path).unwrap().len() as usize, cost);
        assert_cheap(what, cost, SMALL_MIB);
    }
}

/// A PTS file with another number of rows than it states is read, with a warning.
#[test]
fn the_number_of_rows_of_a_pts_file_reserves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pts");
    std::fs::write(&path, "1000000000000\n1 2 3\n1.5 5 3\n").unwrap();
    let (read, cost) = cost_of(|| read_file(&path, &ReadOptions::default()));
    let read = read.unwrap();
    assert_eq!(read.scans[0].cloud.len(), 2);
    assert!(read.notes.iter().any(|n| n.warning && n.text.contains("row")), "{:?}", read.notes);
    print("PTS, 10^12 points", 34, cost);
    assert_cheap("PTS", cost, SMALL_MIB);
}

#[test]
fn a_colour_image_that_states_too_much_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    std::fs::write(place("K.txt"), INTRINSICS).unwrap();
    std::fs::write(place("frame-000000.depth.png"), png(8, 6, &pixels(8, 6), 0)).unwrap();
    std::fs::write(place("frame-000000.color.jpg"), jpeg(60_000)).unwrap();
    let (read, cost) = cost_of(|| read_file(&place("frame-000000.depth.png"), &ReadOptions::default()));
    let read = read.unwrap();
    assert_eq!((read.scans[0].cloud.len(), &read.scans[0].cloud.colors), (48, &None));
    assert!(read.notes.iter().any(|n| n.warning && n.text.contains("cannot be read")), "{:?}", read.notes);
    print("JPEG beside depth, 60000 x 60000 pixels", jpeg(60_000).len(), cost);
    assert_cheap("JPEG", cost, SMALL_MIB);
}

/// Every stretch of four and of eight bytes of a whole file in turn is made large: whatever it stands for,
/// reading ends soon and takes little memory.
#[test]
fn no_number_in_a_small_file_decides_how_much_memory_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("K.txt"), INTRINSICS).unwrap();
    let fours = [u32::MAX, i32::MAX as u32, 1 << 30, 0x0fff_ffff].map(u32::to_le_bytes);
    let eights = [u64::MAX, i64::MAX as u64, 1 << 40, 1 << 32].map(u64::to_le_bytes);
    let large: Vec<Vec<u8>> = fours.iter().map(|b| b.to_vec()).chain(eights.map(|b| b.to_vec())).collect();
    // Text and numbers of the other byte order.
    let large: Vec<Vec<u8>> = large
        .iter()
        .cloned()
        .chain(large.iter().map(|b| b.iter().rev().copied().collect()))
        .chain([b"99999999".to_vec(), b"9999".to_vec()])
        .collect();
    for (name, bytes) in whole(folder.path()) {
        let path = folder.path().join(name);
        let read = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            cost_of(|| {
                read_file(&path, &{
                    let mut changed = ReadOptions::default();
                    changed.attributes = true;
                    changed
                })
                .map(|_| ())
            })
        };
        let (whole, alone) = read(&bytes);
        whole.unwrap_or_else(|e| panic!("{e}"));
        let mut worst = alone;
        for value in &large {
            for at in 0..bytes.len().saturating_sub(value.len()) {
                let mut changed = bytes.clone();
                changed[at..at + value.len()].copy_from_slice(value);
                let (_, cost) = read(&changed);
                let most = if cost.peak_bytes > worst.peak_bytes { cost } else { worst };
                worst = Cost { took: cost.took.max(worst.took), ..most };
                assert_cheap(&format!("{name} with {value:x?} at {at}"), cost, BOMB_MIB);
            }
        }
        print(&format!("{name} whole"), bytes.len(), alone);
        print(&format!("{name} with large numbers"), bytes.len(), worst);
    }
}
