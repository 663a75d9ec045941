use super::*;
use crate::geometry::{Direction, Point};

/// The bytes of an NPY file as the format's description spells them. `descr` is Python.
fn npy(descr: &str, order: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

fn read_npy(bytes: &[u8]) -> Result<ScanFile> {
    read(Path::new("a.npy"), bytes, &ReadOptions { attributes: true, ..ReadOptions::default() })
}

fn cloud(bytes: &[u8]) -> PointCloud {
    read_npy(bytes).unwrap().scans.swap_remove(0).cloud
}

fn le(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn two() -> Vec<Point> {
    vec![Point::new(1.0, 2.0, 3.0), Point::new(4.0, 5.0, 6.0)]
}

#[test]
fn plain_arrays_in_either_order_and_in_half_precision() {
    let columns = le(&[1.0, 4.0, 2.0, 5.0, 3.0, 6.0, 9.0, 9.0]);
    assert_eq!(cloud(&npy("'<f4'", "True", "(2, 4)", &columns)).points, two());
    // 1 to 6 as binary16, big-endian.
    let halves = [0x3c00u16, 0x4000, 0x4200, 0x4400, 0x4500, 0x4600];
    let halves: Vec<u8> = halves.iter().flat_map(|h| h.to_be_bytes()).collect();
    assert_eq!(cloud(&npy("'>f2'", "False", "(2, 3)", &halves)).points, two());
    let grid = le(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    assert_eq!(cloud(&npy("'<f4'", "False", "(1, 2, 3)", &grid)).points, two());
    let array: Array = read_array(Path::new("a.npy"), "", &npy("'<f4'", "True", "(2, 4)", &columns)).unwrap();
    assert_eq!(array.values, [1.0, 2.0, 3.0, 9.0, 4.0, 5.0, 6.0, 9.0]);
}

#[test]
fn structured_arrays_have_coordinates_colours_intensities_and_normals() {
    // Fields out of order, a title, padding, and numbers of both byte orders.
    let descr = "[('label', '<U2'), ('z', '<f4'), (('height', 'y'), '>f4'), ('x', '<f4'), ('', '|V3'), \
                 ('intensity', '<f2'), ('r', '|u1'), ('g', '|u1'), ('b', '|u1'), ('normal', '<f4', (3,))]";
    let row = |x: f32, y: f32, z: f32| {
        let mut row = vec![b'#'; 8];
        row.extend([z.to_le_bytes(), y.to_be_bytes(), x.to_le_bytes()].concat());
        row.extend([7, 7, 7]);
        row.extend(0x3800u16.to_le_bytes());
        row.extend([1, 0, 1]);
        row.extend(le(&[0.0, 0.6, -0.8]));
        row
    };
    let data = [row(1.0, 2.0, 3.0), row(4.0, 5.0, 6.0)].concat();
    let bytes = npy(descr, "False", "(2,)", &data);
    let read_cloud = cloud(&bytes);
    assert_eq!(read_cloud.points, two());
    assert_eq!(read_cloud.colors, Some(vec![[1, 0, 1]; 2]));
    assert_eq!(read_cloud.intensities, Some(vec![0.5; 2]));
    assert_eq!(read_cloud.normals, Some(vec![Direction::new(0.0, 0.6, -0.8); 2]));
    let bare = read(Path::new("a.npy"), &bytes, &ReadOptions::default()).unwrap().scans.swap_remove(0).cloud;
    assert_eq!((bare.intensities, bare.normals), (None, None));

    let nested = "[('pose', [('xyz', '<f4', (3,)), ('t', '<f8')]), ('rgb', '<u4')]";
    let row = |p: [f32; 3]| [le(&p), vec![0; 8], 0x0012_3456u32.to_le_bytes().to_vec()].concat();
    let data = [row([1.0, 2.0, 3.0]), row([4.0, 5.0, 6.0])].concat();
    let read_cloud = cloud(&npy(nested, "False", "(2, 1)", &data));
    assert_eq!((read_cloud.points, read_cloud.colors), (two(), Some(vec![[0x12, 0x34, 0x56]; 2])));
}

#[test]
fn whole_numbers_are_warned_of() {
    let data: Vec<u8> = [1i16, 2, 3, 4, 5, 6].iter().flat_map(|v| v.to_le_bytes()).collect();
    let file = read_npy(&npy("'<i2'", "False", "(2, 3)", &data)).unwrap();
    assert_eq!(file.scans[0].cloud.points, two());
    assert!(file.notes[0].warning && file.notes[0].text.contains("--unit mm"));
}

#[test]
fn shapes_without_data_neither_loop_nor_allocate() {
    const HUGE: &str = "1152921504606846976";
    for (descr, shape) in [
        ("'<f4'", format!("({HUGE}, 0)")),
        ("'<f4'", format!("(0, {HUGE})")),
        ("'<f4'", format!("({HUGE}, {HUGE}, 0)")),
        ("'<f4'", format!("({HUGE}, 0, 3)")),
        ("[('x', '|V0'), ('y', '<f4', (0,))]", format!("({HUGE},)")),
        ("[]", format!("({HUGE},)")),
        ("[('x', '<f4', (4294967296, 4294967296))]", "(2,)".to_owned()),
    ] {
        for order in ["True", "False"] {
            let bytes = npy(descr, order, &shape, &[]);
            let points = read_npy(&bytes).map_or(0, |f| f.scans[0].cloud.len());
            assert_eq!(points, 0, "{descr} {shape}");
            let values = read_array(Path::new("a.npy"), "", &bytes).map_or(0, |a: Array| a.values.len());
            assert_eq!(values, 0, "{descr} {shape}");
        }
    }
}

#[test]
fn what_holds_no_points_is_no_scan_and_what_is_damaged_an_error() {
    let wrong = |bytes: Vec<u8>| read_npy(&bytes).unwrap_err();
    let no_fields = wrong(npy("[('a', '<f4')]", "False", "(2,)", &le(&[1.0, 2.0])));
    assert!(
        matches!(&no_fields, Error::NotAScan { found, .. } if found.contains("fields [a]")),
        "{no_fields}"
    );
    let table = wrong(npy("'<f4'", "False", "(2,)", &le(&[1.0, 2.0])));
    assert!(matches!(&table, Error::NotAScan { found, .. } if found.contains("shape [2]")), "{table}");
    let cut = wrong(npy("'<f4'", "False", "(2, 3)", &le(&[1.0; 5])));
    assert!(matches!(&cut, Error::File { found, .. } if found.contains("20 bytes")), "{cut}");
    // No literal, one that never ends, one that is too deep, and a length beyond the file.
    for header in
        ["{'descr': <f4}".to_owned(), "{'descr': [".to_owned(), format!("{{'descr': {}", "[".repeat(9000))]
    {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        assert!(wrong(bytes).to_string().contains("no NPY array"));
    }
    assert!(wrong(b"\x93NUMPY\x02\x00\xff\xff\xff\xff{".to_vec()).to_string().contains("no NPY array"));
}
