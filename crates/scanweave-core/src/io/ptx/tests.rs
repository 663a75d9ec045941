use crate::geometry::{Point, RigidMotion};
use crate::io::{ReadOptions, ScanFile, read_file};
use nalgebra::{Point3, Vector3};

/// A quarter turn about z takes x to y, so that the rows of M, which multiplies row vectors, are the images
/// of x, y and z; the last is the translation.
const TURNED: &str = "0 1 0 0\n-1 0 0 0\n0 0 1 0\n10 20 30 1\n";
const IDENTITY: &str = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
const PLACE: &str = "10 20 30\n0 1 0\n-1 0 0\n0 0 1\n";
const ROWS: &str = "1 2 3 0.25\n0 0 0 0.5\n-1.5 2 3 1\n1 -2 -3 0\n0.000 0.000 0.000 0.5\n4 5 6e-1 0.75\n";

fn read_as(name: &str, text: &str) -> crate::Result<ScanFile> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    read_file(&path, &ReadOptions { attributes: true, ..ReadOptions::default() })
}

fn read(text: &str) -> crate::Result<ScanFile> {
    read_as("a.ptx", text)
}

#[test]
fn a_grid_with_its_pose_its_returns_and_its_gaps() {
    let file = read(&format!("2\n3\n{PLACE}{TURNED}{ROWS}")).unwrap();
    let [scan] = &file.scans[..] else { panic!("{} scans", file.scans.len()) };
    let points = [[1.0, 2.0, 3.0], [-1.5, 2.0, 3.0], [1.0, -2.0, -3.0], [4.0, 5.0, 0.6]].map(Point::from);
    assert_eq!(scan.cloud.points, points);
    assert_eq!(scan.cloud.dropped_rows, 2);
    assert_eq!(scan.cloud.intensities, Some(vec![0.25, 1.0, 0.0, 0.75]));
    assert_eq!((&scan.cloud.colors, scan.cloud.viewpoint), (&None, Some(Point::origin())));
    // [1 2 3 1]·M = 1·(0 1 0) + 2·(-1 0 0) + 3·(0 0 1) + (10 20 30).
    let world = scan.pose.unwrap() * Point3::new(1.0, 2.0, 3.0);
    assert!((world - Point3::new(8.0, 21.0, 33.0)).norm() < 1e-12, "{world}");
    assert!(file.notes.is_empty());
}

#[test]
fn several_scans_with_colours_and_windows_line_ends() {
    let second = "1\n2\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n-5 0 0 1\n\
                  1 1 1 0.5 255 128 0\n0 0 0 0.5 0 0 0\n\n";
    let text = format!("2\n3\n{PLACE}{TURNED}{ROWS}{second}").replace('\n', "\r\n");
    let file = read(&text).unwrap();
    assert_eq!(file.scans.len(), 2);
    assert_eq!(file.scans[1].cloud.points, [Point::new(1.0, 1.0, 1.0)]);
    assert_eq!(file.scans[1].cloud.colors, Some(vec![[255, 128, 0]]));
    assert_eq!(file.scans[1].pose, Some(RigidMotion::translation(-5.0, 0.0, 0.0)));
    // Told by its content, whatever its name.
    assert_eq!(read_as("a.txt", &text).unwrap().scans.len(), 2);
}

#[test]
fn where_nothing_is_registered_no_pose_is_stated() {
    let block = format!("2\n3\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n{IDENTITY}{ROWS}");
    let file = read(&block.repeat(2)).unwrap();
    assert!(file.scans.len() == 2 && file.scans.iter().all(|s| s.pose.is_none()));
    assert_eq!(file.scans[1].cloud.viewpoint, Some(Point::origin()));
}

