//! Every cloud format: round trips against independent writers, odd headers, damaged files.

use ply_rs_bw::ply::{
    Addable, DefaultElement, ElementDef, Encoding, Ply, Property, PropertyDef, PropertyType, ScalarType,
};
use proptest::prelude::*;
use scanweave::geometry::Point;
use scanweave::io::{PlyCloud, read_cloud, write_ply};
use scanweave::scan::PointCloud;
use std::path::PathBuf;
use tempfile::TempDir;

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn save(dir: &TempDir, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = dir.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

fn read(name: &str, bytes: impl AsRef<[u8]>) -> PointCloud {
    let dir = folder();
    read_cloud(save(&dir, name, bytes)).unwrap()
}

fn failure(name: &str, bytes: impl AsRef<[u8]>) -> String {
    let dir = folder();
    let message = read_cloud(save(&dir, name, bytes)).unwrap_err().to_string();
    assert!(message.contains(name), "the file is not named: {message}");
    message
}

fn pts(rows: &[[f32; 3]]) -> Vec<Point> {
    rows.iter().map(|&r| Point::from(r)).collect()
}

/// A PLY by ply-rs-bw: a camera element before the vertices, faces after them, doubles, a list property
/// in the vertex rows where `list` is set.
fn foreign_ply(rows: &[[f64; 3]], encoding: Encoding, list: bool) -> Vec<u8> {
    let mut ply = Ply::<DefaultElement>::new();
    ply.header.encoding = encoding;
    ply.header.comments.push("made for a test".into());
    let scalar = |name: &str, t: ScalarType| PropertyDef::new(name.into(), PropertyType::Scalar(t));
    let lists =
        |name: &str, t: ScalarType| PropertyDef::new(name.into(), PropertyType::List(ScalarType::UChar, t));
    let mut camera = ElementDef::new("camera".into());
    camera.properties.add(scalar("view", ScalarType::Short));
    camera.properties.add(lists("lens", ScalarType::Float));
    let mut vertex = ElementDef::new("vertex".into());
    vertex.properties.add(scalar("confidence", ScalarType::Float));
    vertex.properties.add(scalar("z", ScalarType::Double));
    if list {
        vertex.properties.add(lists("seen_by", ScalarType::Int));
    }
    vertex.properties.add(scalar("x", ScalarType::Double));
    vertex.properties.add(scalar("y", ScalarType::Double));
    vertex.properties.add(scalar("red", ScalarType::UChar));
    vertex.properties.add(scalar("green", ScalarType::UChar));
    vertex.properties.add(scalar("blue", ScalarType::UChar));
    let mut face = ElementDef::new("face".into());
    face.properties.add(lists("vertex_indices", ScalarType::Int));
    for element in [camera, vertex, face] {
        ply.header.elements.add(element);
    }
    let element = |values: Vec<(&str, Property)>| {
        let mut e = DefaultElement::new();
        values.into_iter().for_each(|(k, v)| {
            e.insert(k.into(), v);
        });
        e
    };
    let cameras =
        vec![element(vec![("view", Property::Short(-7)), ("lens", Property::ListFloat(vec![1.5, 2.5]))])];
    let vertices = rows.iter().enumerate().map(|(i, r)| {
        let mut values = vec![
            ("confidence", Property::Float(0.25)),
            ("x", Property::Double(r[0])),
            ("y", Property::Double(r[1])),
            ("z", Property::Double(r[2])),
            ("red", Property::UChar(i as u8)),
            ("green", Property::UChar(200)),
            ("blue", Property::UChar(255)),
        ];
        if list {
            values.push(("seen_by", Property::ListInt((0..i as i32 % 4).collect())));
        }
        element(values)
    });
    ply.payload.insert("vertex".into(), vertices.collect());
    ply.payload.insert("camera".into(), cameras);
    ply.payload
        .insert("face".into(), vec![element(vec![("vertex_indices", Property::ListInt(vec![0, 0, 0]))])]);
    let mut bytes = Vec::new();
    ply_rs_bw::writer::Writer::new().write_ply(&mut bytes, &mut ply).unwrap();
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn ply_of_another_writer(
        rows in prop::collection::vec(prop::array::uniform3(-900.0f64..900.0), 1..30),
        kind in 0..3usize,
        list: bool,
    ) {
        let encoding = [Encoding::Ascii, Encoding::BinaryLittleEndian, Encoding::BinaryBigEndian][kind];
        let cloud = read("a.ply", foreign_ply(&rows, encoding, list));
        // Exact: a double in text is read back as itself, and both sides round it to f32 once.
        let expected: Vec<Point> = rows.iter().map(|r| Point::from(r.map(|v| v as f32))).collect();
        prop_assert_eq!(cloud.points, expected);
        let colors: Vec<[u8; 3]> = (0..rows.len()).map(|i| [i as u8, 200, 255]).collect();
        prop_assert_eq!(cloud.colors, Some(colors));
    }

    #[test]
    fn own_ply_round_trip(rows in prop::collection::vec(prop::array::uniform3(-9e3f32..9e3), 0..50), colored: bool, numbered: bool) {
        let points = pts(&rows);
        let colors: Vec<[u8; 3]> = (0..rows.len()).map(|i| [i as u8, 7, 250]).collect();
        let scans: Vec<i32> = (0..rows.len() as i32).collect();
        let dir = folder();
        let path = dir.path().join("m.ply");
        let cloud = PlyCloud { points: &points, colors: colored.then_some(&colors), scans: numbered.then_some(&scans), ..PlyCloud::default() };
        write_ply(&path, &cloud).unwrap();
        let back = read_cloud(&path).unwrap();
        prop_assert_eq!(&back.points, &points);
        prop_assert_eq!(back.colors, colored.then_some(colors));
        // What we write is what another reader understands, the scan property too.
        let mut file = std::fs::File::open(&path).unwrap();
        let other = ply_rs_bw::parser::Parser::<DefaultElement>::new().read_ply(&mut file).unwrap();
        prop_assert_eq!(other.payload["vertex"].len(), rows.len());
        if numbered && !rows.is_empty() {
            prop_assert_eq!(&other.payload["vertex"][rows.len() - 1]["scan"], &Property::Int(rows.len() as i32 - 1));
        }
    }

    /// Bytes flipped or cut anywhere give an error or a cloud, never a panic.
    #[test]
    fn damage_never_panics(kind in 0..5usize, cut in 0.0..1.0f64, at in 0.0..1.0f64, value: u8) {
        let rows: Vec<[f64; 3]> = (0..20).map(|i| [f64::from(i), 2.0, 3.0]).collect();
        let (name, mut bytes) = match kind {
            0 => ("a.ply", foreign_ply(&rows, Encoding::Ascii, true)),
            1 => ("a.ply", foreign_ply(&rows, Encoding::BinaryLittleEndian, true)),
            2 => ("a.pcd", foreign_pcd("line_binary_compressed")),
            3 => ("a.pcd", foreign_pcd("line_binary")),
            _ => ("a.npz", npz()),
        };
        let place = (at * bytes.len() as f64) as usize;
        bytes[place] = value;
        bytes.truncate((cut * 1.3 * bytes.len() as f64) as usize);
        let dir = folder();
        read_cloud(save(&dir, name, &bytes)).ok();
    }
}

const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";

#[test]
fn ply_headers_as_they_come() {
    let expected = pts(&[[1.0, -2.5, 3e-3], [0.5, 5.0, 6.0]]);
    let rows = "1 -2.5 3e-3\n.5 5. +6 \n";
    let head = |extra: &str| format!("ply\nformat ascii 1.0\n{extra}element vertex 2\n{XYZ}");
    let plain = format!("{}end_header\n{rows}", head(""));
    let variants = [
        plain.clone(),
        plain.replace('\n', "\r\n"),
        plain.replace('\n', "\r"),
        format!(
            "{}end_header\n{rows}",
            head("comment\ncomment ü: element vertex 9\nobj_info num_cols 512\nunknown_keyword a b\n")
        ),
        format!(
            "{}element range_grid 4\nproperty list uchar int vertex_indices\nend_header\n{rows}1 0\n0\n0\n1 1\n",
            head("")
        ),
        format!(
            "{}element face 1\nproperty list uchar int vertex_indices\nend_header\n{rows}3 0 1 1\n",
            head("")
        ),
        plain.replace("\n1 -2.5", "\n\n  \n1\t-2.5"),
        plain.trim_end().to_owned(),
    ];
    for text in variants {
        let cloud = read("a.ply", &text);
        assert_eq!(cloud.points, expected, "{text}");
        assert_eq!((cloud.colors, cloud.dropped_rows), (None, 0));
    }
}

#[test]
fn binary_ply_after_each_line_end() {
    for end in ["\n", "\r\n", "\r"] {
        let header = format!("ply\nformat binary_little_endian 1.0\nelement vertex 1\n{XYZ}end_header\n");
        let mut bytes = header.replace('\n', end).into_bytes();
        // The first byte of the data is 10, a line feed, on purpose.
        for v in [f32::from_le_bytes([10, 0, 128, 63]), 2.0, 3.0] {
            bytes.extend(v.to_le_bytes());
        }
        assert_eq!(read("a.ply", &bytes).points, pts(&[[f32::from_bits(0x3f80_000a), 2.0, 3.0]]), "{end:?}");
    }
}

#[test]
fn not_a_number_in_every_spelling_is_dropped_and_counted() {
    let text = format!(
        "ply\nformat ascii 1.0\nelement vertex 9\n{XYZ}end_header\nnan nan nan\n1 2 3\nNaN 0 0\n0 -nan 0\n0 0 -nan(ind)\n\
         1.#QNAN 0 0\ninf 0 0\n0 -inf 0\n4 5 6\n"
    );
    let cloud = read("a.ply", text);
    assert_eq!(cloud.points, pts(&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]));
    assert_eq!(cloud.dropped_rows, 7);
}

