use super::terms::pair_term;
use super::*;
use crate::geometry::rigid::PointMover;
use crate::geometry::rigid::{rotation_error_rad, translation_error_m};
use crate::geometry::{Direction, Point};
use crate::monitor::Silent;
use crate::registration::config::RegistrationConfig;
use crate::scan::Surface;
use nalgebra::Point3;
use nalgebra::{Matrix6, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn model(surface: &Surface) -> ScanModel<'_> {
    ScanModel::new(surface, 0.07, &RegistrationConfig::default())
}

/// Three mutually perpendicular walls, 2 m wide, sampled every 2.5 cm, in a scan's own frame.
fn corner(scan_from_world: &RigidMotion) -> Surface {
    let mover = PointMover::new(scan_from_world);
    let mut surface = Surface::default();
    for a in 0..80 {
        for b in 0..80 {
            let (u, v) = (a as f32 * 0.025, b as f32 * 0.025);
            for (p, n) in [
                (Point::new(u, v, 0.0), Direction::z()),
                (Point::new(u, 0.0, v), Direction::y()),
                (Point::new(0.0, u, v), Direction::x()),
            ] {
                surface.points.push(mover.point(&p));
                surface.normals.push(mover.direction(&n));
            }
        }
    }
    surface
}

#[test]
fn scans_with_many_partners_are_compared_by_a_share_of_their_points_that_stands_for_all() {
    // A hub that overlaps twenty scans, which overlap it alone.
    let hub: Vec<(usize, usize)> = (1..=20).map(|j| (0, j)).collect();
    let mut expected = vec![1; 21];
    expected[0] = 3;
    assert_eq!(strides(&hub, 21), expected);
    assert_eq!(strides(&[], 2), [1, 1]);

    let moved = RigidMotion::new(Vector3::new(0.01, -0.02, 0.015), Vector3::new(0.004, 0.0, -0.006));
    let surfaces = [corner(&RigidMotion::identity()), corner(&RigidMotion::identity())];
    let models = surfaces.each_ref().map(model);
    let poses = [RigidMotion::identity(), moved];
    let scans = [0, 1].map(|k| PosedScan { model: &models[k], world_from_scan: poses[k] });
    let samples: Vec<Sample> = scans.iter().map(|s| Sample::new(s.model.surface, 1200)).collect();
    let of =
        |strides: [usize; 2]| pair_term((0, 1), &samples, &scans, &poses, &strides, Reach::of_radius(0.07));
    let (all, some) = (of([1, 1]), of([2, 5]));
    let difference = (all.information - some.information).norm() / all.information.norm();
    // Strides meet the walls' grid unevenly; a share that stood for itself alone would be 0.5 off or more.
    assert!(difference < 0.25, "{difference}");
    assert!((all.weight - some.weight).abs() < 0.25 * all.weight);
}

/// A plane of `n × n` points a centimetre apart, each at its own height.
fn plane(n: usize, height_m: impl Fn(usize) -> f32) -> Surface {
    let at = |i: usize| Point::new((i % n) as f32 * 0.01, (i / n) as f32 * 0.01, height_m(i));
    let points: Vec<Point> = (0..n * n).map(at).collect();
    Surface { normals: vec![Direction::z(); points.len()], points, ..Surface::default() }
}

