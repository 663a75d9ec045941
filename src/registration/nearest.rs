//! Exact nearest neighbours between two sets of descriptors, in both directions at once.
//!
//! Squared Euclidean distance ‖x−y‖² is least where x·y − ½‖y‖² is greatest, so one
//! pass over the dot products serves the rows (x) and the columns (y). Every dot product
//! is accumulated in the same order whatever the blocking, so that results computed
//! piece by piece are bit-identical to results computed in one go.

use crate::scan::Descriptors;
use rayon::prelude::*;

const LANES: usize = 16;
/// Rows that go through the columns together: with two vectors of columns, twelve sums at a time, enough
/// to keep two multipliers busy from one load to the next.
const BLOCK: usize = 6;
/// Rows handled by one task.
const CHUNK: usize = 85 * BLOCK;
/// Values of the columns that all rows of a task go through before the next ones are fetched: half of a
/// small level-one cache.
const PANEL: usize = 6144;

/// Best counterpart of one descriptor: `score = x·y − ½‖y‖²`, and the index of `y`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Best {
    /// Larger is nearer; `-inf` when there was nothing to compare with.
    pub score: f32,
    /// Index of the counterpart; [`Best::NOBODY`]'s when there is none.
    pub index: u32,
}

impl Best {
    /// No counterpart yet.
    pub const NOBODY: Best = Best { score: f32::NEG_INFINITY, index: u32::MAX };

    /// The nearer of two; equal scores go to the lower index.
    #[inline]
    pub fn or(self, other: Best) -> Best {
        if other.score > self.score || (other.score == self.score && other.index < self.index) {
            other
        } else {
            self
        }
    }
}

/// Half the squared norm of a row.
#[inline(always)]
fn half_norm(row: &[f32]) -> f32 {
    0.5 * row.iter().map(|v| v * v).sum::<f32>()
}

/// Descriptors laid out for the kernel: groups of 16 columns, dimension by dimension.
#[derive(Debug, Clone)]
pub struct Columns {
    dim: usize,
    len: usize,
    packed: Vec<f32>,
    half_norms: Vec<f32>,
}

impl Columns {
    /// Packs `descriptors` `[n,D]`.
    pub fn new(descriptors: &Descriptors) -> Self {
        let (dim, len) = (descriptors.dim(), descriptors.len());
        let groups = len.div_ceil(LANES);
        let mut packed = vec![0.0; groups * dim * LANES];
        // Padding columns are infinitely far away.
        let mut half_norms = vec![f32::INFINITY; groups * LANES];
        for (i, half) in half_norms.iter_mut().enumerate().take(len) {
            let (group, lane) = (i / LANES, i % LANES);
            for (d, &v) in descriptors.row(i).iter().enumerate() {
                packed[(group * dim + d) * LANES + lane] = v;
            }
            *half = half_norm(descriptors.row(i));
        }
        Self { dim, len, packed, half_norms }
    }

    /// The chosen columns, in the given order.
    pub fn select(&self, chosen: &[usize]) -> Self {
        let groups = chosen.len().div_ceil(LANES);
        let mut packed = vec![0.0; groups * self.dim * LANES];
        let mut half_norms = vec![f32::INFINITY; groups * LANES];
        for (to, &from) in chosen.iter().enumerate() {
            for d in 0..self.dim {
                packed[(to / LANES * self.dim + d) * LANES + to % LANES] =
                    self.packed[(from / LANES * self.dim + d) * LANES + from % LANES];
            }
            half_norms[to] = self.half_norms[from];
        }
        Self { dim: self.dim, len: chosen.len(), packed, half_norms }
    }

    /// Number of columns.
    pub fn len(&self) -> usize {
        self.len
    }

    /// True when there is no column.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
}

/// Nearest counterparts in both directions.
#[derive(Debug, Clone, PartialEq)]
pub struct Nearest {
    /// For every given row, its nearest column.
    pub of_rows: Vec<Best>,
    /// For every column, its nearest given row; the index is an entry of `ids`.
    pub of_columns: Vec<Best>,
}

