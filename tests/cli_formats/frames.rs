//! In which coordinates the poses of a result are.

use super::cli_common::write_ply;
use super::place::{SURVEY, View, pose, shift, surveyed, views};
use super::registered::{CLOSE, Desk};
use predicates::prelude::*;
use predicates::str::contains;
use scanweave::geometry::RigidMotion;

const NAMES: [&str; 3] = ["s0", "s1", "s2"];

fn write(views: &[View]) -> Desk {
    let desk = Desk::new();
    for (name, view) in NAMES.iter().zip(views) {
        write_ply(&desk.path(&format!("{name}.ply")), &view.points);
    }
    desk
}

/// Rough georeferencing: the third scan is 0.5 m and 5° beside where it belongs.
fn with_one_off() -> (Desk, Vec<View>) {
    let off = shift([3.0, 2.0, 0.0]) * pose([0.3, 0.4, 0.0], 5.0, [0.0; 2]) * shift([-3.0, -2.0, 0.0]);
    let views = surveyed(&[RigidMotion::identity(), RigidMotion::identity(), off]);
    let desk = Desk::new();
    for (name, view) in NAMES.iter().zip(&views) {
        desk.file(&format!("{name}.xyz"), view.text(" ", ""));
    }
    (desk, views)
}

#[test]
fn a_scan_named_as_reference_stays_where_it_is() {
    let views = views();
    let desk = write(&views);
    for reference in ["s1", "s2"] {
        let done = desk.register(&["--reference", reference]);
        done.agrees(&NAMES, &views, CLOSE);
        let matrix = done.pose(reference).unwrap().to_homogeneous();
        assert!((matrix - nalgebra::Matrix4::identity()).abs().max() < 1e-9, "{reference}: {matrix}");
    }
    desk.command(&["--reference", "s7"])
        .assert()
        .code(4)
        .stderr(contains("s7").and(contains("the name of a scan, such as s0")));
}

#[test]
fn without_coordinates_in_common_one_scan_stays() {
    let views = views();
    let done = write(&views).register(&[]);
    let stays =
        |name: &&str| (done.pose(name).unwrap().to_homogeneous() - nalgebra::Matrix4::identity()).norm();
    let staying: Vec<f64> = NAMES.iter().map(stays).collect();
    assert_eq!(staying.iter().filter(|d| **d < 1e-9).count(), 1, "{staying:?}");
}

#[test]
fn with_coordinates_in_common_the_sum_of_motions_is_least() {
    // The sum of distances is least where two of three scans stay, and the one that is off moves alone.
    let (desk, views) = with_one_off();
    let done = desk.register(&[]);
    done.agrees(&NAMES, &views, CLOSE);
    for (name, view) in NAMES.iter().zip(&views) {
        done.is_at(name, view, &(shift(SURVEY) * view.world_from_file), CLOSE);
    }
    // Not so where the one that is off is the reference.
    let done = desk.register(&["--reference", "s2"]);
    done.agrees(&NAMES, &views, CLOSE);
    done.is_at("s2", &views[2], &RigidMotion::identity(), (1e-6, 1e-6));
}
