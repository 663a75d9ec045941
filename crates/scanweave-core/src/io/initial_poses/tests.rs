use super::*;
use crate::io::pose_graphs::{GraphEdge, GraphNode, PoseGraphFile, write_g2o, write_open3d_pose_graph};
use crate::io::poses::write_log_trajectory;
use crate::io::trajectories::{
    PlacedScan, write_csv_trajectory, write_images_trajectory, write_kitti_trajectory, write_tum_trajectory,
};
use crate::scan::ScanId;
use nalgebra::{Matrix4, Matrix6, Vector3};
use tempfile::TempDir;

type Outcome = Result<Vec<Option<RigidMotion>>>;

/// What a file of this content gives for scans of these names, each in `in/NAME.ply`.
fn read_text_as(file: &str, text: &str, names: &[&str]) -> Outcome {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join(file);
    std::fs::write(&path, text).unwrap();
    read_for(&path, names)
}

fn read_for(path: &Path, names: &[&str]) -> Outcome {
    let files: Vec<Option<PathBuf>> = names.iter().map(|n| Some(format!("in/{n}.ply").into())).collect();
    let names: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
    read_initial_poses(path, &names, &files)
}

fn said(outcome: Outcome) -> String {
    outcome.unwrap_err().to_string()
}

/// A quarter turn about z, then a shift: (x, y, z) → (1 − y, 2 + x, 3 + z).
fn turned() -> RigidMotion {
    let turn = Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2);
    RigidMotion::new(Vector3::new(1.0, 2.0, 3.0), turn)
}

fn assert_turned(pose: &Option<RigidMotion>) {
    let expected =
        Matrix4::new(0.0, -1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 1.0, 3.0, 0.0, 0.0, 0.0, 1.0);
    let found = pose.expect("a pose").to_homogeneous();
    assert!((found - expected).amax() < 1e-9, "{found}");
}

fn assert_at(pose: &Option<RigidMotion>, x: f64) {
    let found = pose.expect("a pose").to_homogeneous();
    assert!((found - Matrix4::new_translation(&Vector3::new(x, 0.0, 0.0))).amax() < 1e-9, "{found}");
}

#[test]
fn tables_go_by_name_whatever_the_order_and_case_of_their_columns() {
    let text = "# made by hand\nQW,qz,qy,qx,TX,ty,tz,Name,more\r\n\
                0.70710678118654752,0.70710678118654752,0,0,1,2,3,b,x\r\n\
                1,0,0,0,5,0,0,\"a, c\",y\r\n,,,,,,,d,\r\n";
    let poses = read_text_as("t.csv", text, &["a, c", "b", "d"]).unwrap();
    assert_at(&poses[0], 5.0);
    assert_turned(&poses[1]);
    assert_eq!(poses[2], None);

    // A matrix row by row, 12 or 16 columns, and semicolons.
    let twelve: Vec<String> = (0..12).map(|k| format!("m{k}")).collect();
    let rows = "b;0;-1;0;1;1;0;0;2;0;0;1;3";
    let text = format!("file;{}\n{rows}\n", twelve.join(";"));
    assert_turned(&read_text_as("t.csv", &text, &["a", "b"]).unwrap()[1]);
    let text = format!("file;{};p;q;r;s\n{rows};0;0;0;1\n", twelve.join(";"));
    assert_turned(&read_text_as("t.csv", &text, &["a", "b"]).unwrap()[1]);
}

#[test]
fn of_several_components_a_table_gives_the_first() {
    let text =
        "name,component,tx,ty,tz,qx,qy,qz,qw\na,1,7,0,0,0,0,0,1\nb,0,8,0,0,0,0,0,1\nc,1,9,0,0,0,0,0,1\n";
    let poses = read_text_as("t.csv", text, &["a", "b", "c"]).unwrap();
    assert_at(&poses[0], 7.0);
    assert_eq!(poses[1], None);
    assert_at(&poses[2], 9.0);
}

