use super::*;
use crate::geometry::{Direction, Point};
use crate::monitor::Silent;
use crate::scan::{Outcome, Placement, Scan};
use nalgebra::Vector3;

/// A component that the scan is placed in.
fn placed(world_from_scan: RigidMotion, component: usize) -> Outcome {
    Outcome::Placed(Placement {
        world_from_scan,
        component,
        step: 0,
        parent: None,
        matches: 0,
        inliers: 0,
        residual_m: 0.0,
        evidence: None,
        neighbours: Vec::new(),
        pose_uncertainty: None,
    })
}

/// Writes two scans with all attributes; the first is turned by a quarter turn about z and moved far
/// away: (x, y, z) → (4e5 − y, 2 + x, 3 + z). The second has a component of its own.
fn result(folder: &Path) -> Document {
    let points: Vec<Point> = (0..12).map(|k| Point::new(k as f32, 2.0, 0.25 * k as f32)).collect();
    let cloud = io::PlyCloud {
        points: &points,
        normals: Some(&[Direction::x(); 12]),
        colors: Some(&[[10, 20, 30]; 12]),
        intensities: Some(&[0.5; 12]),
        ..io::PlyCloud::default()
    };
    let scan = |k: usize| {
        let path = folder.join(format!("s{k}.ply"));
        io::write_ply(&path, &cloud).unwrap();
        Scan { id: ScanId(k), name: format!("s{k}"), path: Some(path), ..Scan::default() }
    };
    let turn = Vector3::z() * std::f64::consts::FRAC_PI_2;
    let moved = RigidMotion::new(Vector3::new(4e5, 2.0, 3.0), turn);
    let outcomes = vec![placed(moved, 0), placed(RigidMotion::identity(), 1)];
    Document::new(&[scan(0), scan(1)], &Reconstruction { outcomes }, 0.07)
}

#[test]
fn scans_are_written_whole_and_moved_with_what_the_format_has_room_for() {
    let folder = tempfile::tempdir().unwrap();
    let document = result(folder.path());
    let attributes = ReadOptions { attributes: true, ..ReadOptions::default() };
    for format in [ScanFormat::Ply, ScanFormat::Pcd, ScanFormat::Las, ScanFormat::Laz, ScanFormat::E57] {
        let out = folder.path().join(format.extension());
        let export =
            |replace| export_scans(&document, &ReadOptions::default(), &out, format, replace, &Silent);
        let files = export(false).unwrap().files;
        let names = match format {
            ScanFormat::E57 => ["scans.e57".to_owned(), "scans_1.e57".to_owned()],
            _ => ["s0", "component_1/s1"].map(|n| format!("{n}.{}", format.extension())),
        };
        assert_eq!(files, names.map(|n| out.join(n)));
        assert!(matches!(export(false), Err(Error::OutputExists { .. })));
        export(true).unwrap();

        let stored = io::read_file(&files[0], &attributes).unwrap().scans.remove(0);
        // An E57 file has the pose beside the points.
        let world_from_file = match format {
            ScanFormat::E57 => stored.pose.unwrap(),
            _ => RigidMotion::identity(),
        };
        let world_from_points = world_from_file * stored.cloud.file_from_points();
        assert_eq!(stored.cloud.len(), 12);
        for (k, point) in stored.cloud.points.iter().enumerate() {
            let k = k as f64;
            let expected = nalgebra::Point3::new(4e5 - 2.0, 2.0 + k, 3.0 + 0.25 * k);
            let found = world_from_points * point.cast::<f64>();
            assert!((found - expected).norm() < 1e-5, "{format:?}: {found}, not {expected}");
        }
        assert_eq!(stored.cloud.colors, Some(vec![[10, 20, 30]; 12]), "{format:?}");
        let intensities = stored.cloud.intensities.unwrap();
        let las = matches!(format, ScanFormat::Las | ScanFormat::Laz);
        // Half of the 65535 of LAS, whatever a reader makes of it.
        let expected = if las && intensities[0] > 1.0 { 32768.0 } else { 0.5 };
        assert!(intensities.iter().all(|v| (v - expected).abs() < 1e-4), "{format:?}: {intensities:?}");
        if matches!(format, ScanFormat::Ply | ScanFormat::Pcd) {
            let normals = stored.cloud.normals.unwrap();
            assert!(normals.iter().all(|n| (n - Direction::y()).norm() < 1e-6), "{format:?}: {normals:?}");
        }
    }
}