/// Nearest neighbours between the rows of `values` (row-major `[·,D]`) named by `ids` and all columns.
///
/// `ids` must be ascending for ties to go to the lower row.
pub fn nearest_both(values: &[f32], ids: &[u32], columns: &Columns) -> Nearest {
    let parts: Vec<Nearest> = ids.par_chunks(CHUNK).map(|ids| nearest_chunk(values, ids, columns)).collect();
    let mut of_rows = Vec::with_capacity(ids.len());
    let mut of_columns = vec![Best::NOBODY; columns.len];
    for part in parts {
        of_rows.extend(part.of_rows);
        for (best, new) in of_columns.iter_mut().zip(part.of_columns) {
            *best = best.or(new);
        }
    }
    Nearest { of_rows, of_columns }
}

fn nearest_chunk(values: &[f32], ids: &[u32], columns: &Columns) -> Nearest {
    let padded = columns.half_norms.len();
    let blocks: Vec<RowBlock> =
        ids.chunks(BLOCK).map(|block| RowBlock::new(values, block, columns.dim)).collect();
    let mut of_columns = Running::new(padded);
    let mut of_rows = Running::new(blocks.len() * BLOCK * LANES);
    let panel = (PANEL / (columns.dim * LANES)).max(1) * LANES;
    for first in (0..padded).step_by(panel) {
        let range = first..(first + panel).min(padded);
        let packed = &columns.packed[range.start * columns.dim..range.end * columns.dim];
        for (b, rows) in blocks.iter().enumerate() {
            let (column_score, column_index) = of_columns.part(range.clone());
            let (row_score, row_start) = of_rows.part(b * BLOCK * LANES..(b + 1) * BLOCK * LANES);
            pulp::Arch::new().dispatch(Kernel {
                rows,
                dim: columns.dim,
                first,
                packed,
                half_norms: &columns.half_norms[range.clone()],
                column_score,
                column_index,
                row_score,
                row_start,
            });
        }
    }
    let of_row = |r: usize| {
        let lanes = r * LANES..(r + 1) * LANES;
        lowest(&of_rows.scores[lanes.clone()], &of_rows.of[lanes])
    };
    Nearest {
        of_rows: (0..ids.len()).map(of_row).collect(),
        of_columns: (0..columns.len).map(|c| of_columns.best(c)).collect(),
    }
}

/// The best so far, lane by lane: scores, and what they belong to.
struct Running {
    scores: Vec<f32>,
    of: Vec<u32>,
}

impl Running {
    fn new(lanes: usize) -> Self {
        Self { scores: vec![f32::NEG_INFINITY; lanes], of: vec![u32::MAX; lanes] }
    }

    fn part(&mut self, lanes: std::ops::Range<usize>) -> (&mut [f32], &mut [u32]) {
        (&mut self.scores[lanes.clone()], &mut self.of[lanes])
    }

    fn best(&self, lane: usize) -> Best {
        match self.of[lane] {
            u32::MAX => Best::NOBODY,
            index => Best { score: self.scores[lane], index },
        }
    }
}

/// A few rows side by side: `values[d·BLOCK + q]`. A short block repeats its last row,
/// which changes no answer.
struct RowBlock {
    values: Vec<f32>,
    half_norms: [f32; BLOCK],
    ids: [u32; BLOCK],
}

impl RowBlock {
    fn new(all: &[f32], ids: &[u32], dim: usize) -> Self {
        let ids: [u32; BLOCK] = std::array::from_fn(|q| ids[q.min(ids.len() - 1)]);
        let rows = ids.map(|id| &all[id as usize * dim..(id as usize + 1) * dim]);
        let mut values = vec![0.0; dim * BLOCK];
        for (q, row) in rows.iter().enumerate() {
            for (d, &v) in row.iter().enumerate() {
                values[d * BLOCK + q] = v;
            }
        }
        Self { values, half_norms: rows.map(half_norm), ids }
    }
}

