use super::*;
use crate::geometry::{Direction, Point};
use crate::scan::PointCloud;

fn read_as(name: &str, bytes: impl AsRef<[u8]>) -> Result<ScanFile> {
    let options = ReadOptions { attributes: true, ..ReadOptions::default() };
    read(Path::new(name), Path::new(name), bytes.as_ref(), &options)
}

fn cloud(name: &str, bytes: impl AsRef<[u8]>) -> PointCloud {
    read_as(name, bytes).unwrap().scans.swap_remove(0).cloud
}

fn failure(name: &str, bytes: impl AsRef<[u8]>) -> String {
    read_as(name, bytes).unwrap_err().to_string()
}

fn points(rows: &[[f32; 3]]) -> Vec<Point> {
    rows.iter().copied().map(Point::from).collect()
}

#[test]
fn meshes_are_told_by_extension_and_glb_by_its_first_bytes() {
    for name in ["a.obj", "a.OFF", "a.Stl", "a.gltf"] {
        assert!(is_mesh(Path::new(name), b"anything"), "{name}");
    }
    assert!(is_mesh(Path::new("a"), b"glTF...."));
    assert!(!is_mesh(Path::new("a.ply"), b"ply\n") && !is_mesh(Path::new("a.glb"), b"nothing"));
}

