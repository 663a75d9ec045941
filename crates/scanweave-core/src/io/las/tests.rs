use crate::io::{ReadOptions, read_cloud, read_file};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

const KINDS: [(&str, bool); 2] = [("a.las", false), ("a.laz", true)];
const POINTS: usize = 10;

/// Ten points a metre apart along x; the fourth is withheld where `withheld`.
fn write(folder: &Path, name: &str, compressed: bool, (minor, format): (u8, u8), withheld: bool) -> PathBuf {
    let path = folder.join(name);
    let mut builder = ::las::Builder::from((1, minor));
    builder.point_format = ::las::point::Format::new(format).unwrap();
    builder.point_format.is_compressed = compressed;
    let transform = |offset: f64| ::las::Transform { scale: 0.001, offset };
    builder.transforms =
        ::las::Vector { x: transform(431_000.0), y: transform(5_812_000.0), z: transform(0.0) };
    if minor == 4 && !compressed {
        // Too long for a plain record: it stands behind the points.
        builder.evlrs.push(::las::Vlr { data: vec![7; 70_000], ..Default::default() });
    }
    let mut writer = ::las::Writer::from_path(&path, builder.into_header().unwrap()).unwrap();
    for i in 0..POINTS {
        writer
            .write_point(::las::Point {
                x: 431_250.123 + i as f64,
                y: 5_812_345.678,
                z: 12.5,
                intensity: 100 * i as u16,
                is_withheld: withheld && i == 3,
                color: Some(::las::Color::new(0xff00, 0x8000, i as u16)),
                gps_time: (format > 5).then_some(0.0),
                ..Default::default()
            })
            .unwrap();
    }
    writer.close().unwrap();
    path
}

#[test]
fn las_round_trip() {
    let dir = tempfile::tempdir().unwrap();
    for (name, compressed) in KINDS {
        let cloud = read_cloud(write(dir.path(), name, compressed, (2, 2), false)).unwrap();
        assert_eq!(cloud.origin_m, Vector3::new(431_300.0, 5_812_300.0, 0.0));
        assert_eq!(cloud.colors, Some(vec![[255, 128, 0]; POINTS]));
        assert_eq!((&cloud.intensities, cloud.viewpoint), (&None, None));
        let back = cloud.points[3].coords.cast::<f64>() + cloud.origin_m;
        // The file's own step is 1 mm.
        assert!((back - Vector3::new(431_253.123, 5_812_345.678, 12.5)).amax() < 6e-4, "{back}");
    }
}

#[test]
fn withheld_points_are_dropped_with_their_attributes() {
    let dir = tempfile::tempdir().unwrap();
    let options = ReadOptions { attributes: true, ..ReadOptions::default() };
    for (name, compressed) in KINDS {
        // The mark stands in another byte from point format 6 on.
        for kind in [(2, 2), (4, 7)] {
            let path = write(dir.path(), name, compressed, kind, true);
            let cloud = read_file(&path, &options).unwrap().scans.swap_remove(0).cloud;
            assert_eq!((cloud.len(), cloud.dropped_rows), (POINTS - 1, 1), "{name} {kind:?}");
            let intensities = [0.0, 100.0, 200.0, 400.0, 500.0, 600.0, 700.0, 800.0, 900.0];
            assert_eq!(cloud.intensities, Some(intensities.to_vec()));
            assert_eq!(cloud.colors.as_ref().unwrap().len(), POINTS - 1);
            let back = cloud.points[3].coords.cast::<f64>() + cloud.origin_m;
            assert!((back.x - 431_254.123).abs() < 6e-4, "{back}");
        }
    }
}

/// The error for a file with some bytes put in place of others.
fn with_bytes(path: &Path, at: usize, bytes: &[u8]) -> String {
    let mut content = std::fs::read(path).unwrap();
    content[at..at + bytes.len()].copy_from_slice(bytes);
    std::fs::write(path, content).unwrap();
    read_cloud(path).unwrap_err().to_string()
}

