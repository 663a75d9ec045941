use super::*;
use crate::io::read_file;
use nalgebra::UnitQuaternion;
use std::path::PathBuf;

fn all() -> ReadOptions {
    ReadOptions { attributes: true, ..ReadOptions::default() }
}

/// Rows of a scan of more than one block, far from zero where `far`: the third of a hundred is not finite.
fn row(i: usize, far: bool) -> [f64; 3] {
    let zero = if far { [431_250.0, 5_812_345.0, 100.0] } else { [0.0; 3] };
    let k = i as f64;
    let x = if i % 100 == 2 { f64::NAN } else { (k * 0.37).sin() * 20.0 };
    [zero[0] + x, zero[1] + (k * 0.11).cos() * 15.0, zero[2] + k * 1e-5]
}

const ROWS: usize = 2 * BLOCK_POINTS + 5;

/// Rows as bytes: coordinates as doubles, a colour, an intensity and a normal.
fn rows(far: bool, colour: impl Fn([u8; 3]) -> Vec<u8>) -> Vec<u8> {
    let mut bytes = Vec::new();
    for i in 0..ROWS {
        row(i, far).iter().for_each(|c| bytes.extend(c.to_le_bytes()));
        bytes.extend(colour([i as u8, (i >> 8) as u8, (i >> 16) as u8]));
        bytes.extend((i as f32).to_le_bytes());
        [0f32, 0.6, -0.8].iter().for_each(|c| bytes.extend(c.to_le_bytes()));
    }
    bytes
}

fn ply(folder: &Path, far: bool) -> PathBuf {
    let head = format!(
        "ply\nformat binary_little_endian 1.0\nelement camera 2\nproperty int id\nelement vertex {ROWS}\n\
         property double x\nproperty double y\nproperty double z\nproperty uchar red\nproperty uchar green\n\
         property uchar blue\nproperty float intensity\nproperty float nx\nproperty float ny\n\
         property float nz\nend_header\n"
    );
    let path = folder.join("a.ply");
    std::fs::write(&path, [head.into_bytes(), vec![1; 8], rows(far, |c| c.to_vec())].concat()).unwrap();
    path
}

fn pcd(folder: &Path, far: bool) -> PathBuf {
    let head = format!(
        "FIELDS x y z rgb intensity normal_x normal_y normal_z\nSIZE 8 8 8 4 4 4 4 4\nTYPE F F F U F F F F\n\
         WIDTH {ROWS}\nHEIGHT 1\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS {ROWS}\nDATA binary\n"
    );
    let path = folder.join("a.pcd");
    let bytes = rows(far, |[r, g, b]| vec![b, g, r, 0]);
    std::fs::write(&path, [head.into_bytes(), bytes].concat()).unwrap();
    path
}

/// LAS and E57 by the crates that know these formats.
fn las(folder: &Path, compressed: bool) -> PathBuf {
    let path = folder.join(if compressed { "a.laz" } else { "a.las" });
    let mut builder = ::las::Builder::from((1, 2));
    builder.point_format = ::las::point::Format::new(2).unwrap();
    builder.point_format.is_compressed = compressed;
    let axis = |offset: f64| ::las::Transform { scale: 0.001, offset };
    builder.transforms = ::las::Vector { x: axis(431_250.0), y: axis(5_812_345.0), z: axis(100.0) };
    let mut writer = ::las::Writer::from_path(&path, builder.into_header().unwrap()).unwrap();
    for i in 0..ROWS {
        let [x, y, z] = row(i, true);
        // The first colour of more than eight bits is in the second block.
        let red = if i < BLOCK_POINTS + 3 { 200 } else { 0xff00 };
        let point = ::las::Point {
            x: if x.is_nan() { 431_250.0 } else { x },
            y,
            z,
            intensity: i as u16,
            is_withheld: i % 100 == 2,
            color: Some(::las::Color::new(red, 0, 7)),
            ..Default::default()
        };
        writer.write_point(point).unwrap();
    }
    writer.close().unwrap();
    path
}

fn e57(folder: &Path) -> PathBuf {
    use ::e57::{E57Writer, Record, RecordValue, Transform};
    let path = folder.join("a.e57");
    let mut file = E57Writer::from_file(&path, "file").unwrap();
    let xyz = [Record::CARTESIAN_X_F64, Record::CARTESIAN_Y_F64, Record::CARTESIAN_Z_F64];
    let colour = [Record::COLOR_RED_U8, Record::COLOR_GREEN_U8, Record::COLOR_BLUE_U8];
    let prototype = [&xyz[..], &colour, &[Record::INTENSITY_U16]].concat();
    for scan in 0..2 {
        let mut writer = file.add_pointcloud(&format!("scan {scan}"), prototype.clone()).unwrap();
        writer.set_transform(Some(Transform::default()));
        for i in 0..ROWS {
            let [x, y, z] = row(i, false);
            let x = if x.is_nan() { 0.0 } else { x + f64::from(scan) };
            let mut values = [x, y, z].map(RecordValue::Double).to_vec();
            values.extend(
                [i % 256, i / 256 % 256, scan as usize, i % 65536].map(|v| RecordValue::Integer(v as i64)),
            );
            writer.add_point(values).unwrap();
        }
        writer.finalize().unwrap();
    }
    file.finalize().unwrap();
    path
}

