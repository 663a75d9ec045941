//! Seeded k-means of descriptors, for centroids where nothing was trained.

use crate::random::generator;
use rand::RngExt;
use rayon::prelude::*;

/// Rows a task works on; sums are added up in the order of these blocks, whatever the thread count.
const BLOCK: usize = 512;

/// Settings of [`kmeans`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KmeansConfig {
    /// Clusters K.
    pub clusters: usize,
    /// Most rows that are looked at; beyond it a seeded subsample is taken.
    pub sample: usize,
    /// Most Lloyd rounds; it stops earlier when no row changes its cluster.
    pub rounds: usize,
    /// Seed of the subsample and of the starting centroids.
    pub seed: u64,
}

/// Centroids `[K·D]`, row-major, of the rows of several sets `[n_i·dim]`.
///
/// Starts by k-means++ (Arthur and Vassilvitskii 2007: each next centroid is a row drawn with
/// probability proportional to its squared distance to the nearest one so far), then Lloyd rounds.
/// A cluster that loses all its rows takes the row farthest from its own centroid. With fewer
/// distinct rows than clusters the surplus centroids repeat rows, so that K never depends on the
/// data. Without any row the centroids are zero.
pub fn kmeans(sets: &[&[f32]], dim: usize, config: &KmeansConfig) -> Vec<f32> {
    let rows = subsample(sets, dim, config);
    if rows.is_empty() || config.clusters == 0 {
        return vec![0.0; config.clusters * dim];
    }
    let mut centroids = plus_plus(&rows, dim, config);
    let mut previous: Vec<u32> = Vec::new();
    for _ in 0..config.rounds {
        let assigned = assign(&rows, dim, &centroids);
        let labels: Vec<u32> = assigned.iter().map(|a| a.0).collect();
        if labels == previous {
            break;
        }
        centroids = means(&rows, dim, &assigned, config.clusters, &centroids);
        previous = labels;
    }
    centroids
}

/// At most `config.sample` rows, each kept with its place in the input.
pub(super) fn subsample(sets: &[&[f32]], dim: usize, config: &KmeansConfig) -> Vec<f32> {
    let total: usize = sets.iter().map(|s| s.len() / dim).sum();
    if total <= config.sample {
        return sets.iter().flat_map(|s| s.iter().copied()).collect();
    }
    let mut rng = generator(config.seed, "kmeans sample", 0);
    let mut chosen = rand::seq::index::sample(&mut rng, total, config.sample).into_vec();
    chosen.sort_unstable();
    let mut rows = Vec::with_capacity(config.sample * dim);
    let (mut set, mut start) = (0, 0);
    for at in chosen {
        while at - start >= sets[set].len() / dim {
            start += sets[set].len() / dim;
            set += 1;
        }
        rows.extend_from_slice(&sets[set][(at - start) * dim..(at - start + 1) * dim]);
    }
    rows
}

fn squared_distance(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum()
}

fn plus_plus(rows: &[f32], dim: usize, config: &KmeansConfig) -> Vec<f32> {
    let n = rows.len() / dim;
    let row = |i: usize| &rows[i * dim..(i + 1) * dim];
    let mut rng = generator(config.seed, "kmeans start", 0);
    let mut centroids = row(rng.random_range(0..n)).to_vec();
    let mut nearest = vec![f32::INFINITY; n];
    while centroids.len() < config.clusters * dim {
        let last = centroids[centroids.len() - dim..].to_vec();
        nearest.par_chunks_mut(BLOCK).zip(rows.par_chunks(BLOCK * dim)).for_each(|(best, block)| {
            for (b, x) in best.iter_mut().zip(block.chunks_exact(dim)) {
                *b = b.min(squared_distance(x, &last));
            }
        });
        let total: f64 = nearest.iter().map(|&d| f64::from(d)).sum();
        let mut left = rng.random_range(0.0..1.0) * total;
        // All rows are centroids already: repeat any of them.
        let fallback = rng.random_range(0..n);
        let next = nearest.iter().position(|&d| {
            left -= f64::from(d);
            left < 0.0
        });
        centroids.extend_from_slice(row(next.unwrap_or(fallback)));
    }
    centroids
}

/// Nearest centroid of every row and the squared distance to it; ties go to the lower index.
fn assign(rows: &[f32], dim: usize, centroids: &[f32]) -> Vec<(u32, f32)> {
    // ‖x − c‖² = ‖x‖² − 2(x·c − ‖c‖²/2): only the bracket depends on the centroid.
    let half: Vec<f32> =
        centroids.chunks_exact(dim).map(|c| 0.5 * c.iter().map(|v| v * v).sum::<f32>()).collect();
    let clusters = half.len();
    // Dimension-major, so that the inner loop runs over clusters and vectorises.
    let mut columns = vec![0.0f32; centroids.len()];
    for (k, c) in centroids.chunks_exact(dim).enumerate() {
        c.iter().enumerate().for_each(|(d, &v)| columns[d * clusters + k] = v);
    }
    let blocks: Vec<Vec<(u32, f32)>> = rows
        .par_chunks(BLOCK * dim)
        .map(|block| {
            let mut scores = vec![0.0f32; clusters];
            let nearest = |x: &[f32]| {
                scores.iter_mut().zip(&half).for_each(|(s, h)| *s = -h);
                for (&v, column) in x.iter().zip(columns.chunks_exact(clusters)) {
                    scores.iter_mut().zip(column).for_each(|(s, c)| *s += v * c);
                }
                let mut best = 0;
                (1..clusters).for_each(|k| {
                    if scores[k] > scores[best] {
                        best = k;
                    }
                });
                (best as u32, squared_distance(x, &centroids[best * dim..(best + 1) * dim]))
            };
            block.chunks_exact(dim).map(nearest).collect()
        })
        .collect();
    blocks.concat()
}

