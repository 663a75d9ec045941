//! Text clouds as scanners and programs write them. Points are written here by hand in each layout.

use super::*;
use crate::geometry::Point;

/// Twelve points that no column of which is in order.
const POINTS: [[f64; 3]; 12] = [
    [0.558, 0.583, -1.397],
    [-0.648, 0.677, -1.396],
    [0.749, -0.783, -1.399],
    [12.5, 0.899, 0.25],
    [0.986, 1.031, -1.403],
    [1.126, -11.178, -1.399],
    [-1.246, 1.303, 1.348],
    [1.241, 1.298, -1.162],
    [0.0, 4.5, -0.999],
    [1.248, 1.305, -0.848],
    [1.243, 1.3, 0.701],
    [1.242, -1.299, -0.564],
];

/// A file with a line a point, made by `line` of its place and its coordinates as text.
fn file(head: &str, line: impl Fn(usize, [String; 3]) -> String) -> String {
    let rows = POINTS.iter().enumerate().map(|(i, p)| line(i, p.map(|v| format!("{v:.3}"))));
    rows.fold(head.to_owned(), |text, row| text + &row + "\n")
}

fn joined(head: &str, mark: &str) -> String {
    file(head, |_, p| p.join(mark))
}

fn with(name: &str, text: impl AsRef<[u8]>, options: &ReadOptions) -> Result<ScanFile> {
    read(Path::new(name), text.as_ref(), options)
}

fn good(name: &str, text: impl AsRef<[u8]>) -> ScanFile {
    with(name, text, &ReadOptions::default()).unwrap()
}

fn points(file: &ScanFile) -> &[Point] {
    &file.scans[0].cloud.points
}

/// The points in units of so many metres.
fn expected(unit_m: f64) -> Vec<Point> {
    POINTS.iter().map(|p| Point::from(p.map(|v| (v * unit_m) as f32))).collect()
}

fn notes(file: &ScanFile) -> String {
    file.notes.iter().map(|n| format!("{}{}\n", if n.warning { "! " } else { "" }, n.text)).collect()
}

/// The message of a file that is not a scan.
fn no_scan(text: impl AsRef<[u8]>) -> String {
    match with("t.csv", text, &ReadOptions::default()) {
        Err(e @ Error::NotAScan { .. }) => e.to_string(),
        other => panic!("{other:?}"),
    }
}