/// One block of rows against some columns, in the widest vectors the processor has.
struct Kernel<'a> {
    rows: &'a RowBlock,
    dim: usize,
    /// The first of the columns.
    first: usize,
    packed: &'a [f32],
    half_norms: &'a [f32],
    /// Of every column, its nearest row.
    column_score: &'a mut [f32],
    column_index: &'a mut [u32],
    /// Of every row in 16 lanes, its nearest column, as the column of the first lane.
    row_score: &'a mut [f32],
    row_start: &'a mut [u32],
}

impl pulp::WithSimd for Kernel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        if S::F32_LANES < LANES { self.compare::<S, 2>(simd) } else { self.compare::<S, 1>(simd) }
    }
}

impl Kernel<'_> {
    /// `W` vectors of columns at a time; as many are in every group of 16.
    #[inline(always)]
    fn compare<S: pulp::Simd, const W: usize>(self, simd: S) {
        let (vectors, _) = S::as_simd_f32s(self.packed);
        let (halves, _) = S::as_simd_f32s(self.half_norms);
        let (scores, _) = S::as_mut_simd_f32s(self.column_score);
        let (indices, _) = S::as_mut_simd_u32s(self.column_index);
        let (row_scores, _) = S::as_mut_simd_f32s(self.row_score);
        let (row_starts, _) = S::as_mut_simd_u32s(self.row_start);
        let per_group = LANES / S::F32_LANES;
        let row_half = self.rows.half_norms.map(|h| simd.splat_f32s(h));
        let row_id = self.rows.ids.map(|id| simd.splat_u32s(id));
        let mut best_score: [S::f32s; BLOCK] = std::array::from_fn(|q| row_scores[q * per_group]);
        let mut best_start: [S::u32s; BLOCK] = std::array::from_fn(|q| row_starts[q * per_group]);
        let columns = halves.chunks_exact(W).zip(scores.chunks_exact_mut(W)).zip(indices.chunks_exact_mut(W));
        for (at, ((halves, scores), indices)) in (0..).step_by(W).zip(columns) {
            let begin = at / per_group * self.dim * per_group + at % per_group;
            let mut dot = [[simd.splat_f32s(0.0); W]; BLOCK];
            for (x, y) in self.rows.values.chunks_exact(BLOCK).zip(vectors[begin..].chunks(per_group)) {
                let Some(y) = y.first_chunk::<W>() else { break };
                for q in 0..BLOCK {
                    let x = simd.splat_f32s(x[q]);
                    for w in 0..W {
                        dot[q][w] = simd.mul_add_f32s(x, y[w], dot[q][w]);
                    }
                }
            }
            for w in 0..W {
                let start = simd.splat_u32s((self.first + (at + w) * S::F32_LANES) as u32);
                let (mut score, mut index) = (scores[w], indices[w]);
                for q in 0..BLOCK {
                    let of_row = simd.sub_f32s(dot[q][w], halves[w]);
                    let nearer = simd.less_than_f32s(best_score[q], of_row);
                    best_score[q] = simd.select_f32s(nearer, of_row, best_score[q]);
                    best_start[q] = simd.select_u32s(nearer, start, best_start[q]);
                    let of_column = simd.sub_f32s(dot[q][w], row_half[q]);
                    let nearer = simd.less_than_f32s(score, of_column);
                    score = simd.select_f32s(nearer, of_column, score);
                    index = simd.select_u32s(nearer, row_id[q], index);
                }
                (scores[w], indices[w]) = (score, index);
            }
        }
        for q in 0..BLOCK {
            row_scores[q * per_group] = best_score[q];
            row_starts[q * per_group] = best_start[q];
        }
    }
}

