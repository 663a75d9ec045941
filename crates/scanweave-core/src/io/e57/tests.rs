use crate::geometry::{Point, RigidMotion};
use crate::io::{ReadOptions, ScanFile, read_cloud, read_file};
use ::e57::{E57Writer, Quaternion, Record, RecordDataType, RecordName, RecordValue, Transform, Translation};
use nalgebra::{Point3, Vector3};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
use std::path::Path;

const XYZ_F64: [Record; 3] = [Record::CARTESIAN_X_F64, Record::CARTESIAN_Y_F64, Record::CARTESIAN_Z_F64];

/// A shift, after a quarter turn about z.
fn quarter_turn([x, y, z]: [f64; 3]) -> Transform {
    Transform {
        rotation: Quaternion { w: FRAC_PI_4.cos(), x: 0.0, y: 0.0, z: FRAC_PI_4.sin() },
        translation: Translation { x, y, z },
    }
}

/// Writes a file of scans, each of its pose and its rows.
fn write(path: &Path, prototype: &[Record], scans: Vec<(Option<Transform>, Vec<Vec<RecordValue>>)>) {
    let mut file = E57Writer::from_file(path, "file").unwrap();
    for (number, (pose, rows)) in scans.into_iter().enumerate() {
        let mut scan = file.add_pointcloud(&format!("scan {number}"), prototype.to_vec()).unwrap();
        scan.set_transform(pose);
        rows.into_iter().for_each(|row| scan.add_point(row).unwrap());
        scan.finalize().unwrap();
    }
    file.finalize().unwrap();
}

fn doubles(row: &[f64]) -> Vec<RecordValue> {
    row.iter().map(|v| RecordValue::Double(*v)).collect()
}

fn read(prototype: &[Record], scans: Vec<(Option<Transform>, Vec<Vec<RecordValue>>)>) -> ScanFile {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.e57");
    write(&path, prototype, scans);
    read_file(&path, &ReadOptions { attributes: true, ..ReadOptions::default() }).unwrap()
}

fn near(points: &[Point], expected: &[[f32; 3]]) -> bool {
    points.len() == expected.len()
        && points.iter().zip(expected).all(|(p, e)| (p - Point::from(*e)).norm() < 1e-6)
}

#[test]
fn scans_stay_in_their_own_coordinates_beside_their_poses() {
    let colors = [Record::COLOR_RED_U8, Record::COLOR_GREEN_U8, Record::COLOR_BLUE_U8];
    let prototype = [XYZ_F64.to_vec(), colors.to_vec()].concat();
    let rows = |number: i64| -> Vec<Vec<RecordValue>> {
        let color = || [255, 128, number].map(RecordValue::Integer).to_vec();
        vec![
            [doubles(&[1.0, 2.0, 3.0 + number as f64]), color()].concat(),
            [doubles(&[-4.0, 5.0, 6.0]), color()].concat(),
        ]
    };
    let shifts = [[10.0, 20.0, 30.0], [0.0; 3], [-7.0, 0.5, 2.0]];
    let scans = (0..).zip(shifts).map(|(n, shift)| (Some(quarter_turn(shift)), rows(n))).collect();
    let file = read(&prototype, scans);
    assert_eq!((file.scans.len(), file.notes.len()), (3, 0));
    for (number, (scan, shift)) in file.scans.iter().zip(shifts).enumerate() {
        assert!(near(&scan.cloud.points, &[[1.0, 2.0, 3.0 + number as f32], [-4.0, 5.0, 6.0]]), "{number}");
        assert_eq!(scan.cloud.colors, Some(vec![[255, 128, number as u8]; 2]));
        assert_eq!(scan.cloud.viewpoint, Some(Point::origin()));
        // A quarter turn about z takes (x, y) to (-y, x).
        let world = scan.pose.unwrap() * Point3::new(1.0, 2.0, 3.0);
        assert!(
            (world.coords - (Vector3::new(-2.0, 1.0, 3.0) + Vector3::from(shift))).norm() < 1e-12,
            "{world}"
        );
    }
}

#[test]
fn returns_marked_as_invalid_are_dropped_and_intensities_keep_their_unit() {
    let prototype = [XYZ_F64.to_vec(), vec![Record::CARTESIAN_INVALID_STATE, Record::INTENSITY_U16]].concat();
    let row = |x: f64, state: i64, intensity: i64| {
        [doubles(&[x, 0.0, 1.0]), vec![RecordValue::Integer(state), RecordValue::Integer(intensity)]].concat()
    };
    let file = read(
        &prototype,
        vec![(None, vec![row(1.0, 0, 1000), row(2.0, 1, 2), row(3.0, 2, 3), row(4.0, 0, 65535)])],
    );
    let scan = &file.scans[0];
    assert!(near(&scan.cloud.points, &[[1.0, 0.0, 1.0], [4.0, 0.0, 1.0]]));
    assert_eq!(scan.cloud.dropped_rows, 2);
    assert_eq!(scan.cloud.intensities, Some(vec![1000.0, 65535.0]));
    // No pose and no angles: nothing says where the sensor stood. Intensities are no colours.
    assert_eq!((scan.pose, scan.cloud.viewpoint, &scan.cloud.colors), (None, None, &None));
}

