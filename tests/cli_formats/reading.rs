//! What users say about files that do not say it themselves, and what is left out.

use super::cli_common::{ply_text, write_ply};
use super::place::{View, views};
use super::registered::{CLOSE, Desk};

const NAMES: [&str; 3] = ["s0", "s1", "s2"];

fn in_millimetres(view: &View) -> Vec<[f64; 3]> {
    view.points.iter().map(|p| p.map(|v| (v * 1000.0).round())).collect()
}

#[test]
fn a_unit_that_is_said_holds_for_the_coordinates() {
    let (desk, views) = (Desk::new(), views());
    for (name, view) in NAMES.iter().zip(&views) {
        write_ply(&desk.path(&format!("{name}.ply")), &in_millimetres(view));
    }
    // Poses are for coordinates in metres.
    let done = desk.register(&["--unit", "mm"]);
    done.agrees(&NAMES, &views, CLOSE);
}

#[test]
fn columns_that_are_said_are_taken() {
    let (desk, views) = (Desk::new(), views());
    for (name, view) in NAMES.iter().zip(&views) {
        // What stands in the first column is no coordinate.
        let rows = view.points.iter().enumerate();
        let text: String =
            rows.map(|(i, [x, y, z])| format!("{} {x:.3} {y:.3} {z:.3} 7\n", 1000 * (i % 17))).collect();
        desk.file(&format!("{name}.xyz"), text);
    }
    let done = desk.register(&["--columns", "x=2,y=3,z=4"]);
    done.agrees(&NAMES, &views, CLOSE);
    done.says(&["x: column 2, y: column 3, z: column 4"]);
}

#[test]
fn folders_in_a_folder_are_looked_into_where_that_is_said() {
    let (desk, views) = (Desk::new(), views());
    for (place, view) in ["ground/hall", "ground", "upper"].iter().zip(&views) {
        desk.file(&format!("{place}/scan.ply"), ply_text(view.points.len(), &view.points));
    }
    let done = desk.register(&["--recursive"]);
    done.agrees(&["hall/scan", "ground/scan", "upper/scan"], &views, CLOSE);
    let refused = desk.command(&[]).assert().code(3);
    let stderr = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    assert!(stderr.contains("--recursive"), "{stderr}");
}

#[test]
fn a_damaged_file_is_an_error_or_skipped_where_that_is_said() {
    let (desk, views) = (Desk::new(), views());
    for (name, view) in NAMES.iter().zip(&views) {
        write_ply(&desk.path(&format!("{name}.ply")), &view.points);
    }
    let whole = ply_text(views[0].points.len(), &views[0].points);
    desk.file("cut.ply", &whole[..whole.len() / 2]);
    let refused = desk.command(&[]).assert().code(3).stdout("");
    let stderr = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    for part in ["error: ", "cut.ply", "of 2560 complete vertex rows", "expected 2560 rows"] {
        assert!(stderr.contains(part), "{part:?} is not in: {stderr}");
    }
    assert_eq!(stderr.lines().count(), 1, "{stderr}");

    let done = desk.register(&["--skip-unreadable"]);
    done.agrees(&NAMES, &views, CLOSE);
    done.says(&["skipped: ", "cut.ply", "of 2560 complete vertex rows"]);
}

/// Formats that are not read, as their files begin.
const FOREIGN: [(&str, &[u8]); 14] = [
    ("model.fbx", b"Kaydara FBX Binary  \0\x1a\0\xe8\x1c\0\0"),
    ("plan.dxf", b"  0\r\nSECTION\r\n  2\r\nHEADER\r\n  9\r\n$ACADVER\r\n  1\r\nAC1027\r\n"),
    ("plan.dwg", b"AC1027\0\0\0\0\0\x7d\x06\0\0"),
    ("project.rcp", b"<?xml version=\"1.0\" encoding=\"utf-8\"?><project/>"),
    ("scan.rcs", b"ADSK\x01\0\0\0\x9c\x88\x01\x02"),
    ("scan.fls", b"\x02\0\0\0FARO\0\x01\xa3\x07\x93"),
    ("scan.zfs", b"\x07\0ZFS\0\x91\x03\x88\x15\x02\xfe"),
    ("drive.bag", b"#ROSBAG V2.0\nE\0\0\0\x10\0\0\0"),
    ("drive.mcap", b"\x89MCAP0\r\n\x01\x12\0\0\0\0\0\0\0"),
    ("drive.db3", b"SQLite format 3\0\x10\0\x01\x01"),
    ("drive.pcap", b"\xd4\xc3\xb2\xa1\x02\0\x04\0\0\0\0\0"),
    ("scan.h5", b"\x89HDF\r\n\x1a\n\0\0\0\0"),
    ("building.ifc", b"ISO-10303-21;\nHEADER;\nENDSEC;\n"),
    ("model.dae", b"<?xml version=\"1.0\"?><COLLADA version=\"1.4.1\"/>"),
];

#[test]
fn formats_that_are_not_read_are_refused_with_what_to_do() {
    let (desk, views) = (Desk::new(), views());
    write_ply(&desk.path("s0.ply"), &views[0].points);
    for (name, content) in FOREIGN {
        std::fs::write(desk.beside(name), content).unwrap();
        let refused = desk.command(&[desk.beside(name).to_str().unwrap()]).assert().code(3).stdout("");
        let stderr = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
        // The file, what was found, what is read, what to do.
        for part in [name, "found ", "expected ", "E57", "export"] {
            assert!(stderr.contains(part), "{name}: {part:?} is not in: {stderr}");
        }
        assert!(stderr.lines().count() == 1 && !stderr.contains('\0'), "{name}: {stderr}");
    }
    // In a folder, such files are no scans: a folder of them says what is there.
    let folder = desk.beside("foreign");
    std::fs::create_dir(&folder).unwrap();
    for (name, content) in FOREIGN {
        std::fs::write(folder.join(name), content).unwrap();
    }
    let refused = desk.command(&[folder.to_str().unwrap()]).assert().code(3);
    let stderr = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    for part in ["foreign", "14 files, none of them a scan by its extension", ".bag", "expected scans: PLY"] {
        assert!(stderr.contains(part), "{part:?} is not in: {stderr}");
    }
}
