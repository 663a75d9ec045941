//! Clouds: PLY, PCD, BIN, and what numbers are added to their coordinates.

use super::cli_common::write_ply;
use super::place::{SURVEY, View, levelled, pose, room, shift, views};
use super::registered::{CLOSE, Desk, Registered, difference};

const NAMES: [&str; 3] = ["s0", "s1", "s2"];

/// Each view by `content` into a file of its own.
fn write(desk: &Desk, extension: &str, views: &[View], content: impl Fn(usize, &View) -> Vec<u8>) {
    for (i, view) in views.iter().enumerate() {
        desk.file(&format!("s{i}.{extension}"), content(i, view));
    }
}

#[test]
fn what_is_added_to_coordinates_changes_no_pose() {
    let register = |views: &[View]| {
        let desk = Desk::new();
        write(&desk, "xyz", views, |_, view| view.text(" ", "").into_bytes());
        let done = desk.register(&[]);
        done.agrees(&NAMES, views, CLOSE);
        done
    };
    let low = views();
    let at_zero = register(&low);
    for by in [[0.0, 0.0, 381.0], SURVEY] {
        let moved: Vec<View> = low.iter().map(|v| v.moved(&shift(by))).collect();
        // The poses of the first run, for the coordinates of the second, as if they were the truth.
        let expected = NAMES.iter().zip(&moved).map(|(name, view)| View {
            world_from_file: at_zero.pose(name).unwrap() * shift(by.map(|v| -v)),
            ..view.clone()
        });
        register(&moved).agrees(&NAMES, &expected.collect::<Vec<_>>(), (0.001, 0.01));
    }
}

#[test]
fn ascii_ply_may_have_a_row_on_two_lines() {
    let (desk, views) = (Desk::new(), views());
    write(&desk, "ply", &views, |_, view| {
        let mut text = format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
            view.points.len()
        );
        text += &view.text(" ", "\n200 180 40");
        text.into_bytes()
    });
    let done = desk.register(&[]);
    done.agrees(&NAMES, &views, CLOSE);
    assert_eq!(done.stderr, "");
}

#[test]
fn bin_of_kitti_is_read_as_four_numbers_a_row() {
    let (desk, views) = (Desk::new(), views());
    write(&desk, "bin", &views, |_, view| {
        let rows = view.points.iter().enumerate().flat_map(|(i, [x, y, z])| {
            [*x as f32, *y as f32, *z as f32, (i % 100) as f32 / 100.0].map(f32::to_le_bytes)
        });
        rows.flatten().collect()
    });
    let done = desk.register(&[]);
    done.agrees(&NAMES, &views, CLOSE);
    done.says(&["s0.bin and 2 more: a .bin file is read as float32 rows x y z intensity (KITTI)"]);
}

/// A binary PCD with this VIEWPOINT.
fn pcd(view: &View, viewpoint: &str) -> Vec<u8> {
    let n = view.points.len();
    let mut bytes = format!(
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {n}\nHEIGHT 1\n\
         VIEWPOINT {viewpoint}\nPOINTS {n}\nDATA binary\n"
    )
    .into_bytes();
    bytes.extend(view.points.iter().flatten().flat_map(|v| (*v as f32).to_le_bytes()));
    bytes
}

#[test]
fn a_pcd_viewpoint_that_is_a_pose_is_no_place_beside_the_points() {
    // The scanners stood a hundred metres and more from the zero of the site.
    let site = shift([104.0, 52.9, 0.1]) * pose([0.0; 3], 31.0, [0.0; 2]);
    let (posed, bare, views) = (Desk::new(), Desk::new(), views());
    write(&posed, "pcd", &views, |_, view| {
        let at = site * view.world_from_file;
        let (t, q) = (at.translation.vector, at.rotation.coords);
        pcd(view, &format!("{} {} {} {} {} {} {}", t.x, t.y, t.z, q.w, q.x, q.y, q.z))
    });
    write(&bare, "pcd", &views, |_, view| pcd(view, "0 0 0 1 0 0 0"));
    let (with, without) = (posed.register(&[]), bare.register(&[]));
    with.agrees(&NAMES, &views, CLOSE);
    without.agrees(&NAMES, &views, CLOSE);
    for name in NAMES {
        let inliers = |run: &Registered| run.evidence(name, "inliers").unwrap();
        let (a, b) = (inliers(&with), inliers(&without));
        assert!((a - b).abs() <= 0.05 * b, "{name}: {a} inliers with a pose, {b} without");
    }
    // Poses of files have a frame in common: that is where the result is.
    for (name, view) in NAMES.iter().zip(&views) {
        with.is_at(name, view, &(site * view.world_from_file), CLOSE);
    }
}

/// The scans of a run that were placed, with their views and how far they are off; the first is right.
fn errors(done: &Registered, views: &[View]) -> Vec<(&'static str, f64)> {
    let placed = NAMES.into_iter().zip(views).filter_map(|(n, v)| Some((n, v, done.pose(n)?)));
    let placed: Vec<_> = placed.collect();
    let Some((_, first, pose)) = placed.first() else { return Vec::new() };
    let world_from_result = first.world_from_file * pose.inverse();
    let off = |view: &View, pose| difference(view, &(world_from_result * pose), &view.world_from_file).0;
    placed.iter().map(|(name, view, pose)| (*name, off(view, pose))).collect()
}

#[test]
fn scans_of_few_points_are_placed_right_or_declined() {
    const USUAL: [&str; 4] =
        ["--set", "descriptor.kind=mini-spin-net-fpfh", "--set", "descriptor.keypoints.count=2500"];
    let mut joined = 0;
    for size in [[25, 12], [20, 15], [30, 10]] {
        let views = levelled(&room(), size);
        assert_eq!(views[0].points.len(), 300);
        let desk = Desk::new();
        for (name, view) in NAMES.iter().zip(&views) {
            write_ply(&desk.path(&format!("{name}.ply")), &view.points);
        }
        let placed = errors(&desk.register_or_decline(&USUAL), &views);
        assert!(placed.iter().all(|(_, far)| *far < 0.5), "{size:?}: {placed:?}");
        joined += placed.len().saturating_sub(1);
    }
    // Otherwise nothing is seen here.
    assert!(joined > 0, "all are declined");
}