#[test]
fn more_points_in_the_header_than_in_the_file() {
    let dir = tempfile::tempdir().unwrap();
    for (name, compressed) in KINDS {
        for promised in [11, 70_000, u32::MAX] {
            let path = write(dir.path(), name, compressed, (2, 2), false);
            // The number of points stands at byte 107 up to LAS 1.3.
            let message = with_bytes(&path, 107, &promised.to_le_bytes());
            assert!(message.contains(&format!("expected {promised} as its header says")), "{message}");
            assert!(message.contains("cut short"), "{message}");
        }
        // Whatever the file loses, it is not read as if it were whole.
        let path = write(dir.path(), name, compressed, (2, 2), false);
        let whole = std::fs::read(&path).unwrap();
        for lost in 1..whole.len() {
            std::fs::write(&path, &whole[..whole.len() - lost]).unwrap();
            assert!(read_cloud(&path).is_err(), "{name} without its last {lost} bytes");
        }
    }
}

#[test]
fn sizes_that_a_header_only_claims_reserve_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let path = write(dir.path(), "a.las", false, (4, 7), false);
    let content = std::fs::read(&path).unwrap();
    // The place of the extended records stands at byte 235, their length 20 bytes into each.
    let record = u64::from_le_bytes(*content[235..].first_chunk().unwrap()) as usize;
    assert_eq!(content[record + 20..record + 28], 70_000u64.to_le_bytes());
    let message = with_bytes(&path, record + 20, &(u64::MAX / 4).to_le_bytes());
    assert!(message.contains("a record of 4611686018427387903 bytes"), "{message}");

    let path = write(dir.path(), "a.laz", true, (2, 2), false);
    let content = std::fs::read(&path).unwrap();
    // The place of the points stands at byte 96; they begin with the place of the table of chunks.
    let points = u32::from_le_bytes(*content[96..].first_chunk().unwrap()) as usize;
    let table = u64::from_le_bytes(*content[points..].first_chunk().unwrap()) as usize;
    assert_eq!(content[table + 4..table + 8], 1u32.to_le_bytes());
    let message = with_bytes(&path, table + 4, &u32::MAX.to_le_bytes());
    assert!(message.contains("4294967295 chunks, more than it has room for"), "{message}");
}

#[test]
fn a_scale_that_leaves_nothing_of_the_coordinates_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    for (name, compressed) in KINDS {
        for (bad, said) in [(0.0f64, "a scale of 0 "), (f64::NAN, "a scale of NaN ")] {
            let path = write(dir.path(), name, compressed, (2, 2), false);
            // The scales stand at byte 131, x first.
            let message = with_bytes(&path, 131, &bad.to_le_bytes());
            assert!(message.contains(said) && message.contains("for x"), "{message}");
        }
        // Along z nothing varies: some writers store a scale of zero, and the offset is the height.
        let path = write(dir.path(), name, compressed, (2, 2), false);
        let mut content = std::fs::read(&path).unwrap();
        content[147..155].copy_from_slice(&0f64.to_le_bytes());
        content[171..179].copy_from_slice(&12.5f64.to_le_bytes());
        std::fs::write(&path, content).unwrap();
        let cloud = read_cloud(&path).unwrap();
        assert_eq!(f64::from(cloud.points[0].z) + cloud.origin_m.z, 12.5);
    }
}

#[test]
fn las_by_hand_of_version_1_0_and_with_bytes_that_nothing_describes() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.las");
    // Version, format and length of the points, and two bytes before the points that 1.0 asks for.
    for (minor, format, length, signature) in [(0u8, 1u8, 28u16, &[0xdd, 0xcc][..]), (2, 0, 24, &[])] {
        let mut bytes = [b"LASF", &[0; 20][..], &[1, minor], &[0; 68], &227u16.to_le_bytes()].concat();
        bytes.extend((227 + signature.len() as u32).to_le_bytes());
        bytes.extend([&[0; 4][..], &[format], &length.to_le_bytes(), &2u32.to_le_bytes(), &[0; 20]].concat());
        [0.01f64, 0.01, 0.01, 5e6, 5e5, 100.0].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        bytes.resize(227, 0);
        bytes.extend(signature);
        for raw in [[100i32, 200, -300], [400, 500, 600]] {
            raw.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
            bytes.extend(std::iter::repeat_n(0, usize::from(length) - 12));
        }
        std::fs::write(&path, &bytes).unwrap();
        let cloud = read_cloud(&path).unwrap();
        let back = |i: usize| cloud.points[i].coords.cast::<f64>() + cloud.origin_m;
        assert_eq!(cloud.len(), 2, "1.{minor}");
        assert!((back(0) - Vector3::new(5_000_001.0, 500_002.0, 97.0)).amax() < 1e-4, "{}", back(0));
        assert!((back(1) - Vector3::new(5_000_004.0, 500_005.0, 106.0)).amax() < 1e-4, "{}", back(1));
    }
}
