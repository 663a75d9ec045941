//! Dense scans are refined on more of their points than those that they were joined by.

use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scanweave::config::Config;
use scanweave::descriptor::DescriptorKind;
use scanweave::geometry::RigidMotion;
use scanweave::scan::{Outcome, Reconstruction, Scan, ScanId};

/// Radius in a direction, metres: a fist with dents and knobs down to a few millimetres.
fn radius(d: &Vector3<f64>) -> f64 {
    let wave = |a: f64, k: Vector3<f64>, phase: f64| a * (k.dot(d) + phase).sin();
    0.1 + wave(0.012, Vector3::new(3.0, -2.0, 4.0), 0.3)
        + wave(0.008, Vector3::new(-6.0, 5.0, 2.0), 1.1)
        + wave(0.004, Vector3::new(7.0, 9.0, -8.0), 2.0)
        + wave(0.0015, Vector3::new(-21.0, 17.0, 19.0), 0.7)
}

/// Four views of the fist from around it, 40 000 points each with 0.1 mm of noise, and `world_from_scan`.
fn views() -> (Vec<Scan>, Vec<RigidMotion>) {
    views_apart(4, 0.6)
}

/// The same of any number of views, `apart` radians from one to the next.
fn views_apart(count: usize, apart: f64) -> (Vec<Scan>, Vec<RigidMotion>) {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    (0..count)
        .map(|k| {
            let around = apart * k as f64;
            let towards = Vector3::new(around.cos(), around.sin(), 0.3).normalize();
            let mut vector = |size: f64| Vector3::from_fn(|_, _| rng.random_range(-size..size));
            let world_from_scan = RigidMotion::new(vector(0.5), vector(2.0));
            let scan_from_world = world_from_scan.inverse();
            let mut points = Vec::new();
            while points.len() < 40_000 {
                let d = vector(1.0);
                if !(0.1..1.0).contains(&d.norm()) || d.normalize().dot(&towards) < 0.2 {
                    continue;
                }
                let d = d.normalize();
                let off = vector(1e-4).x;
                let p = scan_from_world * Point3::from(d * (radius(&d) + off));
                points.push(p.coords.into());
            }
            let sensor = scan_from_world * Point3::from(towards * 0.6);
            let scan = Scan::from_points(format!("{k}"), &points).with_viewpoint(sensor.coords.into());
            (Scan { id: ScanId(k), ..scan }, world_from_scan)
        })
        .unzip()
}

fn register(scans: &[Scan], fine: bool) -> Reconstruction {
    let mut config = Config::default();
    config.descriptor.kind = DescriptorKind::Fpfh;
    config.registration.fine_refinement.enabled = fine;
    // Coarse enough that the smallest knobs are lost to it.
    config.scale.voxel_m = Some(0.005);
    scanweave::register(scans, &config).unwrap()
}

/// Root mean square displacement of the object's middle and of places on it over all pairs, metres.
fn error(found: &Reconstruction, truth: &[RigidMotion]) -> f64 {
    let (mut squared, mut count) = (0.0, 0);
    for i in 0..truth.len() {
        for j in i + 1..truth.len() {
            let relative = found.relative(ScanId(i), ScanId(j)).unwrap();
            for axis in 0..3 {
                let p = truth[j].inverse() * Point3::from(Vector3::ith(axis, 0.1));
                let expected = truth[i].inverse() * truth[j] * p;
                squared += (relative * p - expected).norm_squared();
                count += 1;
            }
        }
    }
    (squared / f64::from(count)).sqrt()
}

#[test]
fn what_voxels_hide_the_fine_refinement_sees() {
    let (scans, truth) = views();
    let (coarse, fine) = (register(&scans, false), register(&scans, true));
    assert_eq!((coarse.placed(), fine.placed()), (4, 4));
    let (before, after) = (error(&coarse, &truth), error(&fine, &truth));
    // Forty thousand points with 0.1 mm of noise fix a pose to micrometres; what is left is that of planes
    // through curved surface.
    assert!(after < 0.5 * before, "{before} m before, {after} m after");
    assert!(after < 1e-4, "{after} m");
}

#[test]
fn deviations_are_stated_with_the_centre_that_they_are_of() {
    let (scans, _) = views();
    let fine = register(&scans, true);
    for (scan, outcome) in scans.iter().zip(&fine.outcomes) {
        let Outcome::Placed(placement) = outcome else { panic!("{outcome:?}") };
        let uncertainty = placement.pose_uncertainty.as_deref().unwrap();
        let (deg, m) = uncertainty.deviation().unwrap();
        let is_pivot = placement.step == 0;
        assert!(is_pivot == (m == 0.0) && m < 5e-3 && deg < 5.0, "{m} m, {deg}°, {is_pivot}");
        // In the middle of what the scan holds, in the coordinates of its file.
        let centre = uncertainty.centre.unwrap();
        let mean = scan.cloud.points.iter().map(|p| p.coords.cast::<f64>()).sum::<Vector3<f64>>()
            / scan.cloud.points.len() as f64
            + scan.cloud.origin_m;
        assert!((centre.coords - mean).norm() < 0.05, "{centre} and {mean}");
    }
}

/// One of 40 points of every scan.
fn thinned(scans: &[Scan]) -> Vec<Scan> {
    let thin = |scan: &Scan| {
        let points: Vec<[f64; 3]> =
            scan.cloud.points.iter().step_by(40).map(|p| p.coords.cast::<f64>().into()).collect();
        let place = scan.cloud.viewpoint.unwrap().coords.cast::<f64>().into();
        Scan { id: scan.id, ..Scan::from_points(scan.name.clone(), &points).with_viewpoint(place) }
    };
    scans.iter().map(thin).collect()
}

/// Where all points of a chain of scans are in their surfaces already there is nothing to refine on: not a bit
/// changes.
#[test]
fn chains_of_thin_scans_are_left_as_they_are() {
    let (scans, _) = views_apart(6, 0.8);
    let thin = thinned(&scans);
    let (without, with) = (register(&thin, false), register(&thin, true));
    assert!(with.placed() >= 5, "{}", with.placed());
    for (a, b) in without.outcomes.iter().zip(&with.outcomes) {
        assert_eq!(a.placement().map(|p| p.world_from_scan), b.placement().map(|p| p.world_from_scan));
    }
}

/// Where every two of them overlap, normals of smaller neighbourhoods tell more of a curved surface.
#[test]
fn thin_scans_that_all_overlap_are_refined() {
    let (scans, truth) = views_apart(3, 0.4);
    let thin = thinned(&scans);
    let (without, with) = (register(&thin, false), register(&thin, true));
    assert_eq!((without.placed(), with.placed()), (3, 3));
    let (before, after) = (error(&without, &truth), error(&with, &truth));
    assert!(after < 0.7 * before, "{before} m before, {after} m after");
}