#[test]
fn ply_colours_as_floats_and_16_bits() {
    let with = |kind: &str, colors: &str| {
        let names = ["red", "green", "blue"].map(|c| format!("property {kind} {c}\n")).concat();
        let text = format!(
            "ply\nformat ascii 1.0\nelement vertex 2\n{XYZ}{names}end_header\n1 2 3 {colors}\n4 5 6 0 0 0\n"
        );
        read("a.ply", text).colors.unwrap()[0]
    };
    assert_eq!(with("uchar", "1 0 1"), [1, 0, 1], "bytes are not fractions");
    assert_eq!(with("float", "0.2 1 0.4"), [51, 255, 102]);
    assert_eq!(with("float", "51 255 102"), [51, 255, 102]);
    assert_eq!(with("ushort", "13107 65535 26214"), [51, 255, 102]);
}

#[test]
fn truncated_and_miscounted_ply_say_what_was_found() {
    let points = pts(&[[1.0, 2.0, 3.0]; 100]);
    let dir = folder();
    let path = dir.path().join("cut.ply");
    write_ply(&path, &PlyCloud { points: &points, ..PlyCloud::default() }).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    // 100 rows of 12 bytes less 500 bytes: 700 bytes, 58 whole rows.
    let message = failure("cut.ply", &bytes[..bytes.len() - 500]);
    assert!(message.contains("700 bytes with 58 of 100 complete vertex rows"), "{message}");
    assert!(message.contains("1200 bytes with 100 rows"), "{message}");
    let mut longer = bytes.clone();
    longer.extend([1; 24]);
    let message = failure("long.ply", &longer);
    assert!(message.contains("24 bytes after the vertex rows") && message.contains("100 rows"), "{message}");
    let mut padded = bytes.clone();
    padded.extend([0; 24]);
    assert_eq!(read("padded.ply", &padded).len(), 100);

    let text = format!("ply\nformat ascii 1.0\nelement vertex 3\n{XYZ}end_header\n1 2 3\n4 5 6\n");
    assert!(failure("a.ply", &text).contains("2 of 3 complete vertex rows"));
    assert!(
        failure("b.ply", text.replace("vertex 3", "vertex 1")).contains("3 values after the vertex rows")
    );
    assert!(failure("c.ply", text.replace("4 5 6", "4 5")).contains("1 of 3 complete vertex rows"));
    assert!(failure("d.ply", text.replace("4 5 6", "4 five 6")).contains("vertex row 2"));
    assert!(failure("e.ply", text.replace("vertex 3", "vertex -3")).contains("'element vertex -3'"));
    assert!(failure("f.ply", text.replace("vertex", "point")).contains("elements [point]"));
    assert!(failure("g.ply", text.replace("float z", "float w")).contains("vertex properties [x, y, w]"));
    assert!(failure("h.ply", text.replace("float z", "quad z")).contains("'property quad z'"));
    assert!(failure("i.ply", &text[..60]).contains("without end_header"));
    assert!(failure("j.ply", text.replace("format ascii 1.0\n", "")).contains("without a format line"));
    // Counts whose bytes cannot be addressed must not be reserved.
    let huge =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n{XYZ}end_header\n", usize::MAX);
    assert!(failure("k.ply", huge).contains("0 of 18446744073709551615"));
}