#[test]
fn weights_reach_as_far_as_the_spread_of_the_distances_tells() {
    // Heights 1 to 7 mm above or below, whose median absolute value is 4 mm, by turns; and one point of ten at 6 cm.
    let height = |i: usize| match i % 10 {
        9 => 0.06,
        _ => 0.001 * (1 + i % 7) as f32 * if i.is_multiple_of(2) { 1.0 } else { -1.0 },
    };
    let surfaces = [plane(40, |_| 0.0), plane(40, height)];
    let models = surfaces.each_ref().map(model);
    let scans = models.each_ref().map(|model| PosedScan { model, world_from_scan: RigidMotion::identity() });
    let samples: Vec<Sample> = scans.iter().map(|s| Sample::new(s.model.surface, 1600)).collect();
    let poses = [RigidMotion::identity(); 2];
    let cutoff_m = |kernel: Kernel, radius_m: f64| {
        kernel.cutoff_m(&[(0, 1)], &samples, &scans, &poses, &[1, 1], radius_m)
    };
    assert_eq!(cutoff_m(Kernel::Radius, 0.07), 0.07);
    // 4.685 standard deviations of the Gaussian whose median absolute value is 4 mm; ties move it by one step.
    let expected = 4.685 * 1.4826 * 0.004;
    let found = cutoff_m(Kernel::Residuals, 0.07);
    assert!((found / expected - 1.0).abs() < 0.26, "{found} {expected}");
    // Never further than points look; and all of it where they have no spread or do not touch.
    assert_eq!(cutoff_m(Kernel::Residuals, 0.02), 0.02);
    let exact = [plane(40, |_| 0.0), plane(40, |_| 0.0)];
    let models = exact.each_ref().map(model);
    let exact = models.each_ref().map(|model| PosedScan { model, world_from_scan: RigidMotion::identity() });
    let flat = [0, 0].map(|k| Sample::new(exact[k].model.surface, 1600));
    assert_eq!(Kernel::Residuals.cutoff_m(&[(0, 1)], &flat, &exact, &poses, &[1, 1], 0.07), 0.07);
    assert_eq!(Kernel::Residuals.cutoff_m(&[], &samples, &scans, &poses, &[1, 1], 0.07), 0.07);
}

#[test]
fn what_moved_between_scans_does_not_pull_where_weights_reach_no_further_than_the_spread() {
    // A corner exactly alike in both scans, but for a part of one wall that stands 2 cm in front of where it was:
    // within the radius, far beyond the spread of the rest.
    let still = corner(&RigidMotion::identity());
    let mut moved = still.clone();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (p, n) in moved.points.iter_mut().zip(&moved.normals) {
        *p += n * rng.random_range(-0.002f32..0.002);
        if n.x.abs() > 0.9 && p.z < 0.4 {
            *p += n * 0.02;
        }
    }
    let surfaces = [still, moved];
    let models = surfaces.each_ref().map(model);
    let scans = models.each_ref().map(|model| PosedScan { model, world_from_scan: RigidMotion::identity() });
    let config = MultiviewIcpConfig { radii: vec![1.0], rounds: 8, ..MultiviewIcpConfig::default() };
    let pulled = |kernel: Kernel| {
        translation_error_m(
            &refine_with(&scans, &config, 0.05, kernel, &Silent).unwrap()[1],
            &RigidMotion::identity(),
        )
    };
    let (radius, residuals) = (pulled(Kernel::Radius), pulled(Kernel::Residuals));
    assert!(radius > 1e-3, "{radius}");
    assert!(residuals < 0.2 * radius, "{residuals} {radius}");
}

#[test]
fn disturbed_poses_return_to_the_exact_ones() {
    // Every scan sees the same corner; the exact poses give zero residual.
    let truth: Vec<RigidMotion> = (0..5)
        .map(|k| {
            let k = f64::from(k);
            RigidMotion::new(Vector3::new(k, -0.3 * k, 0.1), Vector3::new(0.1 * k, 0.2, -0.3 * k))
        })
        .collect();
    let surfaces: Vec<Surface> = truth.iter().map(|t| corner(&t.inverse())).collect();
    let nudge = |k: usize| {
        let s = if k == 0 {
            0.0
        } else if k.is_multiple_of(2) {
            1.0
        } else {
            -1.0
        };
        RigidMotion::new(Vector3::new(0.03, -0.02, 0.025) * s, Vector3::new(0.01, -0.015, 0.01) * s)
    };
    let models: Vec<ScanModel<'_>> = surfaces.iter().map(model).collect();
    let scans: Vec<PosedScan<'_>> = models
        .iter()
        .enumerate()
        .map(|(k, model)| PosedScan { model, world_from_scan: nudge(k) * truth[k] })
        .collect();
    let refined = refine_poses(&scans, &MultiviewIcpConfig::default(), 0.07, &Silent).unwrap();
    assert_eq!(refined[0], truth[0]);
    for (pose, truth) in refined.iter().zip(&truth) {
        assert!(translation_error_m(pose, truth) < 2e-4, "{}", translation_error_m(pose, truth));
        assert!(rotation_error_rad(pose, truth) < 2e-4);
    }
}