#[test]
fn a_scan_whose_file_is_gone_is_an_error_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let document = result(folder.path());
    std::fs::remove_file(folder.path().join("s1.ply")).unwrap();
    let out = folder.path().join("out");
    let format = ScanFormat::E57;
    let error = export_scans(&document, &ReadOptions::default(), &out, format, false, &Silent);
    assert!(error.unwrap_err().to_string().contains("s1.ply"));
    assert!(!out.join("scans_1.e57").exists());
}

/// A result of scans with these names and files, all placed where they are, as one component.
fn result_of(scans: &[(&str, PathBuf)]) -> Document {
    let outcomes = scans.iter().map(|_| placed(RigidMotion::identity(), 0)).collect();
    let scan = |(k, (name, path)): (usize, &(&str, PathBuf))| {
        let (name, path) = ((*name).to_owned(), Some(path.clone()));
        Scan { id: ScanId(k), name, path, ..Scan::default() }
    };
    let scans: Vec<Scan> = scans.iter().enumerate().map(scan).collect();
    Document::new(&scans, &Reconstruction { outcomes }, 0.07)
}

/// A file of as many points as `x`, one at each of these places.
fn file_at(path: PathBuf, x: &[f32], colors: Option<&[[u8; 3]]>) -> PathBuf {
    let points: Vec<Point> = x.iter().map(|&x| Point::new(x, 1.0, 2.0)).collect();
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    io::write_ply(&path, &io::PlyCloud { points: &points, colors, ..io::PlyCloud::default() }).unwrap();
    path
}

fn export(document: &Document, out: &Path, format: ScanFormat) -> Result<Exported> {
    export_scans(document, &ReadOptions::default(), out, format, true, &Silent)
}

/// The first x of every file, or of every scan of the first.
fn first_x(files: &[PathBuf]) -> Vec<f32> {
    let scans = |file: &PathBuf| io::read_file(file, &ReadOptions::default()).unwrap().scans;
    files.iter().flat_map(scans).map(|s| s.cloud.points[0].x).collect()
}

/// Names of all that lies in a folder and in the folders in it.
fn names_in(folder: &Path) -> Vec<String> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => names.extend(names_in(&path)),
            false => names.push(path.file_name().unwrap().to_string_lossy().into_owned()),
        }
    }
    names.sort();
    names
}

#[test]
fn scans_of_the_same_name_have_files_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, x: f32| file_at(folder.path().join(name), &[x], None);
    let document = result_of(&[
        ("a/room", at("a/room.ply", 1.0)),
        ("b/room", at("b/room.ply", 2.0)),
        ("room#2", at("room#2.ply", 3.0)),
        ("Room#2", at("d/Room#2.ply", 4.0)),
    ]);
    for format in [ScanFormat::Ply, ScanFormat::Pcd, ScanFormat::Las, ScanFormat::E57] {
        let out = folder.path().join("out").join(format.extension());
        let files = export(&document, &out, format).unwrap().files;
        assert_eq!(first_x(&files), [1.0, 2.0, 3.0, 4.0], "{files:?}");
        assert!(files.iter().all(|f| f.starts_with(&out)));
    }
}

#[test]
fn scans_of_one_file_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let one = |x: f32| file_at(folder.path().join(format!("{x}.ply")), &[x], None);
    let singles = result_of(&[("a", one(1.0)), ("b", one(2.0)), ("c", one(3.0))]);
    let e57 = export(&singles, &folder.path().join("e57"), ScanFormat::E57).unwrap().files;
    // Text that is held whole has three scans, too: a count before each.
    let pts = folder.path().join("three.pts");
    // The first x is the number of the scan.
    let row = |k: usize, i: usize| {
        format!("{:.3} {:.3} 2\n", k as f64 + (0.7 * i as f64).sin(), (1.3 * i as f64).cos())
    };
    let scan = |k: usize| format!("20\n{}", (0..20).map(|i| row(k, i)).collect::<String>());
    std::fs::write(&pts, (1..4).map(scan).collect::<String>()).unwrap();
    for file in [e57[0].clone(), pts] {
        let names = ["f#1", "f#2", "f#3"].map(|name| (name, file.clone()));
        let mut document = result_of(&names);
        // Not in the order of the file.
        (0..3).for_each(|k| document.scans[k].part = Some(2 - k));
        let files = export(&document, &folder.path().join("out"), ScanFormat::Ply).unwrap().files;
        assert_eq!(first_x(&files), [3.0, 2.0, 1.0], "{}", file.display());
        // A file with fewer scans than were registered.
        document.scans[0].part = Some(3);
        let error = export(&document, &folder.path().join("out"), ScanFormat::Ply).unwrap_err().to_string();
        assert!(error.contains("no scan 4 in it"), "{error}");
    }
}