/// A PCD by pypcd4 (scripts/pcd_fixtures.py): a tag, x y z and a packed colour.
fn foreign_pcd(name: &str) -> Vec<u8> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/pcd");
    std::fs::read(folder.join(format!("{name}.pcd"))).unwrap()
}

#[test]
fn pcd_of_another_writer_in_all_three_encodings() {
    let rows: Vec<[f64; 3]> = (0..200).map(|i| [f64::from(i) * 0.1, -2.0, f64::from(i % 7)]).collect();
    let expected: Vec<Point> = rows.iter().map(|r| Point::from(r.map(|v| v as f32))).collect();
    let colors: Vec<[u8; 3]> = (0..200).map(|i| [i as u8, 0x10, 0x20]).collect();
    for kind in ["ascii", "binary", "binary_compressed"] {
        let cloud = read("a.pcd", foreign_pcd(&format!("grid_{kind}")));
        assert_eq!(cloud.points, expected, "{kind}");
        assert_eq!(cloud.colors.as_ref(), Some(&colors), "{kind}");
    }
}

fn pcd(fields: &str, size: &str, kind: &str, extra: &str, points: usize, data: &str) -> String {
    let count = fields.split(' ').map(|_| "1").collect::<Vec<_>>().join(" ");
    format!(
        "# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {kind}\nCOUNT {count}\nWIDTH {points}\nHEIGHT 1\n\
         {extra}POINTS {points}\nDATA ascii\n{data}"
    )
}

