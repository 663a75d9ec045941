//! Reading a binary PLY of a million points: the aim is below 0.1 s.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scanweave_core::geometry::Point;
use scanweave_core::io::{PlyCloud, read_cloud, write_ply};

const POINTS: usize = 1_000_000;

fn ply(c: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let points: Vec<Point> =
        (0..POINTS).map(|i| Point::new(i as f32 * 1e-3, (i % 977) as f32 * 0.01, (i % 31) as f32)).collect();
    let colors = vec![[10u8, 20, 30]; POINTS];
    let mut group = c.benchmark_group("read_ply_1M");
    group.throughput(Throughput::Elements(POINTS as u64)).sample_size(20);
    for (name, colors) in [("xyz", None), ("xyz_rgb", Some(&colors[..]))] {
        let path = folder.path().join(format!("{name}.ply"));
        write_ply(&path, &PlyCloud { points: &points, colors, ..PlyCloud::default() })
            .expect("a written cloud");
        group.bench_function(name, |b| b.iter(|| read_cloud(&path).expect("a read cloud")));
    }
    group.finish();
}

criterion_group!(benches, ply);
criterion_main!(benches);