#[test]
fn spherical_coordinates_are_converted_and_begin_at_the_sensor() {
    let prototype =
        [Record::SPHERICAL_AZIMUTH_F64, Record::SPHERICAL_ELEVATION_F64, Record::SPHERICAL_RANGE_F64];
    // Along y; straight up; and at 45° of azimuth and elevation: range 2 gives sqrt(2) up, 1 along x and y.
    let rows = [[FRAC_PI_2, 0.0, 3.0], [0.0, FRAC_PI_2, 5.0], [FRAC_PI_4, FRAC_PI_4, 2.0]];
    let file = read(&prototype, vec![(None, rows.iter().map(|row| doubles(row)).collect())]);
    let cloud = &file.scans[0].cloud;
    assert!(near(&cloud.points, &[[0.0, 3.0, 0.0], [0.0, 0.0, 5.0], [1.0, 1.0, std::f32::consts::SQRT_2]]));
    assert_eq!(cloud.viewpoint, Some(Point::origin()));
}

#[test]
fn georeferenced_points_are_not_seen_from_zero() {
    let rows: Vec<_> =
        (0..20).map(|i| doubles(&[431_250.0 + f64::from(i), 5_812_345.0 - f64::from(i), 100.0])).collect();
    let identity = || Transform::default();
    let file = read(&XYZ_F64, vec![(Some(identity()), rows.clone())]);
    let scan = &file.scans[0];
    assert_eq!(scan.cloud.viewpoint, None);
    assert!(file.notes[0].warning && file.notes[0].text.contains("far from its points"));
    assert_eq!(scan.pose, Some(RigidMotion::identity()));
    let back = scan.cloud.points[19].coords.cast::<f64>() + scan.cloud.origin_m;
    assert!((back - Vector3::new(431_269.0, 5_812_326.0, 100.0)).amax() < 1e-4);
}

#[test]
fn poses_that_are_no_poses_are_not_used() {
    let rows = vec![doubles(&[1.0, 0.0, 0.0]), doubles(&[-1.0, 0.0, 0.0])];
    let nothing =
        Transform { rotation: Quaternion { w: 0.0, x: 0.0, y: 0.0, z: 0.0 }, ..Transform::default() };
    let file = read(&XYZ_F64, vec![(Some(nothing), rows)]);
    assert_eq!(file.scans[0].pose, None);
    assert!(file.notes[0].text.contains("no rigid motion"));
}

/// The check sum of a page (Castagnoli's polynomial, reflected).
fn crc32c(page: &[u8]) -> u32 {
    !page.iter().fold(u32::MAX, |sum, byte| {
        (0..8).fold(sum ^ u32::from(*byte), |s, _| if s & 1 == 1 { s >> 1 ^ 0x82f6_3b78 } else { s >> 1 })
    })
}

#[test]
fn a_scan_without_varying_bytes_is_refused_and_not_made_up() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.e57");
    let whole = RecordDataType::ScaledInteger { min: 3, max: 9, scale: 1.0, offset: 0.0 };
    let names = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
    let prototype = names.map(|name| Record { name, data_type: whole.clone() });
    write(&path, &prototype, vec![(None, vec![vec![RecordValue::ScaledInteger(3); 3]; 5])]);
    assert_eq!(read_cloud(&path).unwrap().len(), 5);
    // The writer refuses such a file, so that it is made of another.
    let pages = std::fs::read(&path).unwrap();
    let mut content: Vec<u8> = pages.chunks(1024).flat_map(|page| &page[..1020]).copied().collect();
    let (wide, narrow) = (b"minimum=\"3\" maximum=\"9\"", b"minimum=\"3\" maximum=\"3\"");
    while let Some(at) = content.windows(wide.len()).position(|w| w == wide) {
        content[at..at + wide.len()].copy_from_slice(narrow);
    }
    let with_sum = |page: &[u8]| [page, &crc32c(page).to_be_bytes()].concat();
    std::fs::write(&path, content.chunks(1020).flat_map(with_sum).collect::<Vec<u8>>()).unwrap();
    let message = read_cloud(&path).unwrap_err().to_string();
    assert!(message.contains("one place only"), "{message}");
}

#[test]
fn a_file_that_is_cut_short_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.e57");
    write(&path, &XYZ_F64, vec![(None, vec![doubles(&[1.0, 2.0, 3.0]); 500])]);
    let whole = std::fs::read(&path).unwrap();
    for keep in [whole.len() / 2, whole.len() - 1024, 100, 20] {
        std::fs::write(&path, &whole[..keep]).unwrap();
        let message = read_cloud(&path).unwrap_err().to_string();
        assert!(message.contains("a.e57: found an E57 file that cannot be decoded"), "{message}");
    }
}