#[test]
fn pcd_viewpoint_colour_and_nan() {
    let red = f32::from_bits(0x00ff_0000);
    let text = pcd(
        "x y z rgb",
        "4 4 4 4",
        "F F F F",
        "VIEWPOINT 1 2 3 1 0 0 0\n",
        3,
        &format!("1 2 3 {red:e}\nnan nan nan 0\n4 5 6 {:e}\n", f32::from_bits(0x0001_0203)),
    );
    let cloud = read("a.pcd", &text);
    assert_eq!(cloud.points, pts(&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]));
    assert_eq!(cloud.colors, Some(vec![[255, 0, 0], [1, 2, 3]]));
    assert_eq!((cloud.viewpoint, cloud.dropped_rows), (Some(Point::new(1.0, 2.0, 3.0)), 1));
    // COUNT and POINTS may be missing; CR LF; an integer colour.
    let integer = text.replace("F F F F", "F F F U").replace("COUNT 1 1 1 1\n", "").replace("POINTS 3\n", "");
    let integer = integer
        .replace(&format!("{red:e}"), &0x00ff_0000u32.to_string())
        .replace(&format!("{:e}", f32::from_bits(0x10203)), "66051");
    let cloud = read("b.pcd", integer.replace('\n', "\r\n"));
    assert_eq!(cloud.colors, Some(vec![[255, 0, 0], [1, 2, 3]]));
}

