use super::*;
use crate::geometry::Point;
use crate::monitor::Silent;
use crate::random::generator;
use rand::RngExt;

/// Scans whose descriptors scatter around `center[i]` on the circle, D = 4.
fn scan(n: usize, angle: f32, seed: u64) -> Features {
    let mut rng = generator(seed, "test", 0);
    let values = (0..n)
        .flat_map(|_| {
            let a = angle + rng.random_range(-0.2f32..0.2);
            let b = rng.random_range(-0.2f32..0.2);
            [a.cos(), a.sin(), b, 0.1]
        })
        .collect();
    let descriptors = Descriptors::new(4, values).unwrap().normalized();
    Features::new(vec![Point::origin(); n], None, descriptors).unwrap()
}

/// So soft that clusters overlap: descriptors of two scans alone, around a centroid between them, have residuals
/// that speak against each other.
fn config(source: SimilaritySource) -> RetrievalConfig {
    RetrievalConfig { source, clusters: 8, alpha: 10.0, ..RetrievalConfig::default() }
}

#[test]
fn scans_of_the_same_stuff_are_more_similar_than_others() {
    let features = [scan(300, 0.0, 1), scan(300, 0.05, 2), scan(300, 1.5, 3), scan(300, 1.55, 4)];
    for source in [SimilaritySource::Netvlad, SimilaritySource::Gem, SimilaritySource::Mean] {
        let c = RetrievalConfig { fusion_neighbours: 1, ..config(source) };
        let (s, _) = similarity_of(&features, &c, None, 1, &Silent).unwrap();
        let like = s.get(0, 1).min(s.get(2, 3));
        let unlike = [s.get(0, 2), s.get(0, 3), s.get(1, 2), s.get(1, 3)].into_iter().fold(0.0, f32::max);
        assert!(like > unlike + 0.2, "{source:?}: {like} against {unlike}");
    }
}

/// Given features come in any length; the head takes their directions alone. Powers of two change no bit of them.
#[test]
fn the_length_of_descriptors_does_not_matter() {
    let unit = scan(300, 0.0, 1).descriptors;
    let rows = unit.values().chunks(4).enumerate();
    let values = rows.flat_map(|(i, row)| row.iter().map(move |v| v * 2f32.powi(i as i32 % 9 + 4)));
    let long = Descriptors::new(4, values.collect()).unwrap();
    let of = |descriptors| match choose_head(&[descriptors], &config(SimilaritySource::Netvlad), None, 1)
        .unwrap()
        .0
    {
        Head::NetVlad(layer) => layer,
        other => panic!("{other:?}"),
    };
    assert_eq!(of(&unit), of(&long));
}

#[test]
fn one_scan_none_an_empty_one_and_tiny_ones_work() {
    let (c, none) = (config(SimilaritySource::Netvlad), None);
    let (s, origin) = similarity_of(&[scan(2, 0.0, 1)], &c, none, 0, &Silent).unwrap();
    assert_eq!((s.len(), s.get(0, 0)), (1, 0.0));
    assert_eq!(origin.to_string(), "k-means centroids from these 1 scans");
    assert!(similarity_of(&[], &c, none, 0, &Silent).unwrap().0.is_empty());
    let features = [scan(1, 0.0, 1), scan(0, 0.0, 1), scan(1, 0.0, 1)];
    let (s, origin) = similarity_of(&features, &c, none, 0, &Silent).unwrap();
    assert_eq!((s.get(0, 1), s.get(1, 2), s.get(0, 2)), (0.0, 0.0, 1.0));
    assert_eq!(origin, HeadOrigin::Kmeans { scans: 2 });
    assert!(similarity_of(&[scan(0, 0.0, 1)], &c, none, 0, &Silent).is_ok());
}

#[test]
fn threads_do_not_change_a_bit() {
    let features: Vec<Features> = (0..12).map(|i| scan(4000 + i, 0.3 * i as f32, i as u64)).collect();
    let c = RetrievalConfig { clusters: 64, ..RetrievalConfig::default() };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| similarity_of(&features, &c, None, 1, &Silent).unwrap().0)
    };
    assert_eq!(run(1), run(2));
    assert_eq!(run(1), run(5));
}

#[test]
fn mixed_dimensions_and_wrong_heads_are_refused() {
    let other = Features::new(vec![Point::origin()], None, Descriptors::new(2, vec![1.0, 0.0]).unwrap());
    let mixed = [scan(3, 0.0, 1), other.unwrap()];
    let c = config(SimilaritySource::Netvlad);
    let message = similarity_of(&mixed, &c, None, 0, &Silent).unwrap_err().to_string();
    assert!(message.contains("2 dimensions in scan 1") && message.contains("4 as in scan 0"), "{message}");
    let weights = HeadWeights::Gem { layer: Gem::default(), dim: 33 };
    let mut checkpoint = Checkpoint {
        meta: checkpoint::CheckpointMeta {
            format_version: checkpoint::FORMAT_VERSION,
            name: "gem".into(),
            architecture: Checkpoint::architecture_of(&weights),
            descriptor: DescriptorTag { name: "fpfh".into(), dim: 33, settings_hash: String::new() },
            recipe: serde_json::Value::Null,
            data: checkpoint::DataSummary::default(),
            metrics: Default::default(),
            epoch: 0,
        },
        weights,
        optimizer: None,
    };
    let refused = |c: &Checkpoint, r: &RetrievalConfig| {
        similarity_of(&mixed[..1], r, Some(c), 0, &Silent).unwrap_err().to_string()
    };
    let message = refused(&checkpoint, &c);
    assert!(message.contains("33 dimensions") && message.contains("4 dimensions"), "{message}");
    checkpoint.weights = HeadWeights::Gem { layer: Gem::default(), dim: 4 };
    assert!(refused(&checkpoint, &c).contains("retrieval.source: found netvlad"));
    let fits = config(SimilaritySource::Gem);
    let (_, origin) = similarity_of(&mixed[..1], &fits, Some(&checkpoint), 0, &Silent).unwrap();
    assert_eq!(origin.to_string(), "trained checkpoint gem");
}

#[test]
fn unusable_settings_are_named() {
    let bad = RetrievalConfig { alpha: f32::NAN, ..RetrievalConfig::default() };
    assert!(bad.validate().unwrap_err().to_string().starts_with("retrieval.alpha: found NaN"));
    let bad = RetrievalConfig { clusters: 0, ..RetrievalConfig::default() };
    assert!(bad.validate().unwrap_err().to_string().starts_with("retrieval.clusters: found 0"));
}
