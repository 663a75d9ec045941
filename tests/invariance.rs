//! What the coordinates of a file are changes a scan's pose and nothing else.
//!
//! The sensor's place is stated, so that it moves with the points: where a file does not state it, its
//! zero is tried first, which is something that a shift of the coordinates changes.

use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scanweave::Silent;
use scanweave::config::Config;
use scanweave::descriptor::DescriptorKind;
use scanweave::geometry::RigidMotion;
use scanweave::scan::{Reconstruction, Scan, ScanId};
use scanweave::synthetic::{SynthConfig, generate};
use std::sync::OnceLock;

/// Points of the scans of an interior, each with its sensor at zero.
fn interior() -> &'static Vec<Vec<[f64; 3]>> {
    static INTERIOR: OnceLock<Vec<Vec<[f64; 3]>>> = OnceLock::new();
    INTERIOR.get_or_init(|| {
        let config = SynthConfig { seed: 21, rooms: 1, scans: 6, ..SynthConfig::default() };
        let set = generate(&config, &Silent).unwrap();
        let points = |s: &Scan| s.cloud.points.iter().map(|p| p.coords.cast::<f64>().into()).collect();
        set.scans.iter().map(points).collect()
    })
}

/// The scans in other coordinates, with the sensor where it then is.
fn register(points: &[Vec<[f64; 3]>], at: impl Fn(usize, &Point3<f64>) -> Point3<f64>) -> Reconstruction {
    let scans: Vec<Scan> = points
        .iter()
        .enumerate()
        .map(|(k, points)| {
            let moved: Vec<[f64; 3]> =
                points.iter().map(|p| at(k, &Point3::from(*p)).coords.into()).collect();
            let sensor = at(k, &Point3::origin()).coords.into();
            Scan { id: ScanId(k), ..Scan::from_points(format!("{k}"), &moved).with_viewpoint(sensor) }
        })
        .collect();
    let mut config = Config::default();
    config.descriptor.kind = DescriptorKind::Fpfh;
    config.descriptor.keypoints.count = 1000;
    scanweave::register(&scans, &config).unwrap()
}

fn plain() -> &'static Reconstruction {
    static PLAIN: OnceLock<Reconstruction> = OnceLock::new();
    PLAIN.get_or_init(|| register(interior(), |_, p| *p))
}

/// Every pair of scans has the pose that it has in the plain coordinates: `file_from_plain(k, p)` are
/// those of a point of scan `k`, `unit` of them a metre. Compared two metres around the sensor.
fn assert_same(
    other: &Reconstruction,
    file_from_plain: impl Fn(usize, &Point3<f64>) -> Point3<f64>,
    unit: f64,
) {
    let n = interior().len();
    assert!(plain().placed() >= 5, "{}", plain().placed());
    assert_eq!(other.placed(), plain().placed());
    for i in 0..n {
        for j in 0..n {
            let (Some(here), Some(there)) =
                (plain().relative(ScanId(i), ScanId(j)), other.relative(ScanId(i), ScanId(j)))
            else {
                assert_eq!(plain().relative(ScanId(i), ScanId(j)), None);
                assert_eq!(other.relative(ScanId(i), ScanId(j)), None);
                continue;
            };
            for corner in 0..8 {
                let p = Point3::from(Vector3::from_fn(
                    |axis, _| if corner >> axis & 1 == 1 { 2.0 } else { -2.0 },
                ));
                let expected = file_from_plain(i, &(here * p));
                let found = there * file_from_plain(j, &p);
                let off = (expected - found).norm() / unit;
                assert!(off < 0.004, "{j} in {i}: {off} m");
            }
        }
    }
}

#[test]
fn a_rigid_motion_of_every_file_changes_its_pose_alone() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for far_m in [381.0, 1e6] {
        let motions: Vec<RigidMotion> = (0..interior().len())
            .map(|_| {
                let mut vector = |size: f64| Vector3::from_fn(|_, _| rng.random_range(-size..size));
                RigidMotion::new(vector(far_m), vector(2.0))
            })
            .collect();
        let moved = |k: usize, p: &Point3<f64>| motions[k] * p;
        assert_same(&register(interior(), moved), moved, 1.0);
    }
}

#[test]
fn the_unit_changes_lengths_alone() {
    let in_millimetres = |_: usize, p: &Point3<f64>| p * 1000.0;
    assert_same(&register(interior(), in_millimetres), in_millimetres, 1000.0);
}

#[test]
fn points_that_are_there_twice_change_nothing() {
    let doubled = interior().iter().map(|points| [&points[..], &points[..points.len() / 3]].concat());
    let doubled: Vec<Vec<[f64; 3]>> = doubled.collect();
    let same = |_: usize, p: &Point3<f64>| *p;
    assert_same(&register(&doubled, same), same, 1.0);
}