#[test]
fn damaged_pcd_say_what_was_found() {
    // A row is 1 + 4 + 8 + 4 + 4 = 21 bytes.
    let binary = foreign_pcd("same_binary");
    let message = failure("a.pcd", &binary[..binary.len() - 30]);
    assert!(message.contains("1020 bytes of data with 48 complete points"), "{message}");
    assert!(message.contains("1050 bytes with 50 points"), "{message}");
    let mut long = binary.clone();
    long.extend([7; 46]);
    assert!(failure("l.pcd", &long).contains("52 complete points"));
    let packed = foreign_pcd("same_binary_compressed");
    assert!(failure("b.pcd", &packed[..packed.len() - 5]).contains("bytes of compressed data"));

    let text = pcd("x y z", "4 4 4", "F F F", "", 3, "1 2 3\n4 5 6\n");
    assert!(failure("c.pcd", &text).contains("found 2 rows, expected 3 rows"));
    assert!(failure("d.pcd", text.replace("POINTS 3", "POINTS 1")).contains("found 2 rows, expected 1 rows"));
    assert!(failure("e.pcd", text.replace("4 5 6", "4 5")).contains("row 2 '4 5'"));
    assert!(failure("f.pcd", text.replace("x y z", "a b c")).contains("fields [a, b, c]"));
    assert!(failure("g.pcd", text.replace("SIZE 4 4 4", "SIZE 4 4")).contains("[3, 2, 3, 3] entries"));
    assert!(failure("h.pcd", text.replace("TYPE F F F", "TYPE F F Q")).contains("TYPE Q and SIZE 4"));
    assert!(failure("i.pcd", text.replace("DATA ascii", "DATA zip")).contains("DATA zip"));
    assert!(failure("j.pcd", &text[..70]).contains("without a DATA line"));
    let huge =
        text.replace("POINTS 3", &format!("POINTS {}", usize::MAX)).replace("DATA ascii", "DATA binary");
    assert!(failure("k.pcd", huge).contains("18446744073709551615 points"));
}

/// A text with its last two rows six times: fewer than ten rows are no scan.
fn six_times(text: &str) -> String {
    let lines: Vec<&str> = text.lines().collect();
    let (head, rows) = lines.split_at(lines.len() - 2);
    let rows: Vec<&str> = rows.repeat(6).into_iter().filter(|l| !l.trim().is_empty()).collect();
    format!("{}\n{}", head.join("\n"), rows.join("\n")).trim_start_matches('\n').to_owned()
}

#[test]
fn text_clouds_as_they_come() {
    let expected = pts(&[[1.5, 2.0, 3.0], [4.0, 5.0, -6.25]].repeat(6));
    let variants = [
        ("a.xyz", "1.5 2 3\n4 5 -6.25\n"),
        ("a.txt", "# x y z\n// note\n\r\n1.5\t2\t3\r\n4\t5\t-6.25"),
        ("a.csv", "x,y,z\n1.5,2,3\n4,5,-6.25\n"),
        ("a.csv", "\"label\", \"Z\", \"X\", \"Y\"\n0, 3, 1.5, 2\n0, -6.25, 4, 5\n"),
        ("a.csv", "x;y;z\n1.5;2;3\n4;5;-6.25\n"),
        ("a.csv", "1,5;2;3,0\n4,0;5;-6,25\n"),
        ("a.pts", "12\n1.5 2 3\n4 5 -6.25\n"),
        ("a.PTS", "\u{feff}12\r\n1.5 2 3 0.1\r\n4 5 -6.25 0.2\r\n"),
        ("a.asc", "1.5 2 3 wall\n4 5 -6.25 floor\n"),
        ("a.xyzn", "1.5 2 3 0 0 1\n4 5 -6.25 0 1 0\n"),
        ("a.xyz", "1.5 2 3 0.5 0.5 0.7\n4 5 -6.25 0 1 0\n"),
    ];
    for (name, text) in variants {
        let cloud = read(name, six_times(text));
        assert_eq!((cloud.points, cloud.colors), (expected.clone(), None), "{text}");
    }
    let colored = [
        ("a.xyz", "1.5 2 3 10 20 30\n4 5 -6.25 0 0 255\n"),
        ("a.pts", "12\n1.5 2 3 -1200 10 20 30\n4 5 -6.25 7 0 0 255\n"),
        ("a.csv", "b,g,r,x,y,z\n30,20,10,1.5,2,3\n255,0,0,4,5,-6.25\n"),
    ];
    for (name, text) in colored {
        let cloud = read(name, six_times(text));
        assert_eq!(
            (cloud.points, cloud.colors),
            (expected.clone(), Some([[10, 20, 30], [0, 0, 255]].repeat(6))),
            "{text}"
        );
    }
    assert_eq!(read("a.xyz", six_times("1 2 3\nnan nan nan\n")).dropped_rows, 6);
}