#[test]
fn a_loop_that_drifted_closes_and_a_false_pair_is_outvoted() {
    // Twelve poses on a circle; neighbours see 20 common points, exactly. The start drifts by
    // 8 cm a step. Across the circle one pair takes points that are 1.5 m apart for one.
    let truth: Vec<RigidMotion> = (0..12)
        .map(|k| {
            let a = f64::from(k) * std::f64::consts::TAU / 12.0;
            RigidMotion::new(Vector3::new(3.0 * a.cos(), 3.0 * a.sin(), 0.1 * a), Vector3::new(0.0, 0.1, a))
        })
        .collect();
    let seen = |k: usize, shift: f64| -> Vec<Point> {
        (0..20)
            .map(|m| {
                let m = f64::from(m);
                let p = nalgebra::Point3::new((1.7 * m).sin() + shift, (2.3 * m).cos(), (0.9 * m).sin());
                (truth[k].inverse() * p).cast::<f32>()
            })
            .collect()
    };
    let pair = |i: usize, j: usize, shift: f64| MatchedPair {
        scans: (i.min(j), i.max(j)),
        points: seen(i.min(j), 0.0).into_iter().zip(seen(i.max(j), shift)).collect(),
        weight: 1.0,
    };
    let mut pairs: Vec<MatchedPair> = (0..12).map(|k| pair(k, (k + 1) % 12, 0.0)).collect();
    pairs.extend((0..12).map(|k| pair(k, (k + 2) % 12, 0.0)));
    pairs.push(pair(0, 6, 1.5));
    let start: Vec<RigidMotion> = truth
        .iter()
        .enumerate()
        .map(|(k, t)| RigidMotion::translation(0.08 * k as f64, 0.0, -0.02 * k as f64) * t)
        .collect();
    let closed = close_loops(&start, &pairs, 0.07);
    for (pose, truth) in closed.iter().zip(&truth) {
        assert!(translation_error_m(pose, truth) < 5e-3, "{}", translation_error_m(pose, truth));
        assert!(rotation_error_rad(pose, truth) < 5e-3);
    }
}

/// Three views of a corner whose points are moved across the surfaces by `displacement`, drawn anew: the
/// deviations of rotation (radians) and centre (metres) of the last view over the draws, seen and stated.
fn deviations(draws: usize, displacement: impl Fn(&mut ChaCha8Rng, &mut Surface)) -> ([f64; 2], [f64; 2]) {
    let truth: Vec<RigidMotion> = (0..3)
        .map(|k| {
            let k = f64::from(k);
            RigidMotion::new(Vector3::new(0.5 * k, -0.3 * k, 0.1), Vector3::new(0.1 * k, 0.2, -0.3 * k))
        })
        .collect();
    let config = MultiviewIcpConfig { radii: vec![1.0], ..MultiviewIcpConfig::default() };
    let (mut seen, mut stated) = ([0.0; 2], [0.0; 2]);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for _ in 0..draws {
        let mut surfaces: Vec<Surface> = truth.iter().map(|t| corner(&t.inverse())).collect();
        surfaces.iter_mut().for_each(|surface| displacement(&mut rng, surface));
        let models: Vec<ScanModel<'_>> = surfaces.iter().map(model).collect();
        let posed = |poses: &[RigidMotion]| -> Vec<PosedScan<'_>> {
            let scans = models.iter().zip(poses);
            scans.map(|(model, &world_from_scan)| PosedScan { model, world_from_scan }).collect()
        };
        let refined = refine_poses(&posed(&truth), &config, 0.07, &Silent).unwrap();
        let covariances = pose_covariances(&posed(&refined), &config, 0.07);
        assert_eq!(covariances[0], Some(Matrix6::zeros()));
        let variances = covariances[2].unwrap().diagonal();
        let centre = models[2].centre.cast::<f64>();
        let moved = refined[2] * centre - truth[2] * centre;
        let turned = (refined[2].rotation * truth[2].rotation.inverse()).scaled_axis();
        for (k, off) in [turned, moved].iter().enumerate() {
            seen[k] += off.norm_squared() / draws as f64;
            stated[k] += variances.fixed_rows::<3>(3 * k).sum() / draws as f64;
        }
    }
    (seen.map(f64::sqrt), stated.map(f64::sqrt))
}