#[test]
fn scans_without_a_pose_are_named_and_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut document = result(folder.path());
    let unplaced = crate::result::poses::EntryOutcome::Declined {
        decline: crate::scan::DeclineReason::TooFewInliers { inliers: 3, needed: 9, matches: 20 },
        explanation: String::new(),
    };
    document.scans[1].outcome = unplaced;
    document.components.truncate(1);
    // Its file is not even looked for.
    std::fs::remove_file(folder.path().join("s1.ply")).unwrap();
    for format in [ScanFormat::Laz, ScanFormat::E57] {
        let out = folder.path().join(format.extension());
        let exported = export(&document, &out, format).unwrap();
        assert_eq!((exported.files.len(), exported.left_out), (1, vec!["s1".to_owned()]));
        assert_eq!(names_in(&out).iter().filter(|name| !name.starts_with('.')).count(), 1);
    }
}

#[test]
fn the_files_of_the_scans_are_never_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let document = result(folder.path());
    let before = std::fs::read(folder.path().join("s0.ply")).unwrap();
    // Another way to the same folder.
    let same = folder.path().join("new").join("..");
    std::fs::create_dir_all(folder.path().join("new")).unwrap();
    for out in [folder.path(), &same] {
        let error = export(&document, out, ScanFormat::Ply).unwrap_err().to_string();
        assert!(error.contains("the scans that were registered"), "{error}");
    }
    assert_eq!(std::fs::read(folder.path().join("s0.ply")).unwrap(), before);
    // Other files beside the scans would be taken for more of them.
    let error = export(&document, folder.path(), ScanFormat::Pcd).unwrap_err().to_string();
    assert!(error.contains("the scans that were registered"), "{error}");
    assert!(!folder.path().join("s0.pcd").exists());
    assert_eq!(std::fs::read(folder.path().join("s0.ply")).unwrap(), before);
}

#[test]
fn scans_with_and_without_colours_stand_side_by_side() {
    let folder = tempfile::tempdir().unwrap();
    let document = result_of(&[
        ("grey", file_at(folder.path().join("grey.ply"), &[1.0], None)),
        ("red", file_at(folder.path().join("red.ply"), &[2.0], Some(&[[200, 1, 2]]))),
    ]);
    for format in [ScanFormat::Ply, ScanFormat::Pcd, ScanFormat::Laz, ScanFormat::E57] {
        let files = export(&document, &folder.path().join("out"), format).unwrap().files;
        let scans: Vec<_> =
            files.iter().flat_map(|f| io::read_file(f, &ReadOptions::default()).unwrap().scans).collect();
        let colors: Vec<_> = scans.into_iter().map(|s| s.cloud.colors).collect();
        assert_eq!(colors, [None, Some(vec![[200, 1, 2]])], "{format:?}");
    }
}

#[test]
fn las_keeps_millimetres_at_utm_offsets() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.xyz");
    // Whole millimetres on a circle of 20 m.
    let row = |k: i32| {
        let (sin, cos) = (0.7 * f64::from(k)).sin_cos();
        [431_250.001 + 20.0 * sin, 5_812_345.002 + 20.0 * cos, 101.003 + 0.1 * cos]
            .map(|c| (1e3 * c).round() / 1e3)
    };
    let rows: Vec<[f64; 3]> = (0..50).map(row).collect();
    let text: String = rows.iter().map(|[x, y, z]| format!("{x:.3} {y:.3} {z:.3}\n")).collect();
    std::fs::write(&path, text).unwrap();
    let document = result_of(&[("a", path)]);
    for format in [ScanFormat::Las, ScanFormat::Laz] {
        let files = export(&document, &folder.path().join("out"), format).unwrap().files;
        // Read by the crate itself, in double precision.
        let mut reader = las::Reader::from_path(&files[0]).unwrap();
        let (data, axes) = (reader.read_all().unwrap(), *reader.header().transforms());
        let stored = data.x_raw().zip(data.y_raw()).zip(data.z_raw());
        let points: Vec<[f64; 3]> = stored
            .map(|((x, y), z)| [(x, axes.x), (y, axes.y), (z, axes.z)])
            .map(|point| point.map(|(v, axis)| f64::from(v) * axis.scale + axis.offset))
            .collect();
        assert_eq!(points.len(), rows.len());
        for (found, expected) in points.iter().zip(&rows) {
            let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-4, "{format:?}: off by {off}");
        }
    }
}

/// Stops after so many questions, and remembers what it was told.
#[derive(Default)]
struct Stopping {
    after: usize,
    asked: std::sync::atomic::AtomicUsize,
    told: std::sync::Mutex<Vec<(String, usize, Vec<usize>)>>,
}