#[test]
fn damaged_text_says_where() {
    let rows = six_times("1 2 3\n4 5 6\n");
    // Fewer rows than the count says are read: only a last row that is cut shows that the file is.
    assert!(failure("a.pts", format!("30\n{rows}\n4 5")).contains("a last row cut short, line 14: 2 fields"));
    assert!(failure("a.xyz", format!("{rows}\n4 5\n")).contains("line 13 '4 5'"));
    assert!(failure("a.xyz", format!("{rows}\n4 five 6\n")).contains("line 13 '4 five 6'"));
    assert!(failure("a.csv", six_times("a,b,c\n1,2,3\n4,5,6\n")).contains("columns [a, b, c]"));
    assert!(failure("a.xyz", "1 2 3\n4 5 6\n").contains("a table of 2 rows"));
    assert!(failure("a.txt", b"\0\x01\x02").contains("begins with"));
}

/// The bytes of an NPY file, spelled out as the format's description has them.
fn npy(descr: &str, order: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}");
    while !(header.len() + 11).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

fn npz() -> Vec<u8> {
    let mut npz = ndarray_npy::NpzWriter::new_compressed(std::io::Cursor::new(Vec::new()));
    npz.add_array("faces", &ndarray::array![[0i32, 1, 2, 3]]).unwrap();
    npz.add_array("xyz", &ndarray::array![[1.0f64, 2.0, 3.0], [4.0, f64::NAN, 6.0]]).unwrap();
    npz.finish().unwrap().into_inner()
}

#[test]
fn numpy_arrays() {
    let expected = pts(&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    let values = [1.0f64, 2.0, 3.0, 4.0, 5.0, 6.0];
    let le8: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let be4: Vec<u8> = values.iter().flat_map(|v| (*v as f32).to_be_bytes()).collect();
    let columns: Vec<u8> =
        [0, 3, 1, 4, 2, 5].iter().flat_map(|&i: &usize| (values[i] as f32).to_le_bytes()).collect();
    for bytes in [
        npy("<f8", "False", "(2, 3)", &le8),
        npy(">f4", "False", "(2, 3)", &be4),
        npy("<f4", "True", "(2, 3)", &columns),
    ] {
        assert_eq!(read("a.npy", bytes).points, expected);
    }
    let wide = ndarray::array![[1.0f32, 2.0, 3.0, 9.0], [4.0, 5.0, 6.0, 9.0]];
    let mut bytes = Vec::new();
    ndarray_npy::WriteNpyExt::write_npy(&wide, &mut bytes).unwrap();
    assert_eq!(read("a.npy", bytes).points, expected);
    let cloud = read("a.npz", npz());
    assert_eq!((cloud.points, cloud.dropped_rows), (pts(&[[1.0, 2.0, 3.0]]), 1));

    assert!(
        failure("b.npy", npy("<f8", "False", "(2, 3)", &le8[..40]))
            .contains("40 bytes of data, expected 48 bytes")
    );
    assert!(
        failure("b.npy", npy("<f8", "False", "(9999999999999, 3)", &le8))
            .contains("expected 239999999999976 bytes")
    );
    assert!(failure("b.npy", npy("<f8", "False", "(3, 2)", &le8)).contains("shape [3, 2]"));
    assert!(failure("b.npy", npy("<c8", "False", "(2, 3)", &le8)).contains("'<c8'"));
    let zip = npz();
    assert!(failure("b.npz", &zip[..zip.len() - 30]).contains("damaged archive"));
}

#[test]
fn what_is_no_scan_at_all() {
    assert!(failure("a.ply", "").contains("an empty file"));
    assert!(failure("a.ply", "hello there").contains("begins with 'hello there'"));
    assert!(failure("noextension", "1 2 3\n").contains("plain text needs the extension"));
    // The content decides: a PLY by another name is read as one.
    let ply = format!("ply\nformat ascii 1.0\nelement vertex 1\n{XYZ}end_header\n1 2 3\n");
    assert_eq!(read("a.pcd", ply).len(), 1);
    let dir = folder();
    let missing = dir.path().join("missing.ply");
    assert!(matches!(read_cloud(&missing), Err(scanweave::Error::Read { path, .. }) if path == missing));
    assert!(read_cloud(dir.path()).unwrap_err().to_string().contains("found a folder, expected a scan file"));
}

#[test]
fn files_of_scanners_that_end_after_their_signature() {
    assert!(failure("a.laz", "LASF\0\0").contains("a LAS file that cannot be decoded"));
    assert!(failure("a.e57", "ASTM-E57\0").contains("an E57 file that cannot be decoded"));
}
