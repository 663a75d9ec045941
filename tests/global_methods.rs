//! The global paradigm through the whole pipeline, on a synthetic interior.

use scanweave::config::Method;
use scanweave::geometry::{rotation_error_rad, translation_error_m};
use scanweave::pipeline::{self, FeatureSource, PairCache, Run, run_with_pairs};
use scanweave::registration::{IncrementalConfig, InlierCountConfig, Ordering, Strategy, VerificationConfig};
use scanweave::scan::{DeclineReason, Outcome, ScanId};
use scanweave::synchronization::GraphKind;
use scanweave::synthetic::{SynthConfig, SyntheticSet, generate};
use scanweave::{Config, Silent};

const METHODS: [Method; 6] =
    [Method::Eigse3, Method::L1Irls, Method::Rotavg, Method::Hara, Method::Sghr, Method::PoseGraph];

fn interior() -> SyntheticSet {
    generate(
        &SynthConfig { scans: 6, rooms: 1, noise: 0.3, overlap: 0.7, seed: 1, ..SynthConfig::default() },
        &Silent,
    )
    .unwrap()
}

fn config(method: Method, graph: GraphKind) -> Config {
    let mut config = {
        let mut changed = Config::default();
        changed.method = method;
        changed
    };
    config.descriptor.keypoints.count = 1000;
    let mut growth = IncrementalConfig::default();
    growth.ordering = Ordering::Inliers;
    config.registration.strategy = Strategy::Incremental(growth);
    config.registration.multiview_icp.enabled = false;
    config.synchronization.graph = graph;
    // More than any wrong registration of this room has (18).
    config.registration.verification = VerificationConfig::InlierCount(InlierCountConfig::new(40));
    config
}

fn run(set: &SyntheticSet, config: &Config, pairs: &PairCache) -> Run {
    run_with_pairs(&set.scans, config, &FeatureSource::Computed, pairs, &Silent).unwrap()
}

#[test]
fn every_method_registers_a_room_and_registers_its_pairs_once() {
    let set = interior();
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("cache");
    let pairs = PairCache::in_folder(&cache);
    let mut files = Vec::new();
    let mut seconds = None;
    let described = pipeline::describe(
        &set.scans,
        &config(Method::Sghr, GraphKind::Full),
        &FeatureSource::Computed,
        &Silent,
    )
    .unwrap();
    let features = described.features_of_files(&set.scans);
    let given = FeatureSource::Given(&features);
    let run = |method: Method, pairs: &PairCache| {
        run_with_pairs(&set.scans, &config(method, GraphKind::Full), &given, pairs, &Silent).unwrap()
    };
    for method in METHODS {
        let run = run(method, &pairs);
        let graph = run.pose_graph.as_ref().unwrap();
        assert_eq!(graph.registered_pairs, 15);
        // The first method registers, the others reuse: what pairs cost stays told.
        let reused = if seconds.is_some() { graph.registration_seconds } else { 0.0 };
        assert_eq!(graph.reused_seconds, reused);
        assert_eq!(*seconds.get_or_insert(graph.registration_seconds), graph.registration_seconds);
        assert!(graph.registration_seconds > 0.0);
        assert_eq!(run.reconstruction.placed(), 6, "{method}");
        for i in 0..6 {
            for j in 0..i {
                let found = run.reconstruction.relative(ScanId(i), ScanId(j)).unwrap();
                let truth = set.world_from_scan[i].inverse() * set.world_from_scan[j];
                let (rad, m) = (rotation_error_rad(&found, &truth), translation_error_m(&found, &truth));
                assert!(rad < 0.05 && m < 0.08, "{method}, {i} and {j}: {rad:.3} rad, {m:.3} m");
            }
            let placement = run.reconstruction.outcomes[i].placement().unwrap();
            assert!(!placement.neighbours.is_empty());
            assert_eq!(placement.parent.is_none(), placement.step == 0);
        }
        files = std::fs::read_dir(&cache).unwrap().map(|f| f.unwrap().path()).collect();
        assert_eq!(files.len(), 1, "one file of pairs for one kind of settings");
    }
    // A later process takes the pairs from the file: where all inliers are gone, no edge is left.
    let name = files[0].file_stem().unwrap().to_string_lossy().into_owned();
    let settings = name.strip_prefix("pairs-").unwrap();
    let mut kept = scanweave::io::read_pairs(&files[0], settings).unwrap();
    assert_eq!(kept.len(), 15);
    kept.values_mut().for_each(|(pair, _)| pair.inliers = 2);
    scanweave::io::write_pairs(&files[0], settings, &kept).unwrap();
    let later = run(Method::Sghr, &PairCache::in_folder(&cache));
    assert!(later.pose_graph.unwrap().edges.is_empty());
    assert_eq!(later.reconstruction.placed(), 0);
    // A broken file is made again.
    std::fs::write(&files[0], b"broken").unwrap();
    let again = run(Method::Sghr, &PairCache::in_folder(&cache));
    assert_eq!(again.reconstruction.placed(), 6);
}

#[test]
fn graphs_differ_in_what_is_registered_and_what_is_kept() {
    let set = interior();
    let pairs = PairCache::in_memory();
    let mut sparse = config(Method::Hara, GraphKind::Sparse);
    sparse.synchronization.neighbours = 1;
    let run_sparse = run(&set, &sparse, &pairs);
    // Every scan names one other: at least half as many pairs as scans, at most as many.
    assert!((3..=6).contains(&run_sparse.pose_graph.unwrap().registered_pairs));

    let full = run(&set, &config(Method::Hara, GraphKind::Full), &pairs).pose_graph.unwrap();
    let pruned = run(&set, &config(Method::Hara, GraphKind::Pruned), &pairs).pose_graph.unwrap();
    assert!(pruned.edges.len() <= full.edges.len());
    assert!(pruned.edges.iter().all(|e| e.pair.median_distance_m < 0.05 / 0.07 * pruned.inlier_radius_m));

    let mut strict = config(Method::Hara, GraphKind::Pruned);
    strict.synchronization.max_median_distance = 1e-6;
    let nothing = run(&set, &strict, &pairs).reconstruction;
    for outcome in &nothing.outcomes {
        let Outcome::Declined(reason) = outcome else { panic!("placed by no edge") };
        assert!(matches!(reason, DeclineReason::Pruned { inliers, .. } if *inliers >= 40), "{reason}");
    }
}

#[test]
fn poses_do_not_depend_on_the_order_of_the_scans() {
    let set = interior();
    let order = [3, 0, 5, 1, 4, 2];
    let mut shuffled = interior();
    shuffled.scans = order
        .iter()
        .enumerate()
        .map(|(at, &i)| {
            let mut scan = set.scans[i].clone();
            scan.id = ScanId(at);
            scan
        })
        .collect();
    for method in [Method::Sghr, Method::PoseGraph] {
        let config = config(method, GraphKind::Full);
        let (a, b) =
            (run(&set, &config, &PairCache::in_memory()), run(&shuffled, &config, &PairCache::in_memory()));
        for (at, &i) in order.iter().enumerate().skip(1) {
            let a = a.reconstruction.relative(ScanId(order[0]), ScanId(i)).unwrap();
            let b = b.reconstruction.relative(ScanId(0), ScanId(at)).unwrap();
            assert!(rotation_error_rad(&a, &b) < 1e-5 && translation_error_m(&a, &b) < 1e-5, "{method}");
        }
    }
}
