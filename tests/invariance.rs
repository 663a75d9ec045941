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
    assert_within(other, file_from_plain, unit, 0.004);
}

/// [`assert_same`] with a limit of its own, metres.
fn assert_within(
    other: &Reconstruction,
    file_from_plain: impl Fn(usize, &Point3<f64>) -> Point3<f64>,
    unit: f64,
    limit_m: f64,
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
                assert!(off < limit_m, "{j} in {i}: {off} m");
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

/// The scans of the interior, each with a share of points more at places that `wild` draws.
fn with_wild_points(share: f64, wild: impl Fn(&mut ChaCha8Rng) -> [f64; 3]) -> Vec<Vec<[f64; 3]>> {
    let with = |(k, points): (usize, &Vec<[f64; 3]>)| {
        let mut rng = ChaCha8Rng::seed_from_u64(100 + k as u64);
        let count = ((points.len() as f64 * share).ceil() as usize).max(1);
        let mut all = points.clone();
        for _ in 0..count {
            all.insert(rng.random_range(0..all.len()), wild(&mut rng));
        }
        all
    };
    interior().iter().enumerate().map(with).collect()
}

#[test]
fn wild_points_however_far_and_many_change_no_pose() {
    let far = |_: &mut ChaCha8Rng| [1e10; 3];
    let anywhere = |size: f64| move |rng: &mut ChaCha8Rng| [0; 3].map(|_| rng.random_range(-size..size));
    // An ellipsoid as high as a man, where it is for all scans.
    let object = |away: f64| {
        let mut all = interior().clone();
        for (k, points) in all.iter_mut().enumerate() {
            let mut rng = ChaCha8Rng::seed_from_u64(200 + k as u64);
            let scan_from_world = plain().relative(ScanId(k), ScanId(0)).unwrap();
            for _ in 0..points.len() / 5 {
                let [x, y, z] = [0; 3].map(|_| rng.random_range(-1.0f64..1.0));
                let p = Vector3::new(x, y, z).normalize().component_mul(&Vector3::new(0.4, 0.6, 0.9));
                points.push((scan_from_world * Point3::new(p.x + away, p.y, p.z)).coords.into());
            }
        }
        all
    };
    let cases: [(&str, Vec<Vec<[f64; 3]>>); 6] = [
        ("one at 1e10", with_wild_points(0.0, far)),
        ("one per cent at 1e10", with_wild_points(0.01, far)),
        ("one per cent anywhere within 1e9 m", with_wild_points(0.01, anywhere(1e9))),
        ("one per cent within 200 m", with_wild_points(0.01, anywhere(200.0))),
        ("a second object half a kilometre away", object(500.0)),
        ("a second object 5 km away", object(5000.0)),
    ];
    for (name, points) in cases {
        println!("{name}");
        assert_within(&register(&points, |_, p| *p), |_, p| *p, 1.0, 0.02);
    }
}