#[test]
fn an_empty_scan_beside_others_keeps_its_place() {
    let pose = || Some(quarter_turn([1.0, 2.0, 3.0]));
    let file = read(&XYZ_F64, vec![(pose(), vec![]), (pose(), vec![doubles(&[1.0, 2.0, 3.0]); 2])]);
    assert_eq!(file.scans.iter().map(|s| s.cloud.len()).collect::<Vec<_>>(), [0, 2]);
    assert!(file.scans[1].pose.is_some());
}

#[test]
fn points_at_zero_are_no_returns_and_angles_may_go_around() {
    // Scans without a field for invalid points have zeros in their place.
    let rows =
        [[0.0; 3], [431_250.0, 5_812_345.0, 100.0], [0.0; 3], [431_251.0, 5_812_345.0, 100.0], [0.0; 3]];
    let file = read(&XYZ_F64, vec![(None, rows.iter().map(|row| doubles(row)).collect())]);
    let cloud = &file.scans[0].cloud;
    assert_eq!((cloud.len(), cloud.dropped_rows), (2, 3));
    // The zeros must not keep the coordinates at a size that single precision cannot hold.
    assert!((cloud.points[1] - cloud.points[0] - Vector3::new(1.0, 0.0, 0.0)).norm() < 1e-4);
    let prototype =
        [Record::SPHERICAL_AZIMUTH_F64, Record::SPHERICAL_ELEVATION_F64, Record::SPHERICAL_RANGE_F64];
    let turned = [[-4.0 * FRAC_PI_2, 0.0, 3.0], [5.0 * FRAC_PI_2, 0.0, 2.0]];
    let file = read(&prototype, vec![(None, turned.iter().map(|row| doubles(row)).collect())]);
    assert!(near(&file.scans[0].cloud.points, &[[3.0, 0.0, 0.0], [0.0, 2.0, 0.0]]));
}

/// Normals are those of the extension, of the valid points alone; whole and in blocks the same.
#[test]
fn normals_of_the_extension_are_read() {
    let named = |name: &str, data_type| Record {
        name: RecordName::Unknown { namespace: "nor".to_owned(), name: name.to_owned() },
        data_type,
    };
    let half = RecordDataType::ScaledInteger { min: -2, max: 2, scale: 0.5, offset: 0.0 };
    let prototype = [
        XYZ_F64.to_vec(),
        vec![
            Record {
                name: RecordName::CartesianInvalidState,
                data_type: RecordDataType::Integer { min: 0, max: 2 },
            },
            named("normalZ", RecordDataType::F32),
            named("normalX", half),
            named("normalY", RecordDataType::F64),
        ],
    ]
    .concat();
    let row = |xyz: [f64; 3], invalid: i64, [x, y, z]: [f64; 3]| {
        let rest = [
            RecordValue::Integer(invalid),
            RecordValue::Single(z as f32),
            RecordValue::ScaledInteger((2.0 * x) as i64),
            RecordValue::Double(y),
        ];
        [doubles(&xyz), rest.to_vec()].concat()
    };
    let rows = vec![
        row([1.0, 2.0, 3.0], 0, [0.0, 0.6, 0.8]),
        row([9.0, 9.0, 9.0], 2, [1.0, 0.0, 0.0]),
        row([-4.0, 5.0, 6.0], 0, [-0.5, 0.5, 0.0]),
        row([-4.0, 5.0, 7.0], 0, [-1.0, 0.0, 0.0]),
    ];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.e57");
    let mut file = E57Writer::from_file(&path, "file").unwrap();
    file.register_extension(::e57::Extension::new(
        "nor",
        "http://www.libe57.org/E57_NOR_surface_normals.txt",
    ))
    .unwrap();
    let mut scan = file.add_pointcloud("scan", prototype).unwrap();
    rows.into_iter().for_each(|row| scan.add_point(row).unwrap());
    scan.finalize().unwrap();
    file.finalize().unwrap();

    let expected = [[0.0f32, 0.6, 0.8], [-0.5, 0.5, 0.0], [-1.0, 0.0, 0.0]].map(nalgebra::Vector3::from);
    let with = ReadOptions { attributes: true, ..ReadOptions::default() };
    let whole = read_file(&path, &with).unwrap();
    let cloud = &whole.scans[0].cloud;
    assert!(near(&cloud.points, &[[1.0, 2.0, 3.0], [-4.0, 5.0, 6.0], [-4.0, 5.0, 7.0]]));
    assert_eq!(cloud.normals.as_deref(), Some(&expected[..]));
    let mut blocks = super::blocks::open(&path, 0, &with).unwrap().unwrap();
    let mut found = Vec::new();
    let mut take = |block: crate::scan::PointCloud| {
        found.extend(block.normals.unwrap());
        Ok(())
    };
    blocks.for_each(&mut take).unwrap();
    assert_eq!(found, expected);
    // Registration does not need them.
    let without = read_file(&path, &ReadOptions::default()).unwrap();
    assert_eq!(without.scans[0].cloud.normals, None);
}