#[test]
fn covariances_hold_the_spread_of_poses_of_bent_scans() {
    // Every wall of every view is bent by a wave of its own, 5 mm high, one to two of which go along
    // the wall: longer ones pass for other poses.
    let bent = |rng: &mut ChaCha8Rng, surface: &mut Surface| {
        let waves: [(f32, f32, f32); 3] = std::array::from_fn(|_| {
            (
                rng.random_range(3.0..6.0),
                rng.random_range(3.0..6.0),
                rng.random_range(0.0..std::f32::consts::TAU),
            )
        });
        for (k, (p, n)) in surface.points.iter_mut().zip(&surface.normals).enumerate() {
            let (along, across, phase) = waves[k % 3];
            *p += n * 0.005 * (along * p.x + across * p.y - along * p.z + phase).sin();
        }
    };
    let (seen, stated) = deviations(60, bent);
    for (seen, stated) in seen.iter().zip(stated) {
        assert!((0.4..4.0).contains(&(stated / seen)), "stated {stated}, seen {seen}");
    }
}

#[test]
fn independent_noise_is_stated_with_room_to_spare() {
    let noisy = |rng: &mut ChaCha8Rng, surface: &mut Surface| {
        for (p, n) in surface.points.iter_mut().zip(&surface.normals) {
            // Uniform on ±a has the standard deviation a/√3.
            *p += n * rng.random_range(-0.00866f32..0.00866);
        }
    };
    let (seen, stated) = deviations(20, noisy);
    for (seen, stated) in seen.iter().zip(stated) {
        // Nobody knows that the noise is independent: but no more than millimetres come of 5 mm.
        assert!(stated > *seen && stated < 0.005, "stated {stated}, seen {seen}");
    }
}

/// Two views of one painted wall, the second 2 cm and half a degree off along it and more brightly
/// exposed: only the paint tells.
#[test]
fn paint_holds_what_a_flat_wall_does_not() {
    let paint = |x: f32, y: f32| 0.5 + 0.2 * (9.0 * x).sin() + 0.2 * (7.0 * y + 3.0 * x).cos();
    let wall = |shift: f32, brighter: f32| {
        let points: Vec<Point> = (0..6400)
            .map(|i| Point::new((i % 80) as f32 * 0.025 + shift, (i / 80) as f32 * 0.025 + shift, 0.0))
            .collect();
        let intensities = points.iter().map(|p| paint(p.x, p.y) + brighter).collect();
        Surface { normals: vec![Direction::z(); 6400], points, intensities, ..Surface::default() }
    };
    let (first, second) = (wall(0.0, 0.0), wall(0.011, 0.08));
    let (first, second) = (model(&first), model(&second));
    let off = RigidMotion::new(Vector3::new(0.02, -0.015, 0.01), Vector3::new(0.0, 0.0, 0.009));
    let scans = [
        PosedScan { model: &first, world_from_scan: RigidMotion::identity() },
        PosedScan { model: &second, world_from_scan: off },
    ];
    let error = |colour: f64| {
        let config = MultiviewIcpConfig { colour, rounds: 8, ..MultiviewIcpConfig::default() };
        let refined = refine_poses(&scans, &config, 0.07, &Silent).unwrap()[1];
        let corner = Point3::new(0.0, 0.0, 0.0);
        (refined * corner - corner).norm()
    };
    assert!(error(0.0) > 0.015, "{}", error(0.0));
    assert!(error(1.0) < 0.002, "{}", error(1.0));
}

#[test]
fn what_nothing_holds_stays_where_it_was() {
    // Two views of one plane: sliding along it is free, only the distance is corrected.
    let flat = Surface {
        points: (0..6400)
            .map(|i| Point::new((i % 80) as f32 * 0.025, (i / 80) as f32 * 0.025, 0.0))
            .collect(),
        normals: vec![Direction::z(); 6400],
        ..Surface::default()
    };
    let flat = model(&flat);
    let start = RigidMotion::translation(0.1, 0.0, 0.03);
    let scans = [
        PosedScan { model: &flat, world_from_scan: RigidMotion::identity() },
        PosedScan { model: &flat, world_from_scan: start },
    ];
    let refined = refine_poses(&scans, &MultiviewIcpConfig::default(), 0.07, &Silent).unwrap();
    assert!(refined[1].translation.vector.z.abs() < 1e-4);
    assert!((refined[1].translation.vector.x - 0.1).abs() < 1e-3);
}