#[test]
fn a_name_may_be_the_scan_its_file_or_its_stem() {
    let row = |name: &str| {
        format!("name,tx,ty,tz,qx,qy,qz,qw\n{name},1,2,3,0,0,0.7071067811865476,0.7071067811865476\n")
    };
    for name in ["one/s", "in/one/s.ply", "/elsewhere/one/s.ply", "s.ply", "s", "s.png", "\"one/s\""] {
        let poses = read_text_as("t.csv", &row(name), &["x", "one/s"]).unwrap();
        assert!(poses[0].is_none(), "{name}");
        assert_turned(&poses[1]);
    }
    // A whole name wins over what is only like it; what fits two is refused.
    assert_turned(&read_text_as("t.csv", &row("s"), &["one/s", "s"]).unwrap()[1]);
    let message = said(read_text_as("t.csv", &row("s"), &["one/s", "two/s"]));
    assert!(message.contains("'s' in line 2, which fits 2 scans (one/s, two/s)"), "{message}");
}

#[test]
fn json_objects_and_results_go_by_name() {
    let text = r#"{"b": [[0,-1,0,1],[1,0,0,2],[0,0,1,3],[0,0,0,1]], "a.ply": [1,0,0,5, 0,1,0,0, 0,0,1,0], "c": null}"#;
    let poses = read_text_as("truth.json", text, &["a", "b", "c"]).unwrap();
    assert_at(&poses[0], 5.0);
    assert_turned(&poses[1]);
    assert_eq!(poses[2], None);

    let scan =
        |name: &str, rest: &str| format!(r#"{{"id": 0, "name": "{name}", "file": "in/{name}.ply", {rest}}}"#);
    let rows = "[[0,-1,0,1],[1,0,0,2],[0,0,1,3],[0,0,0,1]]";
    let placed = |component: usize| {
        format!(r#""outcome": "placed", "component": {component}, "world_from_scan": {rows}"#)
    };
    let scans =
        [scan("old/b", &placed(0)), scan("zz", r#""outcome": "declined""#), scan("a", &placed(1))].join(",");
    let text =
        format!(r#"{{"format": "scanweave-poses", "version": 3, "components": [], "scans": [{scans}]}}"#);
    let poses = read_text_as("poses.json", &text, &["a", "b"]).unwrap();
    assert_eq!(poses[0], None, "components are unrelated");
    assert_turned(&poses[1]);
}

#[test]
fn timestamps_are_names_places_or_the_order() {
    let line = |stamp: &str, x: f64| format!("{stamp} {x} 0 0 0 0 0 1\n");
    // Numbers of names, in any order and written otherwise.
    let text = line("1.305031102211e9", 2.0) + &line("1305031102.175304", 1.0);
    let names = ["1305031102.175304", "1305031102.211000", "1305031102.9"];
    let poses = read_text_as("t.tum", &text, &names).unwrap();
    assert_at(&poses[0], 1.0);
    assert_at(&poses[1], 2.0);
    assert_eq!(poses[2], None);
    // Places, where names have no numbers; some scans without a pose.
    let poses = read_text_as("t.tum", &(line("2", 5.0) + &line("0", 4.0)), &["a", "b", "c"]).unwrap();
    assert_at(&poses[0], 4.0);
    assert_eq!(poses[1], None);
    assert_at(&poses[2], 5.0);
    // The order, where there is nothing else and counts agree.
    let text = line("10.5", 1.0) + &line("9.5", 2.0);
    let poses = read_text_as("t.tum", &text, &["a", "b"]).unwrap();
    assert_at(&poses[0], 1.0);
    assert_at(&poses[1], 2.0);
    let message = said(read_text_as("t.tum", &text, &["a", "b", "c"]));
    assert!(
        message.contains("timestamp 10.5 in line 1") && message.contains("3 poses in order"),
        "{message}"
    );
}

#[test]
fn numbers_are_names_or_places_and_not_both() {
    let entry = |n: usize, x: f64| format!("{n} {n} {}\n1 0 0 {x}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", n + 1);
    let poses = read_text_as("t.log", &(entry(20, 1.0) + &entry(10, 2.0)), &["s10", "s20", "s30"]).unwrap();
    assert_at(&poses[0], 2.0);
    assert_at(&poses[1], 1.0);
    assert_eq!(poses[2], None);
    let poses = read_text_as("t.log", &entry(1, 3.0), &["a", "b"]).unwrap();
    assert_eq!(poses[0], None);
    assert_at(&poses[1], 3.0);
    // Names from 1: number 1 is the first scan by name, the second by place.
    let message = said(read_text_as("t.log", &entry(1, 3.0), &["s1", "s2"]));
    assert!(message.contains("may mean s1 by name or s2 by place"), "{message}");
    // Number 2 settles it: there is no third scan.
    let poses = read_text_as("t.log", &(entry(1, 3.0) + &entry(2, 4.0)), &["s1", "s2"]).unwrap();
    assert_at(&poses[0], 3.0);
    let message = said(read_text_as("t.log", &(entry(0, 3.0) + &entry(7, 4.0)), &["a", "b"]));
    assert!(message.contains("a pose of number 7 in entry '7 7 8'"), "{message}");
    let pair = entry(1, 3.0).replace("1 1 2", "0 1 2");
    assert!(said(read_text_as("gt.log", &pair, &["a", "b"])).contains("of the pair '0 1'"));
}

#[test]
fn g2o_vertices_and_images_of_colmap_by_hand() {
    let text = "# graph\nVERTEX_SE3:QUAT 1 1 2 3 0 0 0.7071067811865476 0.7071067811865476\nFIX 1\n\
                EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n";
    let poses = read_text_as("g.g2o", text, &["a", "b"]).unwrap();
    assert_eq!(poses[0], None);
    assert_turned(&poses[1]);

    // The inverse of (1 − y, 2 + x, 3 + z) is (y − 2, 1 − x, z − 3): a quarter turn back, q = (√½, 0, 0, −√½).
    let text = "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n\
                7 0.7071067811865476 0 0 -0.7071067811865476 -2 1 -3 1 b.png\n\
                10.5 20.5 -1 11 12 3\n\
                8 1 0 0 0 -5 0 0 1 a c.png\n\n";
    let poses = read_text_as("images.txt", text, &["a c", "b"]).unwrap();
    assert_at(&poses[0], 5.0);
    assert_turned(&poses[1]);
}

#[test]
fn kitti_goes_by_order_or_by_the_names_beside_it() {
    let text = "0 -1 0 1 1 0 0 2 0 0 1 3\n1 0 0 5 0 1 0 0 0 0 1 0\n";
    let poses = read_text_as("p.txt", text, &["a", "b"]).unwrap();
    assert_turned(&poses[0]);
    assert_at(&poses[1], 5.0);
    let message = said(read_text_as("p.txt", text, &["a", "b", "c"]));
    assert!(message.contains("found 2 poses without names, expected 3, one for each scan"), "{message}");

    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("p.txt");
    std::fs::write(&path, text).unwrap();
    std::fs::write(place.path().join("p_names.txt"), "c\na\n").unwrap();
    let poses = read_for(&path, &["a", "b", "c"]).unwrap();
    assert_at(&poses[0], 5.0);
    assert_eq!(poses[1], None);
    assert_turned(&poses[2]);
    std::fs::write(place.path().join("p_names.txt"), "c\n").unwrap();
    let message = said(read_for(&path, &["a", "b", "c"]));
    assert!(message.contains("p_names.txt: found 1 names, expected 2"), "{message}");
}

#[test]
fn what_does_not_fit_is_told_with_its_place() {
    let head = "name,tx,ty,tz,qx,qy,qz,qw\n";
    let json = |matrix: &str| format!(r#"{{"a": {matrix}}}"#);
    let cases = [
        ("t.csv", format!("{head}a,1,2,x,0,0,0,1\n"), "line 2 '1 2 x 0 0 0 1', expected numbers"),
        ("t.csv", format!("{head}a,1,2,3,0,0,0,2\n"), "line 2 '1 2 3 0 0 0 2', expected finite numbers"),
        ("t.csv", format!("{head}a,1,2,3,0,0,0\n"), "line 2 '1 2 3 0 0 0 '"),
        (
            "t.csv",
            format!("{head}z,1,2,3,0,0,0,1\ny,1,2,3,0,0,0,1\n"),
            "a pose of 'z' in line 2, expected names of the 2 scans (a, b)",
        ),
        ("t.csv", format!("{head}a,1,2,3,0,0,0,1\na.ply,1,2,3,0,0,0,1\n"), "poses of a in line 2 and line 3"),
        ("t.csv", format!("{head}\"a,1,2,3,0,0,0,1\n"), "a quotation that is open from line 2"),
        ("t.csv", "name,tx,ty,tz,qx,qy,qz,q\na,1,2,3,0,0,0,1\n".to_owned(), "the columns name, tx"),
        ("t.csv", head.to_owned(), "found none, expected at least one pose"),
        ("t.json", json("[[1,0,0],[0,1,0],[0,0,1]]"), "'a': [[1,0,0]"),
        ("t.json", json("[2,0,0,0, 0,2,0,0, 0,0,2,0]"), "'a': the matrix [2.0"),
        ("t.json", "{\"a\": ".to_owned(), "no JSON"),
        ("t.json", "[1, 2]".to_owned(), "a JSON list"),
        ("t.g2o", "VERTEX_SE3:QUAT 0 1 2 3 0 0 0\n".to_owned(), "line 1 'VERTEX_SE3:QUAT 0 1 2 3 0 0 0'"),
        ("images.txt", "1 1 0 0 0 0 0 0 1 a\n\n2 1 0 0 0 0 0 0 b\n".to_owned(), "line 3 '2 1 0"),
        ("t.tum", "nan 1 2 3 0 0 0 1\n".to_owned(), "the timestamp NaN in line 1"),
        ("t.txt", "hello\n".to_owned(), "a first line 'hello', expected poses"),
        ("t.txt", String::new(), "found no pose"),
    ];
    for (file, text, expected) in cases {
        let message = said(read_text_as(file, &text, &["a", "b"]));
        assert!(message.contains(file) && message.contains(expected), "{text}\n{message}");
    }
}

/// Scans 0 and 2 of four, and what was written of them.
fn written(names: &[&str; 4], write: impl Fn(&Path, &[PlacedScan])) -> (TempDir, PathBuf, Vec<PlacedScan>) {
    let scan = |id: usize, world_from_scan: RigidMotion| PlacedScan {
        id: ScanId(id),
        name: names[id].to_owned(),
        file: Some(format!("in/{}.ply", names[id])),
        component: 0,
        world_from_scan,
        probability: None,
        sigma_t_m: None,
        sigma_r_deg: None,
    };
    let other = RigidMotion::new(Vector3::new(431_250.123, -5e6, 1e-9), Vector3::new(0.4, -2.8, 0.7));
    let scans = vec![scan(0, turned()), scan(2, other)];
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("poses.txt");
    write(&path, &scans);
    (place, path, scans)
}

fn as_graph(scans: &[PlacedScan]) -> PoseGraphFile {
    let node =
        |s: &PlacedScan| GraphNode { id: s.id, name: s.name.clone(), world_from_scan: s.world_from_scan };
    let information = Matrix6::identity();
    let edge = GraphEdge { i: 0, j: 1, i_from_j: RigidMotion::identity(), information, uncertain: false };
    PoseGraphFile { nodes: scans.iter().map(node).collect(), pivot: 0, edges: vec![edge] }
}

#[test]
fn what_is_written_is_read_back_in_every_format() {
    type Write<'a> = (&'a str, Box<dyn Fn(&Path, &[PlacedScan]) + 'a>);
    for names in [["a", "b, \"c\"", "d e", "f;g"], ["s1305.5", "s7", "s10", "s08"]] {
        let formats: [Write<'_>; 7] = [
            ("tum", Box::new(|p, s| write_tum_trajectory(p, s, &names).unwrap())),
            ("kitti", Box::new(|p, s| write_kitti_trajectory(p, s).unwrap())),
            ("csv", Box::new(|p, s| write_csv_trajectory(p, s).unwrap())),
            ("colmap", Box::new(|p, s| write_images_trajectory(p, s).unwrap())),
            ("g2o", Box::new(|p, s| write_g2o(p, &as_graph(s)).unwrap())),
            ("open3d", Box::new(|p, s| write_open3d_pose_graph(p, &as_graph(s)).unwrap())),
            (
                "log",
                Box::new(|p, s| {
                    let poses: Vec<_> = s.iter().map(|s| (s.id, s.world_from_scan)).collect();
                    write_log_trajectory(p, &poses).unwrap();
                }),
            ),
        ];
        for (format, write) in formats {
            let (_place, path, scans) = written(&names, write);
            let poses = read_for(&path, &names).unwrap_or_else(|e| panic!("{format}: {e}"));
            assert_eq!([poses[1], poses[3]], [None, None], "{format}");
            for scan in scans {
                let found = poses[scan.id.0].unwrap().to_homogeneous();
                let expected = scan.world_from_scan.to_homogeneous();
                let rotation = (found - expected).fixed_view::<3, 3>(0, 0).amax();
                // Coordinates of 5·10⁶ m have 10⁻⁹ m; COLMAP's are inverted twice.
                let place = (found - expected).fixed_view::<3, 1>(0, 3).amax();
                assert!(rotation < 1e-9 && place < 1e-8, "{format}: {found} {expected}");
            }
        }
    }
}