impl Monitor for Stopping {
    fn begin(&self, stage: &str, total: usize) {
        self.told.lock().unwrap().push((stage.to_owned(), total, Vec::new()));
    }
    fn advance(&self, items: usize) {
        self.told.lock().unwrap().last_mut().unwrap().2.push(items);
    }
    fn cancelled(&self) -> bool {
        self.asked.fetch_add(1, std::sync::atomic::Ordering::SeqCst) >= self.after
    }
}

#[test]
fn progress_moves_within_a_scan_and_a_stop_between_blocks_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let points = 2 * io::BLOCK_POINTS + 7;
    let x: Vec<f32> = (0..points).map(|k| k as f32 * 1e-3).collect();
    let document = result_of(&[("a", file_at(folder.path().join("a.ply"), &x, None))]);
    for format in [ScanFormat::Ply, ScanFormat::Pcd, ScanFormat::Las, ScanFormat::Laz, ScanFormat::E57] {
        let out = folder.path().join("out");
        let run = |monitor: &Stopping| {
            export_scans(&document, &ReadOptions::default(), &out, format, false, monitor)
        };
        // Three blocks are read, then the second is about to be written.
        let monitor = Stopping { after: 4, ..Stopping::default() };
        assert!(matches!(run(&monitor), Err(Error::Interrupted { .. })), "{format:?}");
        assert_eq!(names_in(&out), Vec::<String>::new(), "{format:?}");
        let monitor = Stopping { after: usize::MAX, ..Stopping::default() };
        let written = run(&monitor).unwrap().files;
        let steps = vec![io::BLOCK_POINTS, io::BLOCK_POINTS, 7];
        let stage = |name: &str| (format!("{name} scan 1 of 1"), points, steps.clone());
        assert_eq!(monitor.told.into_inner().unwrap(), [stage("reading"), stage("writing")], "{format:?}");
        assert_eq!(names_in(&out).iter().filter(|name| !name.starts_with('.')).count(), 1);
        std::fs::remove_file(&written[0]).unwrap();
    }
}

#[test]
fn e57_headers_tell_scans_apart_and_where_they_lie() {
    let folder = tempfile::tempdir().unwrap();
    let mut document = result(folder.path());
    let export = |document: &Document, name: &str| {
        let files = export(document, &folder.path().join(name), ScanFormat::E57).unwrap().files;
        let open = |file: &PathBuf| e57::E57Reader::from_file(file).unwrap();
        files.iter().map(open).collect::<Vec<_>>()
    };
    let readers = export(&document, "one");
    let scan = &readers[0].pointclouds()[0];
    assert_eq!(scan.name.as_deref(), Some("s0"));
    // In the coordinates of the scan: x from 0 to 11, y at 2, z from 0 to 11/4.
    let bounds = scan.cartesian_bounds.as_ref().unwrap();
    let found = [bounds.x_min, bounds.x_max, bounds.y_min, bounds.y_max, bounds.z_min, bounds.z_max];
    assert_eq!(found, [0.0, 11.0, 2.0, 2.0, 0.0, 2.75].map(Some));
    let pose = scan.transform.as_ref().unwrap();
    // A quarter turn about z: cos 45° and sin 45°.
    let half = 0.5f64.sqrt();
    let rotation = [pose.rotation.w, pose.rotation.x, pose.rotation.y, pose.rotation.z];
    assert!(rotation.iter().zip([half, 0.0, 0.0, half]).all(|(a, b)| (a - b).abs() < 1e-12));
    assert!((pose.translation.x - 4e5).abs() + (pose.translation.y - 2.0).abs() < 1e-9);
    let guids = |readers: &[e57::E57Reader<_>]| -> Vec<String> {
        let of_scans = readers.iter().flat_map(|r| r.pointclouds()).map(|s| s.guid.unwrap());
        readers.iter().map(|r| r.guid().to_owned()).chain(of_scans).collect()
    };
    let first = guids(&readers);
    let different: std::collections::BTreeSet<&String> = first.iter().collect();
    assert_eq!(different.len(), 4, "{first:?}");
    assert_eq!(first, guids(&export(&document, "again")));
    // Another pose is another file.
    if let crate::result::poses::EntryOutcome::Placed(pose) = &mut document.scans[0].outcome {
        pose.world_from_scan[0][3] += 1.0;
    }
    let moved = guids(&export(&document, "moved"));
    assert!(first[0] != moved[0] && first[2] != moved[2] && first[1] == moved[1], "{first:?} {moved:?}");
}
