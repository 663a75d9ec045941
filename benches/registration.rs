//! Time of the inner loops: descriptor matching and robust estimation.

use criterion::{Criterion, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scanweave_core::geometry::Point;
use scanweave_core::registration::Matches;
use scanweave_core::registration::estimate;
use scanweave_core::registration::{Columns, nearest_both};
use scanweave_core::registration::{EstimatorConfig, RansacConfig, SpatialCompatibilityConfig};
use scanweave_core::scan::Descriptors;
use std::hint::black_box;

fn descriptors(n: usize, dim: usize, seed: u64) -> Descriptors {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Descriptors::new(dim, (0..n * dim).map(|_| rng.random_range(-1.0..1.0)).collect()).unwrap().normalized()
}

fn matching(c: &mut Criterion) {
    let (a, b) = (descriptors(5000, 33, 1), descriptors(5000, 33, 2));
    let ids: Vec<u32> = (0..5000).collect();
    let columns = Columns::new(&b);
    c.bench_function("nearest both ways, 5000 x 5000 x 33", |bench| {
        bench.iter(|| nearest_both(black_box(a.values()), &ids, &columns));
    });
}

fn estimation(c: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut matches = Matches::default();
    for i in 0..1500u32 {
        let mut point = || Point::from(nalgebra::Vector3::from_fn(|_, _| rng.random_range(-2.0f32..2.0)));
        let (s, t) = (point(), point());
        matches.pairs.push((i, i));
        matches.source.push(s);
        matches.scores.push(0.0);
        matches.target.push(if i < 75 { s } else { t });
    }
    for (name, config) in [
        ("ransac, 1000 triples, 1500 matches at 5 %", EstimatorConfig::Ransac(RansacConfig::default())),
        (
            "spatial compatibility, 200 seeds, 1500 matches at 5 %",
            EstimatorConfig::SpatialCompatibility(SpatialCompatibilityConfig::default()),
        ),
    ] {
        c.bench_function(name, |bench| bench.iter(|| estimate(black_box(&matches), &config, 0.07, 0)));
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = matching, estimation
}
criterion_main!(benches);
