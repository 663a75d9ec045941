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