/// Compares all blocks of a scan with the scan read whole.
fn same_in_blocks(path: &Path, part: usize, options: &ReadOptions) {
    let whole = read_file(path, options).unwrap().scans.swap_remove(part).cloud;
    let mut blocks = open_blocks(path, part, options).unwrap().expect("a file that is read in blocks");
    for _ in 0..2 {
        let (mut at, mut sizes) = (0, Vec::new());
        blocks
            .for_each(&mut |block| {
                sizes.push(block.len());
                for i in 0..block.len() {
                    let expected = coordinates_m(&whole, at + i);
                    // Floats between 256 and 512 m are 3.05e-5 m apart, and both are rounded to one.
                    assert!(
                        (coordinates_m(&block, i) - expected).amax() < 3.1e-5,
                        "{path:?}: point {}",
                        at + i
                    );
                }
                let rows = at..at + block.len();
                assert_eq!(block.colors.as_deref(), whole.colors.as_ref().map(|c| &c[rows.clone()]));
                assert_eq!(
                    block.intensities.as_deref(),
                    whole.intensities.as_ref().map(|c| &c[rows.clone()])
                );
                assert_eq!(block.normals.as_deref(), whole.normals.as_ref().map(|c| &c[rows.clone()]));
                at += block.len();
                Ok(())
            })
            .unwrap();
        assert_eq!(at, whole.len(), "{path:?}");
        assert!(sizes.len() == 3 && sizes.iter().all(|&n| n <= BLOCK_POINTS), "{path:?}: {sizes:?}");
    }
    let summary = Summary::of(&mut *blocks, &RigidMotion::identity(), &mut |_| Ok(())).unwrap();
    assert_eq!((summary.points, summary.origin_m), (whole.len(), whole.origin_m), "{path:?}");
    let viewpoint = whole.viewpoint.map(|v| v.coords.cast::<f64>() + whole.origin_m);
    assert_eq!(summary.viewpoint_m.is_some(), viewpoint.is_some(), "{path:?}");
    if let (Some(found), Some(expected)) = (summary.viewpoint_m, viewpoint) {
        assert!((found - expected).amax() < 1e-4, "{path:?}: {found}, not {expected}");
    }
}

#[test]
fn blocks_hold_what_the_whole_file_holds() {
    let folder = tempfile::tempdir().unwrap();
    for far in [false, true] {
        same_in_blocks(&ply(folder.path(), far), 0, &all());
        same_in_blocks(&pcd(folder.path(), far), 0, &all());
    }
    same_in_blocks(&ply(folder.path(), false), 0, &ReadOptions { unit_m: Some(1e-3), ..all() });
    same_in_blocks(&pcd(folder.path(), false), 0, &ReadOptions { unit_m: Some(0.5), ..all() });
    for compressed in [false, true] {
        same_in_blocks(&las(folder.path(), compressed), 0, &all());
    }
    for part in 0..2 {
        same_in_blocks(&e57(folder.path()), part, &all());
    }
}

#[test]
fn what_cannot_be_read_in_blocks_is_held_whole() {
    let folder = tempfile::tempdir().unwrap();
    let whole = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        open_blocks(&path, 0, &all()).unwrap().is_none()
    };
    let ply = |properties: &str, data: &[u8]| {
        let head = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
             property float z\n{properties}end_header\n"
        );
        [head.as_bytes(), data].concat()
    };
    assert!(!whole("a.ply", &ply("", &[0; 12])));
    assert!(!whole("padded.ply", &ply("", &[0; 28])));
    // Too few bytes, too many, a list, and colours whose range only all rows tell.
    assert!(whole("a.ply", &ply("", &[0; 11])));
    assert!(whole("a.ply", &ply("", &[1; 29])));
    assert!(whole("a.ply", &ply("property list uchar int i\n", &[0; 13])));
    assert!(whole(
        "a.ply",
        &ply("property float red\nproperty float green\nproperty float blue\n", &[0; 24])
    ));
    assert!(whole("a.xyz", b"0 0 0\n1 1 1\n"));
    // A count that no file has room for.
    let huge = String::from_utf8(ply("", &[])).unwrap().replace("vertex 1", "vertex 18446744073709551615");
    assert!(whole("a.ply", huge.as_bytes()));
}

#[test]
fn a_moved_block_loses_nothing_far_from_zero() {
    let points = [[0.001, 2.0, 3.0], [1.002, -2.0, 0.5]];
    let mut block = assemble(2, |i| points[i], NO_COLORS, None);
    block.normals = Some(vec![Direction::x(), Direction::z()]);
    // A quarter turn about z takes (x, y, z) to (-y, x, z).
    let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2);
    let far = Vector3::new(431_250.123, 5_812_345.678, 101.5);
    move_block(&mut block, &RigidMotion::from_parts(far.into(), turn));
    for (i, [x, y, z]) in points.into_iter().enumerate() {
        let expected = far + Vector3::new(-y, x, z);
        assert!((coordinates_m(&block, i) - expected).amax() < 1e-6, "{}", coordinates_m(&block, i));
    }
    let normals = block.normals.unwrap();
    assert!((normals[0] - Direction::y()).norm() < 1e-6 && (normals[1] - Direction::z()).norm() < 1e-6);
}

#[test]
fn a_sample_is_spread_over_all_rows() {
    for rows in [1, 2002, 2003, 10_000, 1_000_000] {
        let mut sample = Sample::default();
        (0..rows).for_each(|i| sample.add(Vector3::repeat(i as f64)));
        let step = sample.points.get(1).map_or(1.0, |p| p.x);
        assert!(sample.points.iter().enumerate().all(|(k, p)| p.x == k as f64 * step), "{rows} rows");
        assert!(sample.points.len() <= 2 * SAMPLES && sample.points.len() >= rows.min(SAMPLES));
        // The last is less than a step from the end.
        assert!(sample.points.last().unwrap().x + step >= rows as f64);
    }
}