/// The best over the lanes of a row; `starts` are the columns of their first lane.
fn lowest(scores: &[f32], starts: &[u32]) -> Best {
    scores.iter().zip(starts).enumerate().fold(Best::NOBODY, |best, (lane, (&score, &start))| match start {
        u32::MAX => best,
        start => best.or(Best { score, index: start + lane as u32 }),
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};

    /// Independent of the kernel: double precision, one pair at a time.
    fn brute(rows: &Descriptors, columns: &Descriptors) -> (Vec<f64>, Vec<f64>) {
        let distance = |a: &[f32], b: &[f32]| -> f64 {
            a.iter().zip(b).map(|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2)).sum()
        };
        let least = |a: &Descriptors, b: &Descriptors| {
            (0..a.len())
                .map(|i| (0..b.len()).map(|j| distance(a.row(i), b.row(j))).fold(f64::INFINITY, f64::min))
                .collect::<Vec<_>>()
        };
        (least(rows, columns), least(columns, rows))
    }

    pub(crate) fn descriptors(
        dim: usize,
        n: impl Into<prop::collection::SizeRange>,
    ) -> impl Strategy<Value = Descriptors> {
        prop::collection::vec(prop::collection::vec(-1.0f32..1.0, dim), n)
            .prop_map(move |rows| Descriptors::new(dim, rows.concat()).unwrap().normalized())
    }

    proptest! {
        #[test]
        fn the_nearest_are_as_near_as_brute_force_says(rows in descriptors(7, 1..60), columns in descriptors(7, 1..60)) {
            let ids: Vec<u32> = (0..rows.len() as u32).collect();
            let found = nearest_both(rows.values(), &ids, &Columns::new(&columns));
            let (of_rows, of_columns) = brute(&rows, &columns);
            let distance = |i: usize, j: usize| -> f64 {
                rows.row(i).iter().zip(columns.row(j)).map(|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2)).sum()
            };
            for (i, best) in found.of_rows.iter().enumerate() {
                prop_assert!((distance(i, best.index as usize) - of_rows[i]).abs() < 1e-6);
            }
            for (j, best) in found.of_columns.iter().enumerate() {
                prop_assert!((distance(best.index as usize, j) - of_columns[j]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn rows_of_several_tasks_find_the_nearest_of_several_panels() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let mut draw = |n: usize| {
            let values = (0..40 * n).map(|_| rng.random_range(-1.0f32..1.0)).collect();
            Descriptors::new(40, values).unwrap().normalized()
        };
        let (rows, columns) = (draw(CHUNK + 100), draw(3 * PANEL / 40 - 5));
        let ids: Vec<u32> = (0..rows.len() as u32).collect();
        let found = nearest_both(rows.values(), &ids, &Columns::new(&columns));
        let nearest = |of: &Descriptors, i: usize, among: &Descriptors| {
            let distance = |j: usize| -> f64 {
                of.row(i).iter().zip(among.row(j)).map(|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2)).sum()
            };
            (0..among.len()).min_by(|&j, &k| distance(j).total_cmp(&distance(k))).unwrap() as u32
        };
        for (i, best) in found.of_rows.iter().enumerate() {
            assert_eq!(best.index, nearest(&rows, i, &columns), "row {i}");
        }
        for (j, best) in found.of_columns.iter().enumerate() {
            assert_eq!(best.index, nearest(&columns, j, &rows), "column {j}");
        }
    }

    #[test]
    fn ties_go_to_the_lower_index_in_both_directions() {
        let same = Descriptors::new(40, [1.0f32; 40].repeat(CHUNK + 10)).unwrap();
        let ids: Vec<u32> = (0..same.len() as u32).collect();
        let found = nearest_both(same.values(), &ids, &Columns::new(&same));
        assert!(found.of_rows.iter().all(|b| b.index == 0));
        assert!(found.of_columns.iter().all(|b| b.index == 0));
    }

    #[test]
    fn nothing_to_compare_gives_nobody() {
        let some = Descriptors::new(2, vec![1.0, 0.0]).unwrap();
        let none = Descriptors::new(2, vec![]).unwrap();
        assert_eq!(nearest_both(some.values(), &[0], &Columns::new(&none)).of_rows, vec![Best::NOBODY]);
        assert_eq!(nearest_both(none.values(), &[], &Columns::new(&some)).of_columns, vec![Best::NOBODY]);
    }
}
