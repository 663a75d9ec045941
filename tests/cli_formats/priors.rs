//! What users know of poses: rough poses of the files or from lists, and the vertical.

use super::cli_common::{text, write_ply};
use super::place::{View, half_turn, levelled, pose, room, shift, symmetric_room, views};
use super::registered::{CLOSE, Desk};
use scanweave::geometry::RigidMotion;

const NAMES: [&str; 3] = ["s0", "s1", "s2"];

fn write(views: &[View]) -> Desk {
    let desk = Desk::new();
    for (name, view) in NAMES.iter().zip(views) {
        write_ply(&desk.path(&format!("{name}.ply")), &view.points);
    }
    desk
}

/// Numbers of a motion: position and quaternion, as `tx ty tz qx qy qz qw`.
fn seven(m: &RigidMotion) -> String {
    let (t, q) = (m.translation.vector, m.rotation.coords);
    format!("{} {} {} {} {} {} {}", t.x, t.y, t.z, q.x, q.y, q.z, q.w)
}

/// Rows of a motion's matrix.
fn rows(m: &RigidMotion, count: usize) -> Vec<String> {
    let matrix = m.to_homogeneous();
    (0..count).map(|r| (0..4).map(|c| matrix[(r, c)].to_string()).collect::<Vec<_>>().join(" ")).collect()
}

/// A list of poses in the format that its name ends in.
fn list(format: &str, poses: &[RigidMotion]) -> String {
    let line = |(i, m): (usize, &RigidMotion)| match format {
        "tum" => format!("{i} {}\n", seven(m)),
        "kitti" => rows(m, 3).join(" ") + "\n",
        "csv" => format!("s{i}.ply,{}\n", seven(m).replace(' ', ",")),
        _ => format!("{i} {i} {}\n{}\n", i + 1, rows(m, 4).join("\n")),
    };
    let lines: String = poses.iter().enumerate().map(line).collect();
    if format == "csv" { format!("name,tx,ty,tz,qx,qy,qz,qw\n{lines}") } else { lines }
}

/// Poses that are off by a few centimetres and degrees, all the same way.
fn roughly(m: &RigidMotion) -> RigidMotion {
    pose([0.06, -0.05, 0.04], 2.0, [1.0, -1.0]) * m
}

/// Register with these rough poses in a file of this format.
fn with(desk: &Desk, format: &str, poses: &[RigidMotion]) -> super::registered::Registered {
    let file = desk.beside(&format!("rough.{format}"));
    std::fs::write(&file, list(format, poses)).unwrap();
    desk.register(&["--initial-poses", file.to_str().unwrap(), "--pose-deviation", "0.2,5"])
}

#[test]
fn rough_poses_decide_where_the_scans_do_not() {
    // In a room that is the same from two sides, every scan may as well stand at the other side. The rough
    // poses of each format say another thing about scan 1, so that no result is right by chance.
    let mut views = levelled(&symmetric_room(), [80, 32]);
    let desk = write(&views);
    let straight = views[1].world_from_file;
    for (format, turned) in [("tum", false), ("kitti", true), ("csv", false), ("log", true)] {
        views[1].world_from_file = if turned { half_turn() * straight } else { straight };
        let rough: Vec<RigidMotion> = views.iter().map(|v| roughly(&v.world_from_file)).collect();
        let done = with(&desk, format, &rough);
        done.agrees(&NAMES, &views, CLOSE);
        assert!(!done.stderr.contains("contradict"), "{format}: {}", done.stderr);
    }
}

#[test]
fn a_rough_pose_that_the_scans_contradict_is_overruled_and_named() {
    let views = views();
    let desk = write(&views);
    let mut rough: Vec<RigidMotion> = views.iter().map(|v| v.world_from_file).collect();
    rough[2] = shift([1.5, -0.8, 0.0]) * rough[2] * pose([0.0; 3], 60.0, [0.0; 2]);
    let done = with(&desk, "tum", &rough);
    done.agrees(&NAMES, &views, CLOSE);
    done.says(&["s2: the scans contradict its rough pose, by "]);
    let turned = done.stderr.split(" degrees").next().and_then(|text| text.rsplit(' ').next());
    let turned: f64 = turned.and_then(|number| number.parse().ok()).expect(&done.stderr);
    assert!((turned - 60.0).abs() < 0.5, "{}", done.stderr);
    // The others are where the list has them.
    for name in ["s0", "s1"] {
        assert!(!done.stderr.contains(&format!("{name}: the scans")), "{}", done.stderr);
        let view = &views[usize::from(name == "s1")];
        done.is_at(name, view, &view.world_from_file, CLOSE);
    }
}

#[test]
fn own_takes_coordinates_as_they_are_for_rough_poses() {
    // Scans in the coordinates of the room, but for one that was left in those of its scanner.
    let mut views: Vec<View> = views().iter().map(|v| v.moved(&roughly(&v.world_from_file))).collect();
    views[2] = views[2].moved(&pose([1.7, 1.1, 0.0], 100.0, [0.0; 2]));
    let desk = write(&views);
    let without = desk.register(&["--reference", "s0"]);
    without.agrees(&NAMES, &views, CLOSE);
    assert_eq!(without.stderr, "");
    let done = desk.register(&["--initial-poses", "own", "--pose-deviation", "0.2,5"]);
    done.agrees(&NAMES, &views, CLOSE);
    done.says(&["s2: the scans contradict its rough pose"]);
    for (name, view) in NAMES.iter().zip(&views).take(2) {
        assert!(!done.stderr.contains(&format!("{name}: ")), "{}", done.stderr);
        done.is_at(name, view, &RigidMotion::identity(), CLOSE);
    }
}

#[test]
fn poses_that_belong_to_no_scan_are_an_error() {
    let views = views();
    let desk = write(&views);
    let file = desk.beside("rough.csv");
    std::fs::write(&file, "name,tx,ty,tz,qx,qy,qz,qw\ns9.ply,0,0,0,0,0,0,1\n").unwrap();
    let assert = desk.command(&["--initial-poses", file.to_str().unwrap()]).assert().code(3);
    let stderr = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
    for part in ["rough.csv", "s9.ply", "expected"] {
        assert!(stderr.contains(part), "{part} is not in: {stderr}");
    }
}

#[test]
fn the_vertical_counts_against_poses_that_tilt_it() {
    let views = levelled(&room(), [80, 32]);
    let desk = write(&views);
    let upright = desk.register(&["--gravity", "z", "--level"]);
    upright.agrees(&NAMES, &views, CLOSE);
    for name in NAMES {
        assert_eq!(upright.evidence(name, "prior_penalty"), None, "{name}");
        // Levelled scans keep their vertical.
        let up = upright.pose(name).unwrap().rotation * nalgebra::Vector3::z();
        assert!(up.z > 0.5f64.to_radians().cos(), "{name}: {up}");
    }
    let config = text(upright.output.join("config.toml"));
    assert!(config.contains("up = \"z\"") && config.contains("tilt_deviation_deg = 1.0"), "{config}");
    // The scans are turned about z by 120°: were x the vertical, that would be impossible. The prior
    // lowers the odds by a factor of 100 at most, so that clear evidence stands against it.
    let wrong = desk.register(&["--gravity", "x", "--level"]);
    wrong.agrees(&NAMES, &views, CLOSE);
    let penalties: Vec<f64> = NAMES.iter().filter_map(|name| wrong.evidence(name, "prior_penalty")).collect();
    let most = 100f64.ln();
    assert!(!penalties.is_empty());
    assert!(penalties.iter().all(|p| *p > 0.9 * most && *p < most + 1e-9), "{penalties:?}");
}