/// The message of a scan that cannot be read.
fn damaged(text: impl AsRef<[u8]>) -> String {
    match with("t.csv", text, &ReadOptions::default()) {
        Err(e @ Error::File { .. }) => e.to_string(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn names_of_scanners_and_programs() {
    let livox = file(
        "Version,Slot ID,LiDAR Index,Rsvd,Error Code,Timestamp Type,Data Type,Timestamp,X,Y,Z,Reflectivity,Tag,\
         Ori_x,Ori_y,Ori_z,Ori_radius,Ori_theta,Ori_phi\n",
        |i, [x, y, z]| format!("5,1,1,0,0x00000000,0,0,{},{x},{y},{z},7,0,9,9,9,0,0,0", 2444124 + i),
    );
    let read = good("a.csv", livox);
    assert_eq!(points(&read), expected(1.0));
    assert_eq!(
        notes(&read),
        "columns x: X, y: Y, z: Z in metres; colour: none; not taken: Ori_x, Ori_y, Ori_z\n"
    );
    let behind = |head: &str, mark: &str| file(head, |i, p| format!("{i}{mark}{}", p.join(mark)));
    for text in [
        file("\"Point:0\",\"Point:1\",\"Point:2\",\"Signal Photons\"\n", |_, p| p.join(",") + ",10.0"),
        joined("\"Points_m_XYZ:0\",\"Points_m_XYZ:1\",\"Points_m_XYZ:2\"\n", ","),
        behind("id,Points:0,Points:1,Points:2\n", ","),
        file("//X Y Z R G B Intensity Nx Ny Nz\n", |_, p| p.join(" ") + " 1 2 3 0.5 0 0 1"),
        behind("Time;X[m];Y[m];Z[m]\n", ";"),
        behind("# index x [m] y [m] z [m]\n", " "),
        behind("% t pos_x pos_y pos_z\n", "\t"),
        behind("row,coord x,coord y,coord z\n", ", "),
        behind("n\tCartesian X\tCartesian Y\tCartesian Z\n", "\t"),
        behind("Point No;Easting;Northing;Elevation\n", ";"),
        behind("! t xcoord ycoord zcoord\n", " "),
        behind("t,x_coordinate,y_coordinate,z_coordinate\n", ","),
        behind("a scan of the hall\n12\nt X Y Height\n", " "),
        behind("Columns: id x y z\n", " "),
        // Two places of a point: the plain name is that of the scan.
        file("world x,world y,world z,x,y,z\n", |_, p| format!("1,2,3,{}", p.join(","))),
        // A height may come first.
        file("elevation,northing,easting\n", |_, [x, y, z]| format!("{z},{y},{x}")),
    ] {
        assert_eq!(points(&good("a.csv", &text)), expected(1.0), "{text}");
    }
}

#[test]
fn units_of_names_and_of_the_flag() {
    for head in
        ["X[mm];Y[mm];Z[mm]\n", "x (mm);y (mm);z (mm)\n", "\"X_mm\";\"Y_mm\";\"Z_mm\"\n", "x;y;z [mm]\n"]
    {
        let read = good("a.csv", joined(head, ";"));
        assert_eq!(points(&read), expected(0.001), "{head}");
        assert!(notes(&read).contains(" in mm; colour: none"), "{}", notes(&read));
    }
    let each = good("a.csv", joined("x[m],y[m],z[cm]\n", ","));
    assert_eq!(points(&each)[3], Point::new(12.5, 0.899, 0.0025));
    let options = ReadOptions { unit_m: Some(0.01), ..ReadOptions::default() };
    let read = with("a.csv", joined("x[mm],y[mm],z[mm]\n", ","), &options).unwrap();
    assert_eq!(points(&read), expected(0.01));
    assert!(
        notes(&read).contains("! the names of the columns say in mm, --unit says in cm"),
        "{}",
        notes(&read)
    );
    let read = with("a.xyz", joined("", " "), &options).unwrap();
    assert_eq!((points(&read), notes(&read).as_str()), (&expected(0.01)[..], ""));
}

#[test]
fn separators_and_decimal_marks_by_the_whole_file() {
    let comma = |p: [String; 3]| p.map(|v| v.replace('.', ","));
    for (mark, decimal) in
        [(" ", true), ("\t", true), (";", true), ("; ", true), (",", false), (", ", false), ("  \t", false)]
    {
        let text = file("", |_, p| if decimal { comma(p) } else { p }.join(mark) + &" ".repeat(2000));
        let read = good("a.xyz", &text);
        assert_eq!(points(&read), expected(1.0), "{mark:?}");
        assert_eq!(notes(&read).contains("decimal"), decimal);
    }
    // Rows without a return stand before the first comma.
    let zeros = "0 0 0\n".repeat(3000) + &file("", |_, p| comma(p).join(" "));
    let read = good("a.xyz", zeros);
    assert_eq!((points(&read), read.scans[0].cloud.dropped_rows), (expected(1.0).as_slice(), 3000));
    // Six numbers in any case: nothing says that a comma is a decimal mark, but it may be.
    let six = file("", |i, _| format!("{},2,{},4,5,6", i % 5, 7 * i % 11));
    let read = good("a.xyz", &six);
    assert_eq!(points(&read)[1], Point::new(1.0, 2.0, 7.0));
    assert!(notes(&read).contains("! commas are read as separators"), "{}", notes(&read));
    // Both marks: one of them would be read wrong.
    let both = file("", |_, p| comma(p).join(" ")) + "1.5 2,5 3,5\n";
    assert!(
        damaged(both).contains("line 13 '1.5 2,5 3,5', expected at least three numbers with decimal commas")
    );
    // An empty field is a field.
    let text = file("id,label,x,y,z\n", |i, p| {
        format!("{i},{},{}", if i % 2 == 0 { "" } else { "\"a, b\"" }, p.join(","))
    });
    assert_eq!(points(&good("a.csv", text)), expected(1.0));
    let missing = joined("x,y,z\n", ",") + "1,,2\n";
    assert_eq!(good("a.csv", missing).scans[0].cloud.dropped_rows, 1);
}

#[test]
fn encodings_line_ends_and_numbers() {
    let text = joined("x y z\n", " ");
    let wide = |unit: fn(u16) -> [u8; 2]| -> Vec<u8> {
        "\u{feff}".encode_utf16().chain(text.encode_utf16()).flat_map(unit).collect()
    };
    let fortran = file("", |_, p| p.map(|v| format!("{v}D+00")).join("  "));
    for bytes in [
        wide(u16::to_le_bytes),
        wide(u16::to_be_bytes),
        format!("\u{feff}{text}").into_bytes(),
        text.replace('\n', "\r").into_bytes(),
        text.replacen('\n', "\r\n", 5).replacen(" ", "\t", 3).into_bytes(),
        fortran.into_bytes(),
        text.replace('-', "\u{2212}").into_bytes(),
    ] {
        assert_eq!(points(&good("a.txt", &bytes)), expected(1.0), "{}", String::from_utf8_lossy(&bytes));
    }
    let thousand = joined("", " ") + "1.0D+03 -2.5d-1 0\n";
    assert_eq!(points(&good("a.txt", thousand))[12], Point::new(1000.0, -0.25, 0.0));
}

#[test]
fn columns_that_the_user_names() {
    let columns = |text: &str| ReadOptions { columns: Some(text.parse().unwrap()), ..ReadOptions::default() };
    let text = file("a,b,c,d,e,f,g\n", |i, p| format!("{i},{},10,20,{}", p.join(","), 200 + i));
    let read = with("a.csv", &text, &columns("x=2,y=3,z=4,r=5,g=6,b=7")).unwrap();
    assert_eq!(points(&read), expected(1.0));
    assert_eq!(read.scans[0].cloud.colors.as_ref().unwrap()[3], [10, 20, 203]);
    assert_eq!(notes(&read), "columns x: b, y: c, z: d in metres; colour: e, f, g\n");
    let message = with("a.csv", &text, &columns("x=2,y=3,z=8")).unwrap_err().to_string();
    assert!(message.contains("rows of 7 columns, expected a column 8"), "{message}");
    // They come before names, which still tell the unit.
    let text = file("x,y,z,u[mm],v[mm],w[mm]\n", |_, p| format!("1,2,3,{}", p.join(",")));
    assert_eq!(points(&with("a.csv", text, &columns("x=4,y=5,z=6")).unwrap()), expected(0.001));
    // And what a user says is not doubted.
    let four = with("a.xyz", "0 1 2\n1 2 3\n2 3 4\n3 4 5\n", &columns("x=1,y=2,z=3")).unwrap();
    assert_eq!(four.scans[0].cloud.len(), 4);
}

#[test]
fn an_index_or_times_in_place_of_coordinates() {
    let first = |value: fn(usize) -> f64| damaged(file("", |i, p| format!("{} {}", value(i), p.join(" "))));
    assert!(first(|i| i as f64 + 1.0).contains("column 1 looks like an index"), "");
    for time in [
        |i: usize| 0.1 * i as f64,
        |i: usize| 1_700_000_000.0 + (i * i * i) as f64,
        |i: usize| 17.25 + 1e-5 * i as f64,
    ] {
        let message = first(time);
        assert!(
            message.contains("column 1 looks like times") && message.contains("--columns x=…"),
            "{message}"
        );
    }
    assert!(
        damaged(file("", |i, [x, y, _]| format!("{x} {y} {i}"))).contains("column 3 looks like an index")
    );
    // A line of an organised scan runs along x, and the next one begins again.
    let organised: String = (0..40).map(|i| format!("{} {} 1.5\n", i % 20, i / 20)).collect();
    assert_eq!(good("a.xyz", organised).scans[0].cloud.len(), 40);
    // Sorted along x, and large coordinates of a map, are no times.
    let sorted: String = (0..40).map(|i| format!("{} {} 1\n", 0.01 * (i * i) as f64, i % 3)).collect();
    assert_eq!(good("a.xyz", sorted).scans[0].cloud.len(), 40);
    let map = file("", |i, [_, y, z]| format!("{} {y} {z}", 5_812_345.0 + (i * i) as f64));
    assert_eq!(good("a.xyz", map).scans[0].cloud.len(), 12);
    // Names say that it is no index.
    assert_eq!(
        good("a.xyz", file("x y z\n", |i, [_, y, z]| format!("{i} {y} {z}"))).scans[0].cloud.len(),
        12
    );
}

#[test]
fn lists_of_poses_are_no_scans() {
    // Unit quaternions: a turn about z by an angle.
    let quaternion = |i: usize| format!("0 0 {:.6} {:.6}", (0.1 * i as f64).sin(), (0.1 * i as f64).cos());
    let (s, c) = (0.6, 0.8);
    for text in [
        file("", |i, p| format!("{} {} {}", 100.0 + i as f64, p.join(" "), quaternion(i))),
        file("", |i, p| format!("{} {}", p.join(" "), quaternion(i))),
        file("", |_, [x, y, z]| format!("{c} {} 0 {x} {s} {c} 0 {y} 0 0 1 {z}", -s)),
        file("", |_, [x, y, z]| format!("{c} {} 0 {x} {s} {c} 0 {y} 0 0 1 {z} 0 0 0 1", -s)),
        file("t,x,y,z,qx,qy,qz,qw\n", |_, p| format!("1,{},0,0,0,2", p.join(","))),
        file("# timestamp tx ty tz qx qy qz qw\n", |_, p| format!("1 {} 0 0 0 2", p.join(" "))),
        file("x,y,z,orientation.x,orientation.y,orientation.z,orientation.w\n", |_, p| {
            p.join(",") + ",0,0,0,2"
        }),
        file("x,y,z,roll,pitch,yaw\n", |_, p| p.join(",") + ",0,0,0"),
    ] {
        let message = no_scan(&text);
        assert!(message.contains("found a list of poses"), "{message}");
    }
    // Normals and a curvature: of length one on a plane, but no rotations.
    let normals = file("", |i, p| format!("{} 0 0.6 0.8 0.0{i}", p.join(" ")));
    assert_eq!(points(&good("a.xyz", normals)), expected(1.0));
    // Seven numbers of which the last four are no quaternion in one row.
    let colored = file("", |i, p| format!("{} {} 0 0 1", p.join(" "), i / 11));
    assert_eq!(points(&good("a.xyz", colored)), expected(1.0));
}

#[test]
fn tables_and_notes_are_no_scans() {
    for (text, found) in [
        ("585.0\n585.0\n320.0\n".to_owned(), "text with at most 1 number in a row"),
        ("585\n585\n320\n".to_owned(), "text with at most 1 number in a row"),
        ("Notes of the day\nall went well\n".to_owned(), "text without numbers"),
        ("1 2 3\n4 5 6\n7 8 9\n".to_owned(), "a table of 3 rows"),
        (
            file("i,j,overlap,other\n", |i, _| format!("{i},{},0.5,1", i + 1)),
            "a table with columns [i, j, overlap, other]",
        ),
        (file("time,value\n", |i, _| format!("{i},2")), "text with at most 2 numbers in a row"),
        (joined("ncols 3\nnrows 12\nxllcorner 0\nyllcorner 0\ncellsize 5\n", " "), "a grid of heights"),
        ("fx 585\nfy 586\nR\n1 0 0\n0 1 0\n0 0 1\nk1 0\nk2 0\n".to_owned(), "3 of 8 lines are rows"),
    ] {
        let message = no_scan(&text);
        assert!(message.contains(found), "{message}");
    }
}

#[test]
fn names_without_coordinates_say_so() {
    let three = |head: &str| damaged(joined(head, ","));
    assert!(three("range,azimuth,elevation\n").contains("ranges and angles"));
    assert!(three("lat,lon,altitude\n").contains("degrees of latitude"));
    assert!(
        three("x,y,intensity\n").contains("columns [x, y, intensity], expected columns named x, y and z")
    );
    // The writer's row numbers have no name: every name stands one column too far left.
    let shifted = damaged(file("x y z\n", |i, p| format!("{i} {}", p.join(" "))));
    assert!(shifted.contains("3 names for rows of 4 columns"), "{shifted}");
    let prose = good("a.xyz", joined("# seen with time, x, y and z\n", " "));
    assert_eq!(points(&prose), expected(1.0));
    assert!(notes(&prose).contains("! a comment names x, y and z"), "{}", notes(&prose));
}

#[test]
fn a_damaged_row_is_named_by_its_line() {
    let rows = joined("", " ");
    assert!(
        damaged(rows.clone() + "1 2\n" + &rows).contains("line 13 '1 2', expected at least three numbers")
    );
    assert!(damaged("1 2\n".to_owned() + &rows).contains("line 1 '1 2'"));
    assert!(damaged(rows.clone() + "4 five 6\n").contains("line 13 '4 five 6'"));
    assert!(damaged(rows.clone() + "7\n" + &rows).contains("line 13 '7'"));
    let colored = file("", |_, p| p.join(" ") + " 1 2 3");
    assert!(damaged(colored + "1 2 3").contains("a last row cut short, line 13: 3 fields, expected 6"));
    assert_eq!(points(&good("a.xyz", rows.trim_end())), expected(1.0));
}

#[test]
fn pts_blocks_and_counts() {
    let rows = file("", |i, p| format!("{} -{i} 10 20 30", p.join(" ")));
    let options = ReadOptions { attributes: true, ..ReadOptions::default() };
    let read = with("a.pts", format!("12\n{rows}12\n{rows}"), &options).unwrap();
    assert_eq!(read.scans.len(), 2);
    for scan in &read.scans {
        assert_eq!(scan.cloud.points, expected(1.0));
        assert_eq!(scan.cloud.colors, Some(vec![[10, 20, 30]; 12]));
        assert_eq!(scan.cloud.intensities.as_ref().unwrap()[11], -11.0);
    }
    assert!(!notes(&read).contains('!'), "{}", notes(&read));
    for (count, read_rows, said) in [(11, 11, "! 1 more row than"), (14, 12, "! 2 rows fewer than")] {
        let read = good("a.pts", format!("{count}\n{rows}"));
        assert_eq!(points(&read), &expected(1.0)[..read_rows]);
        assert!(notes(&read).contains(said), "{}", notes(&read));
    }
    let two = good("a.pts", format!("11\n{rows}13\n{rows}"));
    assert_eq!(two.scans.iter().map(|s| s.cloud.len()).collect::<Vec<_>>(), [11, 12]);
    assert!(damaged(format!("3\n{rows}")).contains("12 rows after the number 3"));
    assert!(damaged(format!("80\n12\n{rows}")).contains("line 2 '12' right after another number"));
    assert!(damaged(format!("9999\n{rows}0.5 0.25")).contains("cut short, line 14"));
    // A number of points that no memory could hold.
    let huge = good("a.pts", format!("{}\n{rows}", u64::MAX));
    assert_eq!(points(&huge), expected(1.0));
}

#[test]
fn colours_intensities_and_normals() {
    let attributes = |name: &str, text: &str| {
        let all = with(name, text, &ReadOptions { attributes: true, ..ReadOptions::default() }).unwrap();
        let plain = good(name, text).scans.remove(0).cloud;
        assert_eq!((plain.intensities, plain.normals), (None, None));
        let cloud = all.scans.into_iter().next().unwrap().cloud;
        assert_eq!((&cloud.points, &plain.colors), (&expected(1.0), &cloud.colors));
        let at = |i: usize| {
            let normal = cloud.normals.as_ref().map(|n| [n[i].x, n[i].y, n[i].z]);
            (cloud.colors.as_ref().map(|c| c[i]), cloud.intensities.as_ref().map(|v| v[i]), normal)
        };
        at(2)
    };
    let cloud_compare = file("//X Y Z R G B Intensity Nx Ny Nz\n", |i, p| {
        format!("{} 1 {i} 255 0.25 0 0.6 0.8", p.join(" "))
    });
    assert_eq!(attributes("a.asc", &cloud_compare), (Some([1, 2, 255]), Some(0.25), Some([0.0, 0.6, 0.8])));
    let photons = file("Point:0,Point:1,Point:2,Signal Photons\n", |i, p| format!("{},{i}", p.join(",")));
    assert_eq!(attributes("a.csv", &photons), (None, Some(2.0), None));
    let riegl =
        file("X,Y,Z,Reflectance[dB],red,green,blue\n", |i, p| format!("{},-{i},0,0.2,1", p.join(",")));
    assert_eq!(attributes("a.csv", &riegl), (Some([0, 51, 255]), Some(-2.0), None));
    let seven = file("", |i, p| format!("{} -{i} 1 2 3", p.join(" ")));
    assert_eq!(attributes("a.xyz", &seven), (Some([1, 2, 3]), Some(-2.0), None));
    let six = file("", |_, p| p.join(" ") + " 0 0.6 0.8");
    assert_eq!(attributes("a.xyzn", &six), (None, None, Some([0.0, 0.6, 0.8])));
    assert_eq!(attributes("a.xyz", &six), (None, None, None));
    assert_eq!(attributes("a.xyzrgb", &six), (Some([0, 153, 204]), None, None));
    assert_eq!(
        attributes("a.pts", &file("12\n", |i, p| format!("{} {i}", p.join(" ")))),
        (None, Some(2.0), None)
    );
}

#[test]
fn whole_numbers_are_probably_millimetres() {
    let whole = |largest: i32| file("", |i, _| format!("{} {} 5", (i as i32 * 97) % largest, 7 * (i % 4)));
    let read = good("a.xyz", whole(1000) + "2000 0 0\n");
    assert!(notes(&read).contains("! the coordinates are whole numbers that span more than 1000"));
    assert!(!notes(&good("a.xyz", whole(900))).contains("--unit mm"));
    let options = ReadOptions { unit_m: Some(0.001), ..ReadOptions::default() };
    let said = with("a.xyz", whole(1000) + "2000 0 0\n", &options).unwrap();
    assert_eq!(notes(&said), "");
    assert_eq!(points(&said)[12], Point::new(2.0, 0.0, 0.0));
}

#[test]
fn names_of_other_vectors_are_not_passed_over_in_a_comment() {
    // What a lidar's own sensor of motion writes; read by place it would be a scan of millimetres.
    let imu =
        |head: &str| file(head, |i, [x, y, z]| format!("{x},{y},{z},0.01,{y},1.0,{}", 28908.48 + i as f64));
    let message = no_scan(imu("//gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z,time\n"));
    assert!(message.contains("gyro_x") && message.contains("--columns"), "{message}");
    assert!(no_scan(imu("gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z,time\n")).contains("gyro_x"));
    // Prose that mentions axes is none of these, nor are names of some of the columns.
    for head in ["# x right, y up, z back\n", "# acc_x,acc_y,acc_z\n"] {
        assert_eq!(points(&good("a.csv", imu(head))), expected(1.0), "{head}");
    }
}

#[test]
fn marks_between_thousands_are_named() {
    for row in ["\"1,000.5\";\"-2,000.25\";\"3.5\"", "1.000,5;2.000,25;3,5", "1'000.5;-2'000.25;3.5"] {
        let message = damaged(format!("{row}\n").repeat(20));
        assert!(message.contains("thousands") && message.contains("000"), "{row}: {message}");
    }
    // Four digits in a group, or the same mark twice, are something else.
    assert!(!no_scan("1,0000.5;2\n".repeat(20)).contains("thousands"));
    assert!(!no_scan("1.000.5;2\n".repeat(20)).contains("thousands"));
}

#[test]
fn several_rows_of_zeros_are_directions_without_a_return() {
    let rows = file("0 0 0\n0.000 0.000 0.000\n", |_, p| p.join(" "));
    let cloud = &good("a.xyz", rows).scans[0].cloud;
    assert_eq!((cloud.points.as_slice(), cloud.dropped_rows), (expected(1.0).as_slice(), 2));
}