#[test]
fn obj_vertices_with_colours_and_normals() {
    let text = "# v 9 9 9\nmtllib a.mtl\no thing\nv -1.5 2e-1 3\nvt 0 0\nv 4 5 6 # a comment\r\nvn 0 0.6 -0.8\nvn 1 0 0\n";
    let read_cloud = cloud("a.obj", text);
    assert_eq!(read_cloud.points, points(&[[-1.5, 0.2, 3.0], [4.0, 5.0, 6.0]]));
    assert_eq!(read_cloud.normals, Some(vec![Direction::new(0.0, 0.6, -0.8), Direction::x()]));
    assert!(read_as("a.obj", text).unwrap().notes.is_empty(), "points without surfaces are a cloud");
    let bare =
        read(Path::new("a.obj"), Path::new("a.obj"), text.as_bytes(), &ReadOptions::default()).unwrap();
    assert_eq!(bare.scans[0].cloud.normals, None);

    let with = |a: &str, b: &str| cloud("a.obj", format!("v 1 2 3 {a}\nv 4 5 6 {b}\nvn 0 0 1\nf 1 2 1\n"));
    assert_eq!(with("0 0.5 1", "1 1 1").colors, Some(vec![[0, 128, 255], [255; 3]]));
    assert_eq!(with("0 128 255", "1 1 1").colors, Some(vec![[0, 128, 255], [1; 3]]));
    assert_eq!(
        with("1.0 0 0.5 1", "1.0 1 1 1").colors,
        Some(vec![[0, 128, 255], [255; 3]]),
        "after a weight"
    );
    let (weights, half) = (with("1.0", "1.0"), with("0 0.5 1", ""));
    assert_eq!((weights.colors, half.colors), (None, None));
    assert_eq!(weights.normals, None, "one normal for two vertices");

    let file = read_as("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    assert!(!file.notes[0].warning && file.notes[0].text.contains("its vertices are taken as points"));
    assert!(failure("a.obj", "v 1 2 3\nv 1 two 3\n").contains("line 2 'v 1 two 3'"));
    let object = read_as("a.obj", [0x64, 0x86, 0, 0, 1]).unwrap_err();
    assert!(matches!(object, Error::NotAScan { .. }), "{object}");
}

#[test]
fn off_with_comments_counts_on_either_line_normals_and_colours() {
    let expected = points(&[[0.0, 0.0, 0.5], [1.0, -1e-2, 0.0]]);
    for text in [
        "OFF\n2 0 0\n0 0 .5\n1 -1e-2 0\n",
        "OFF 2 0 0\n0 0 .5\n1 -1e-2 0",
        "# made by hand\nOFF # text\n\n# counts\n2 0 0 # none\n0 0 .5 # one\n\n1 -1e-2 0\r\n",
        "2 0 0\n0 0 .5\n1 -1e-2 0\n",
        "NOFF\n2 0 0\n0 0 .5 0 0 1\n1 -1e-2 0 0 0 1\n",
    ] {
        let file = read_as("a.off", text).unwrap();
        assert_eq!((&file.scans[0].cloud.points, file.notes.len()), (&expected, 0), "{text}");
    }
    let colors = Some(vec![[255, 0, 10], [1, 2, 3]]);
    let read_cloud = cloud("a.off", "COFF\n2 1 0\n0 0 .5 255 0 10 255\n1 -.01 0 1 2 3 255\n3 0 1 0\n");
    assert_eq!((&read_cloud.points, &read_cloud.colors), (&expected, &colors));
    let read_cloud = cloud("a.off", "CNOFF\n2 1 0\n0 0 .5 0 0 1 255 0 10\n1 -.01 0 0 0 1 1 2 3\n2 0 1\n");
    assert_eq!((read_cloud.points, read_cloud.colors), (expected, colors));

    assert!(
        failure("a.off", "OFF\n3 1 0\n0 0 0\n1 1 1\n").contains("2 vertex lines, expected 3 vertex lines")
    );
    assert!(failure("a.off", "OFF\n18446744073709551615 1 0\n0 0 0\n").contains("found 1 vertex line"));
    assert!(failure("a.off", "OFF\n1 1 0\n0 0\n").contains("line 3 '0 0'"));
    assert!(failure("a.off", "OFF BINARY\n").contains("OFF BINARY"));
    assert!(failure("a.off", "4OFF\n1 0 0\n0 0 0 1\n").contains("4OFF"));
    assert!(failure("a.off", "OFF\n").contains("no line after the first"));
    assert!(matches!(read_as("a.off", "hello\n"), Err(Error::NotAScan { .. })));
}

/// Two triangles that share an edge; one of the shared corners has a zero of the other sign.
const CORNERS: [[f32; 3]; 6] =
    [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [1.0, -0.0, 0.0], [0.0, 2.0, 0.0], [1.0, 2.0, 0.5]];

#[test]
fn stl_corners_of_several_triangles_are_one_point() {
    let expected = points(&[CORNERS[0], CORNERS[1], CORNERS[2], CORNERS[5]]);
    let corner = |c: &[f32; 3]| format!("      vertex {} {:e} {}\n", c[0], c[1], c[2]);
    let facet = |c: &[[f32; 3]]| {
        let corners: String = c.iter().map(corner).collect();
        format!("  facet normal 0 0 1\n    outer loop\n{corners}    endloop\n  endfacet\n")
    };
    let text = format!("solid vertex\n{}{}endsolid vertex\n", facet(&CORNERS[..3]), facet(&CORNERS[3..]));
    assert_eq!(cloud("a.stl", &text).points, expected);
    assert!(failure("a.stl", &text[..text.len() - 17]).contains("2 triangles and no end"));
    assert!(failure("a.stl", text.replace("0.5", "half")).contains("half'"));

    // Binary files of some programs begin with the word of text files.
    let mut binary = b"solid binary".to_vec();
    binary.resize(80, b' ');
    binary.extend(2u32.to_le_bytes());
    for triangle in CORNERS.chunks(3) {
        [[0.0f32, 0.0, 1.0]].iter().chain(triangle).flatten().for_each(|v| binary.extend(v.to_le_bytes()));
        binary.extend([0, 0]);
    }
    let file = read_as("a.stl", &binary).unwrap();
    assert_eq!((&file.scans[0].cloud.points, file.notes.len()), (&expected, 1));
    binary[..80].fill(0);
    assert!(failure("a.stl", &binary[..140]).contains("found 140 bytes, expected 184 bytes for 2 triangles"));
    assert!(failure("a.stl", [&binary[..], &[1; 9]].concat()).contains("found 193 bytes"));
    binary[80..84].fill(0xff);
    assert!(failure("a.stl", &binary).contains("4294967295 triangles"));
}

fn glb(json: &str, data: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let length = (12 + 8 + json.len() + 8 + data.len()) as u32;
    [
        b"glTF",
        &2u32.to_le_bytes()[..],
        &length.to_le_bytes(),
        &(json.len() as u32).to_le_bytes(),
        b"JSON",
        &json,
        &(data.len() as u32).to_le_bytes(),
        b"BIN\0",
        data,
    ]
    .concat()
}

/// Two points as floats, and their colours as bytes with an opacity.
fn two_points() -> Vec<u8> {
    let floats = [1.0f32, 2.0, 3.0, 4.0, 5.0, 6.0];
    floats.iter().flat_map(|v| v.to_le_bytes()).chain([255, 0, 10, 255, 1, 2, 3, 255]).collect()
}

/// A file with the given nodes, and a mesh of two primitives that share their vertices.
fn scene(nodes: &str) -> String {
    format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 1, "scenes": [{{"nodes": []}}, {{"nodes": [0]}}],
        "nodes": [{nodes}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0, "COLOR_0": 1}}, "indices": 7}},
                                    {{"attributes": {{"POSITION": 0, "COLOR_0": 1}}}}]}}],
        "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 2, "type": "VEC3"}},
                      {{"bufferView": 1, "componentType": 5121, "normalized": true, "count": 2, "type": "VEC4"}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 24}}, {{"buffer": 0, "byteOffset": 24, "byteLength": 8}}],
        "buffers": [{{"byteLength": 32}}]}}"#
    )
}

