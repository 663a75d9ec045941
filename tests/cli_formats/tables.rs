//! Scans as text: named columns, decimal commas, counts before the points.

use super::place::{View, views};
use super::registered::{CLOSE, Desk};

/// A table of a view: a header, and what stands in each row after the coordinates.
fn write(desk: &Desk, extension: &str, content: impl Fn(&View) -> String) -> Vec<View> {
    let views = views();
    for (i, view) in views.iter().enumerate() {
        desk.file(&format!("s{i}.{extension}"), content(view));
    }
    views
}

const NAMES: [&str; 3] = ["s0", "s1", "s2"];

#[test]
fn csv_with_the_names_of_livox_is_in_metres_beside_millimetres() {
    const HEADER: &str = "Version,Slot ID,LiDAR Index,Timestamp,X,Y,Z,Reflectivity,Tag,Ori_x,Ori_y,Ori_z\n";
    let desk = Desk::new();
    let views = write(&desk, "csv", |view| {
        let row = |(i, [x, y, z]): (usize, &[f64; 3])| {
            let [mx, my, mz] = [x, y, z].map(|v| (v * 1000.0).round());
            format!("5,1,1,{},{x:.3},{y:.3},{z:.3},{},0,{mx},{my},{mz}\n", 2_444_124 + i, i % 256)
        };
        view.points.iter().enumerate().map(row).fold(HEADER.to_owned(), |text, row| text + &row)
    });
    let done = desk.register(&[]);
    done.agrees(&NAMES, &views, CLOSE);
    done.says(&["s0.csv and 2 more", "x: X, y: Y, z: Z in metres", "not taken: Ori_x, Ori_y, Ori_z"]);
}

#[test]
fn csv_with_the_names_of_ouster_is_in_metres() {
    const HEADER: &str = "\"Point:0\",\"Point:1\",\"Point:2\",\"Signal Photons\",\"Range\"\n";
    let desk = Desk::new();
    let views = write(&desk, "csv", |view| HEADER.to_owned() + &view.text(",", ",10.0,1613.5"));
    let done = desk.register(&[]);
    done.agrees(&NAMES, &views, CLOSE);
    done.says(&["x: Point:0, y: Point:1, z: Point:2 in metres"]);
}

#[test]
fn units_in_the_names_of_columns_are_followed() {
    const HEADER: &str = "TIMESTAMP (ns),SIGNAL,X (mm),Y (mm),Z (mm)\n";
    let desk = Desk::new();
    let views = write(&desk, "csv", |view| {
        let row = |p: &[f64; 3]| {
            let [x, y, z] = p.map(|v| (v * 1000.0).round());
            format!("18446,12,{x},{y},{z}\n")
        };
        view.points.iter().map(row).fold(HEADER.to_owned(), |text, row| text + &row)
    });
    let done = desk.register(&[]);
    done.agrees(&NAMES, &views, CLOSE);
    done.says(&["x: X (mm), y: Y (mm), z: Z (mm) in mm"]);
}

#[test]
fn decimal_commas_between_blanks_are_read() {
    let desk = Desk::new();
    let views = write(&desk, "xyz", |view| view.text(" ", "").replace('.', ","));
    let done = desk.register(&[]);
    done.agrees(&NAMES, &views, CLOSE);
    done.says(&["s0.xyz and 2 more: commas are read as decimal marks"]);
}

#[test]
fn pts_with_a_row_more_than_it_counts_is_read_to_the_count_with_a_warning() {
    let desk = Desk::new();
    // The last row, which the count leaves out, is far off: taken as a point it would be seen.
    let views = write(&desk, "pts", |view| {
        format!("{}\n{}9000 9000 9000 -1000\n", view.points.len(), view.text(" ", " -1000"))
    });
    let done = desk.register(&[]);
    done.agrees(&NAMES, &views, CLOSE);
    done.says(&["warning: ", "s0.pts and 2 more: 1 more row than the number of points before them"]);
}

#[test]
fn pts_with_three_blocks_is_three_scans() {
    let desk = Desk::new();
    let views = views();
    let blocks: String =
        views.iter().map(|v| format!("{}\n{}", v.points.len(), v.text(" ", " -1000 90 90 90"))).collect();
    desk.file("project.pts", blocks);
    let done = desk.register(&[]);
    done.agrees(&["project#1", "project#2", "project#3"], &views, CLOSE);
}

#[test]
fn a_table_beside_scans_is_named_and_left_out() {
    let desk = Desk::new();
    let views = write(&desk, "xyz", |view| view.text(" ", ""));
    desk.file("calibration.csv", "parameter,value\nfocal,525.0\noffset,12\n");
    // Known by its name, whatever numbers it holds.
    desk.file("poses.csv", "name,tx,ty,tz\na,1,2,3\n");
    let done = desk.register(&[]);
    done.agrees(&NAMES, &views, CLOSE);
    done.says(&["skipped: ", "calibration.csv: no scan: ", "poses.csv: no scan: "]);
}