#[test]
fn points_in_the_coordinates_of_the_scanners_place_are_seen_from_there() {
    let world = "11 20 30 0.5\n9 20 30 0.5\n10 22 31 0.5\n";
    let file = read(&format!("1\n3\n{PLACE}{IDENTITY}{world}")).unwrap();
    let cloud = &file.scans[0].cloud;
    let viewpoint = cloud.viewpoint.unwrap().coords.cast::<f64>() + cloud.origin_m;
    assert!((viewpoint - Vector3::new(10.0, 20.0, 30.0)).norm() < 1e-5, "{viewpoint}");
}

#[test]
fn a_matrix_that_is_no_motion_leaves_the_points_and_is_reported() {
    let scaled = "2 0 0 0\n0 2 0 0\n0 0 2 0\n10 20 30 1\n";
    let file = read(&format!("2\n3\n{PLACE}{scaled}{ROWS}")).unwrap();
    assert_eq!((file.scans[0].cloud.len(), file.scans[0].pose), (4, None));
    assert!(file.notes[0].warning && file.notes[0].text.contains("no rigid motion"));
}

#[test]
fn a_file_that_ends_early_or_is_no_grid_says_where() {
    let whole = format!("2\n3\n{PLACE}{TURNED}{ROWS}");
    let early = whole.strip_suffix("4 5 6e-1 0.75\n").unwrap();
    let huge = whole.replacen("2\n3", "4000000000\n4000000000", 1);
    for (text, said) in [
        (early.to_owned(), "found 5 rows in scan 1, expected 6 (2 x 3) as its first lines say"),
        (format!("{whole}{early}{whole}"), "found 5 rows in scan 2, expected 6"),
        (huge, "found 6 rows in scan 1, expected 16000000000000000000"),
        (whole.replacen("2\n3", "40000000000\n40000000000", 1), "a grid of fewer than"),
        (whole.replacen("-1.5 2", "-1.5 two", 1), "line 13 '-1.5 two 3 1' in scan 1"),
        (
            whole.replacen("10 20 30\n", "10 20\n", 1),
            "line 3 '10 20' in scan 1, expected the scanner's place",
        ),
        (whole[..40].to_owned(), "in scan 1"),
        ("hello\n".to_owned(), "expected its number of columns"),
    ] {
        let message = read(&text).unwrap_err().to_string();
        assert!(message.contains(said), "{message}");
    }
}

#[test]
fn decimal_commas_and_a_grid_larger_than_its_first_lines_say() {
    let text = format!("2\n3\n{PLACE}{TURNED}{ROWS}");
    let commas = read(&text.replace('.', ",")).unwrap();
    assert_eq!(commas.scans[0].cloud.points, read(&text).unwrap().scans[0].cloud.points);
    let message = read(&text.replacen("2\n3", "2\n2", 1)).unwrap_err().to_string();
    assert!(message.contains("a further row in line 15 after all of scan 1"), "{message}");
}

#[test]
fn a_grid_of_no_rows_is_left_out_beside_others() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ptx");
    let empty = format!("0\n0\n{PLACE}{TURNED}");
    let all = |text: String| {
        std::fs::write(&path, text).unwrap();
        let found = crate::io::discover::discover_with(&[path.display().to_string()], false).unwrap();
        crate::io::read_inputs(&found, &ReadOptions::default(), false, &crate::monitor::Silent)
    };
    let inputs = all(format!("{empty}2\n3\n{PLACE}{TURNED}{ROWS}")).unwrap();
    let scans: Vec<(&str, usize)> = inputs.scans.iter().map(|s| (s.name.as_str(), s.cloud.len())).collect();
    // The number stays that of the file.
    assert_eq!((scans, inputs.scans[0].part), (vec![("a#2", 4)], Some(1)));
    assert!(inputs.notes[0].0.warning, "{:?}", inputs.notes);
    assert_eq!(inputs.notes[0].0.text, "1 scan of the file without a point, left out: 1");
    let message = all(empty.repeat(2)).unwrap_err().to_string();
    assert!(message.contains("0 finite points of 0 rows in 2 scans"), "{message}");
}