#[test]
fn glb_vertices_are_placed_by_the_nodes_of_the_scene() {
    let plain = scene(r#"{"mesh": 0}"#);
    let read_cloud = cloud("a.bin", glb(&plain, &two_points()));
    assert_eq!(read_cloud.points, points(&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]));
    assert_eq!(read_cloud.colors, Some(vec![[255, 0, 10], [1, 2, 3]]));
    // Twice as large, a quarter turn about z (x to y, y to -x), then 10 along x; its parent, by a matrix
    // whose columns are listed, adds 8 along z. Another node is not in the scene.
    let nodes = r#"{"children": [1], "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,8,1]},
        {"mesh": 0, "scale": [2, 2, 2], "rotation": [0, 0, 0.7071067811865476, 0.7071067811865476],
         "translation": [10, 0, 0]}, {"mesh": 0}"#;
    let read_cloud = cloud("a.glb", glb(&scene(nodes), &two_points()));
    let expected = points(&[[6.0, 2.0, 14.0], [0.0, 8.0, 20.0]]);
    for (point, expected) in read_cloud.points.iter().zip(&expected) {
        // Single precision at 20 has steps of 2e-6.
        assert!((point - expected).norm() < 1e-5, "{point} {expected}");
    }
    assert_eq!(read_cloud.len(), 2);
    // Without a scene all nodes count; positions may stand apart from each other.
    let strided = plain
        .replace(r#""scene": 1, "scenes": [{"nodes": []}, {"nodes": [0]}],"#, "")
        .replace(r#""byteLength": 24}"#, r#""byteLength": 28, "byteStride": 16}"#)
        .replace(r#", "COLOR_0": 1"#, "");
    let data = [&two_points()[..12], &[9; 4], &two_points()[12..24]].concat();
    assert_eq!(cloud("a.glb", glb(&strided, &data)).points, points(&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]));
}

#[test]
fn glb_that_is_packed_cut_or_hostile_says_so() {
    let plain = scene(r#"{"mesh": 0}"#);
    let changed = |from: &str, to: &str| {
        assert!(plain.contains(from), "{from}");
        failure("a.glb", glb(&plain.replacen(from, to, 1), &two_points()))
    };
    assert!(changed(r#""bufferView": 0, "#, "").contains("without compression"));
    let meshopt = r#""byteLength": 24, "extensions": {"EXT_meshopt_compression": {}}}"#;
    assert!(changed(r#""byteLength": 24}"#, meshopt).contains("without compression"));
    assert!(changed("5126", "5125").contains("component type 5125"));
    assert!(changed(r#"{"byteLength": 32}"#, r#"{"uri": "a.bin"}"#).contains("another file"));
    assert!(changed(r#""count": 2"#, r#""count": 18446744073709551615"#).contains("with 2 values"));
    assert!(
        changed(r#""byteLength": 24"#, r#""byteOffset": 99999999, "byteLength": 24"#)
            .contains("with 0 values")
    );
    assert!(changed(r#""mesh": 0"#, r#""mesh": "none""#).contains("cannot be read"));
    // A node that is its own child, and a mesh that stands there more often than the file has bytes.
    let cycle = scene(r#"{"mesh": 0, "children": [0, 0]}"#);
    assert_eq!(cloud("a.glb", glb(&cycle, &two_points())).len(), 2);
    let mut often = r#"{"children": ["#.to_owned();
    often += &(1..999).map(|i| i.to_string()).collect::<Vec<_>>().join(",");
    often += "]}";
    often += &r#",{"mesh":0}"#.repeat(998);
    let crowd = scene(&often).replace(
        r#""primitives": ["#,
        &format!(r#""primitives": [{}"#, r#"{"attributes":{"POSITION":0}},"#.repeat(100)),
    );
    assert!(failure("a.glb", glb(&crowd, &two_points())).contains("again and again"));

    let bytes = glb(&plain, &two_points());
    for end in 4..bytes.len() {
        assert!(failure("a.glb", &bytes[..end]).contains("found"), "{end}");
    }
    let mut old = bytes;
    old[4] = 1;
    assert!(failure("a.glb", old).contains("version 1"));
    assert!(failure("a.gltf", plain).contains("export it as GLB"));
}

#[test]
fn glb_positions_may_be_quantized_and_the_mode_a_word() {
    let plain = scene(r#"{"mesh": 0, "scale": [2, 2, 2], "translation": [10, 0, 0]}"#)
        .replace(r#", "COLOR_0": 1"#, "")
        .replace(r#""byteLength": 24}"#, r#""byteLength": 16, "byteStride": 8}"#);
    // Two rows of 16-bit numbers, each with two bytes of padding.
    let rows = [[32767i16, -32768, 0, 9], [100, 0, -200, 9]];
    let data: Vec<u8> = rows.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    let short = plain.replacen("5126", "5122", 1);
    assert_eq!(
        cloud("a.glb", glb(&short, &data)).points,
        points(&[[65544.0, -65536.0, 0.0], [210.0, 0.0, -400.0]])
    );
    let fractions = short.replacen("5122,", r#"5122, "normalized": true,"#, 1);
    let read_cloud = cloud("a.glb", glb(&fractions, &data));
    // -32768 is cut to -1.
    assert_eq!(read_cloud.points[0], Point::new(12.0, -2.0, 0.0));
    assert!((read_cloud.points[1] - Point::new(10.0 + 200.0 / 32767.0, 0.0, -400.0 / 32767.0)).norm() < 1e-6);
    let word = scene(r#"{"mesh": 0}"#)
        .replace(r#""POSITION": 0, "COLOR_0": 1}"#, r#""POSITION": 0}, "mode": "Points""#);
    let file = read_as("a.glb", glb(&word, &two_points())).unwrap();
    assert_eq!((file.scans[0].cloud.len(), file.notes.len()), (2, 0));
}
