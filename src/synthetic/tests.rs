//! Tests of whole synthetic sets.

use super::*;
use crate::Silent;
use crate::geometry::RadiusGrid;
use crate::geometry::two_way_overlap;

fn small(seed: u64) -> SynthConfig {
    SynthConfig { seed, scans: 8, ..SynthConfig::default() }
}

fn relative(set: &SyntheticSet, i: ScanId, j: ScanId) -> RigidMotion {
    set.world_from_scan[i.0].inverse() * set.world_from_scan[j.0]
}

fn overlap(set: &SyntheticSet, i: ScanId, j: ScanId) -> crate::geometry::Overlap {
    overlap_at(set, i, j, &relative(set, i, j))
}

fn overlap_at(set: &SyntheticSet, i: ScanId, j: ScanId, i_from_j: &RigidMotion) -> crate::geometry::Overlap {
    let grid = |k: ScanId| RadiusGrid::new(&set.scans[k.0].cloud.points, 0.05);
    two_way_overlap(&grid(i), &grid(j), i_from_j)
}

#[test]
fn scans_that_follow_each_other_overlap_as_stated() {
    for seed in 0..3 {
        let set = generate(&small(seed), &Silent).unwrap();
        for pair in set.walk.windows(2) {
            let o = overlap(&set, pair[0], pair[1]);
            assert!((0.4..0.72).contains(&o.ratio), "seed {seed}: {:?}", o);
            // 2 cm voxel means of surfaces with about 1 cm of noise.
            assert!(o.residual_m < 0.02, "seed {seed}: {:?}", o);
        }
        // Under a wrong pose the truth would be told apart: 20 cm off, the overlap drops.
        let (i, j) = (set.walk[0], set.walk[1]);
        let off = RigidMotion::translation(0.12, 0.12, 0.12) * relative(&set, i, j);
        assert!(overlap_at(&set, i, j, &off).ratio < 0.8 * overlap(&set, i, j).ratio);
    }
}

#[test]
fn exact_scans_lie_on_the_solids_under_their_true_poses() {
    let config = SynthConfig { noise: 0.0, scans: 3, voxel_m: 0.01, ..small(4) };
    let site = Site::new(&config, config.seed, 2, 3);
    for k in 0..site.len() {
        let (cloud, world_from_scan) = site.scan(k);
        let mut distances: Vec<f64> = cloud
            .points
            .iter()
            .step_by(40)
            .map(|p| {
                let p = world_from_scan * p.cast::<f64>();
                let near = site.scene().primitives().iter().map(|s| s.signed_distance(&p).abs());
                near.fold(f64::INFINITY, f64::min)
            })
            .collect();
        distances.sort_by(f64::total_cmp);
        let at = |share: f64| distances[((distances.len() - 1) as f64 * share) as usize];
        assert!(distances.len() > 300, "{}", distances.len());
        // Flat parts are exact to rounding; where a voxel or the smoothing spans an edge, the
        // mean lies off the surface by at most about a voxel.
        assert!(at(0.5) < 5e-4, "median {} m", at(0.5));
        assert!(at(0.9) < 0.01, "90 % {} m", at(0.9));
        // The sensor stands at the origin of the scan: the middle frame's camera.
        let eye = site.camera_poses(k)[config.frames_per_scan / 2].translation.vector;
        assert!((world_from_scan.translation.vector - eye).norm() < 1e-12);
        assert_eq!(cloud.viewpoint, None);
    }
}

#[test]
fn one_seed_gives_the_same_bytes_at_one_and_two_threads_and_seeds_differ() {
    let config = SynthConfig { width: 96, height: 72, unrelated: 1, scans: 4, ..small(9) };
    let run = |threads: usize, config: &SynthConfig| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let set = pool.install(|| generate(config, &Silent)).unwrap();
        let mut bytes: Vec<u8> = Vec::new();
        for (scan, pose) in set.scans.iter().zip(&set.world_from_scan) {
            bytes.extend(scan.name.bytes());
            bytes.extend(scan.cloud.points.iter().flat_map(|p| p.iter().flat_map(|v| v.to_le_bytes())));
            bytes.extend(scan.cloud.colors.iter().flatten().flatten());
            bytes.extend(pose.to_homogeneous().iter().flat_map(|v| v.to_le_bytes()));
        }
        (bytes, set)
    };
    let ((one, set), (two, _)) = (run(1, &config), run(2, &config));
    assert!(one == two, "thread count changed the bytes");
    assert!(run(1, &SynthConfig { seed: 10, ..config.clone() }).0 != one, "the seed changed nothing");
    let mut walk: Vec<usize> = set.walk.iter().map(|s| s.0).collect();
    assert_ne!(walk, [0, 1, 2, 3], "order carries no meaning");
    walk.sort_unstable();
    let strangers: Vec<usize> = (0..5).filter(|&i| set.building[i] != 0).collect();
    assert_eq!(strangers.len(), 1);
    assert_eq!(walk, (0..5).filter(|&i| set.building[i] == 0).collect::<Vec<_>>());
}

#[test]
fn scan_frames_are_turned_at_random() {
    let config = SynthConfig { width: 32, height: 24, scans: 12, ..small(2) };
    let set = generate(&config, &Silent).unwrap();
    // The scan's frame against its camera's: gravity points all over the place.
    let down: nalgebra::Vector3<f64> = set
        .world_from_scan
        .iter()
        .map(|t| t.rotation.inverse() * nalgebra::Vector3::z())
        .sum::<nalgebra::Vector3<f64>>()
        / 12.0;
    assert!(down.norm() < 0.6, "frames share a direction: {down}");
}

#[test]
fn unusable_settings_are_named() {
    let bad = |config: SynthConfig, key: &str| {
        let message = config.validate().unwrap_err().to_string();
        assert!(message.contains(key), "{message}");
        assert!(generate(&config, &Silent).is_err());
    };
    bad(SynthConfig { rooms: 0, ..SynthConfig::default() }, "synthetic.rooms");
    bad(SynthConfig { overlap: f64::NAN, ..SynthConfig::default() }, "synthetic.overlap");
    bad(SynthConfig { noise: -1.0, ..SynthConfig::default() }, "synthetic.noise");
    bad(SynthConfig { scans: 0, ..SynthConfig::default() }, "synthetic.scans");
    SynthConfig::default().validate().unwrap();
}