fn means(rows: &[f32], dim: usize, assigned: &[(u32, f32)], clusters: usize, centroids: &[f32]) -> Vec<f32> {
    let partial: Vec<(Vec<f64>, Vec<usize>)> = rows
        .par_chunks(BLOCK * dim)
        .zip(assigned.par_chunks(BLOCK))
        .map(|(block, labels)| {
            let (mut sums, mut counts) = (vec![0.0f64; clusters * dim], vec![0usize; clusters]);
            for (x, &(label, _)) in block.chunks_exact(dim).zip(labels) {
                let k = label as usize;
                counts[k] += 1;
                sums[k * dim..(k + 1) * dim].iter_mut().zip(x).for_each(|(s, v)| *s += f64::from(*v));
            }
            (sums, counts)
        })
        .collect();
    let (mut sums, mut counts) = (vec![0.0f64; clusters * dim], vec![0usize; clusters]);
    for (s, c) in &partial {
        sums.iter_mut().zip(s).for_each(|(a, b)| *a += b);
        counts.iter_mut().zip(c).for_each(|(a, b)| *a += b);
    }
    let mut farthest: Vec<usize> = Vec::new();
    if counts.contains(&0) {
        farthest = (0..assigned.len()).collect();
        farthest.sort_by(|&a, &b| assigned[b].1.total_cmp(&assigned[a].1).then(a.cmp(&b)));
    }
    let mut farthest = farthest.into_iter();
    let mut result = centroids.to_vec();
    for (k, &count) in counts.iter().enumerate() {
        let target = &mut result[k * dim..(k + 1) * dim];
        if count > 0 {
            let inverse = 1.0 / count as f64;
            target.iter_mut().zip(&sums[k * dim..]).for_each(|(t, s)| *t = (s * inverse) as f32);
        } else if let Some(i) = farthest.next().filter(|&i| assigned[i].1 > 0.0) {
            target.copy_from_slice(&rows[i * dim..(i + 1) * dim]);
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(clusters: usize) -> KmeansConfig {
        KmeansConfig { clusters, sample: 10_000, rounds: 50, seed: 5 }
    }

    /// Three tight groups around known places.
    fn groups(n: usize) -> Vec<f32> {
        let mut rng = generator(9, "test", 0);
        let places = [[0.0f32, 0.0], [5.0, 0.0], [0.0, 9.0]];
        (0..n)
            .flat_map(|i| {
                let p = places[i % 3];
                [p[0] + rng.random_range(-0.1f32..0.1), p[1] + rng.random_range(-0.1f32..0.1)]
            })
            .collect()
    }

    #[test]
    fn separate_groups_are_found_at_their_means() {
        let rows = groups(3000);
        let mut found: Vec<(f32, f32)> =
            kmeans(&[&rows], 2, &config(3)).chunks_exact(2).map(|c| (c[0], c[1])).collect();
        found.sort_by(|a, b| (a.0 + 2.0 * a.1).total_cmp(&(b.0 + 2.0 * b.1)));
        for (f, e) in found.iter().zip([(0.0, 0.0), (5.0, 0.0), (0.0, 9.0)]) {
            // Mean of 1000 draws of half-width 0.1: standard error 0.0018.
            assert!((f.0 - e.0).abs() < 0.01 && (f.1 - e.1).abs() < 0.01, "{found:?}");
        }
    }

    #[test]
    fn assignment_is_the_brute_force_nearest() {
        let rows = groups(200);
        let centroids = [0.1, 0.3, 4.0, 4.0, 0.0, 8.0, 2.0, 2.0];
        for (i, (label, d)) in assign(&rows, 2, &centroids).into_iter().enumerate() {
            let all: Vec<f32> =
                centroids.chunks_exact(2).map(|c| squared_distance(&rows[2 * i..2 * i + 2], c)).collect();
            let best = (0..4).min_by(|&a, &b| all[a].total_cmp(&all[b])).unwrap();
            assert_eq!((label as usize, d), (best, all[best]));
        }
    }

    #[test]
    fn threads_do_not_change_the_result_and_seeds_do() {
        let rows = groups(5000);
        let run = |threads: usize, seed: u64| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let c = KmeansConfig { sample: 4000, seed, ..config(8) };
            pool.install(|| kmeans(&[&rows[..4000], &rows[4000..]], 2, &c))
        };
        assert_eq!(run(1, 5), run(3, 5));
        assert_ne!(run(1, 5), run(1, 6));
    }

    #[test]
    fn fewer_rows_than_clusters_still_give_every_centroid() {
        let rows = [1.0f32, 2.0, 3.0, 4.0];
        let centroids = kmeans(&[&rows], 2, &config(5));
        assert_eq!(centroids.len(), 10);
        for row in rows.chunks_exact(2) {
            assert!(centroids.chunks_exact(2).any(|c| c == row), "{centroids:?}");
        }
        assert_eq!(kmeans(&[], 2, &config(2)), vec![0.0; 4]);
    }
}
