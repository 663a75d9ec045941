//! Exact nearest neighbours between two sets of descriptors, in both directions at once.
//!
//! Squared Euclidean distance ‖x−y‖² is least where x·y − ½‖y‖² is greatest, so one
//! pass over the dot products serves the rows (x) and the columns (y). Every dot product
//! is accumulated in the same order whatever the blocking, so that results computed
//! piece by piece are bit-identical to results computed in one go.

use crate::scan::Descriptors;
use aligned_vec::{AVec, ConstAlign, avec};
use macerator::{AutoArch, Mask, Scalar, Simd, Vector, WithSimd};
use rayon::prelude::*;

/// Columns of a group: two of the widest vectors.
const LANES: usize = 32;
/// Rows that are kept side by side: with two vectors of columns, as many sums at a time as keep the
/// multipliers busy from one load to the next, where there are registers for them.
const BLOCK: usize = 12;
/// Rows that are compared at a time, of a block, where there are few registers.
const HALF: usize = 6;
/// Rows handled by one task.
const CHUNK: usize = 43 * BLOCK;
/// Values of the columns that all rows of a task go through before the next ones are fetched: half of a
/// small level-one cache.
const PANEL: usize = 6144;

/// Numbers that vectors are loaded from and stored to.
type Lanes<T> = AVec<T, ConstAlign<64>>;

/// Best counterpart of one descriptor: `score = x·y − ½‖y‖²`, and the index of `y`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Best {
    /// Larger is nearer; `-inf` when there was nothing to compare with.
    pub score: f32,
    /// Index of the counterpart; [`Best::NONE`]'s when there is none.
    pub index: u32,
}

impl Best {
    /// No counterpart yet.
    pub const NONE: Best = Best { score: f32::NEG_INFINITY, index: u32::MAX };

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

/// Descriptors laid out for the kernel: groups of 32 columns, dimension by dimension.
#[derive(Debug, Clone)]
pub struct Columns {
    dim: usize,
    len: usize,
    packed: Lanes<f32>,
    half_norms: Lanes<f32>,
}

impl Columns {
    /// Packs `descriptors` `[n,D]`.
    pub fn new(descriptors: &Descriptors) -> Self {
        let (dim, len) = (descriptors.dim(), descriptors.len());
        let groups = len.div_ceil(LANES);
        let mut packed: Lanes<f32> = avec![[64]| 0.0; groups * dim * LANES];
        // Padding columns are infinitely far away.
        let mut half_norms: Lanes<f32> = avec![[64]| f32::INFINITY; groups * LANES];
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
        let mut packed: Lanes<f32> = avec![[64]| 0.0; groups * self.dim * LANES];
        let mut half_norms: Lanes<f32> = avec![[64]| f32::INFINITY; groups * LANES];
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
    let mut of_columns = vec![Best::NONE; columns.len];
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
    let at_a_time = AutoArch::new().dispatch(AtATime);
    let blocks: Vec<RowBlock> =
        ids.chunks(BLOCK).map(|block| RowBlock::new(values, block, columns.dim, at_a_time)).collect();
    let mut of_columns = Running::new(padded);
    let mut of_rows = Running::new(blocks.len() * BLOCK * LANES);
    let panel = (PANEL / (columns.dim * LANES)).max(1) * LANES;
    for first in (0..padded).step_by(panel) {
        let range = first..(first + panel).min(padded);
        let packed = &columns.packed[range.start * columns.dim..range.end * columns.dim];
        for (b, rows) in blocks.iter().enumerate() {
            let (column_score, column_index) = of_columns.part(range.clone());
            let (row_score, row_start) = of_rows.part(b * BLOCK * LANES..(b + 1) * BLOCK * LANES);
            AutoArch::new().dispatch(Kernel {
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
    scores: Lanes<f32>,
    of: Lanes<u32>,
}

impl Running {
    fn new(lanes: usize) -> Self {
        Self { scores: avec![[64]| f32::NEG_INFINITY; lanes], of: avec![[64]| u32::MAX; lanes] }
    }

    fn part(&mut self, lanes: std::ops::Range<usize>) -> (&mut [f32], &mut [u32]) {
        (&mut self.scores[lanes.clone()], &mut self.of[lanes])
    }

    fn best(&self, lane: usize) -> Best {
        match self.of[lane] {
            u32::MAX => Best::NONE,
            index => Best { score: self.scores[lane], index },
        }
    }
}

/// A few rows side by side, so many at a time: `values[part][d][q]`. A short block repeats its last row,
/// which changes no answer.
struct RowBlock {
    values: Vec<f32>,
    half_norms: [f32; BLOCK],
    ids: [u32; BLOCK],
}

impl RowBlock {
    fn new(all: &[f32], ids: &[u32], dim: usize, at_a_time: usize) -> Self {
        let ids: [u32; BLOCK] = std::array::from_fn(|q| ids[q.min(ids.len() - 1)]);
        let rows = ids.map(|id| &all[id as usize * dim..(id as usize + 1) * dim]);
        let mut values = vec![0.0; dim * BLOCK];
        for (part, rows) in values.chunks_exact_mut(dim.max(1) * at_a_time).zip(rows.chunks_exact(at_a_time))
        {
            for (q, row) in rows.iter().enumerate() {
                for (d, &v) in row.iter().enumerate() {
                    part[d * at_a_time + q] = v;
                }
            }
        }
        Self { values, half_norms: rows.map(half_norm), ids }
    }
}

/// Rows that the processor compares at a time.
struct AtATime;

impl WithSimd for AtATime {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self) -> usize {
        if f32::lanes::<S>() == LANES / 2 { BLOCK } else { HALF }
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
    /// Of every row in [`LANES`] lanes, its nearest column, as the column of the first lane.
    row_score: &'a mut [f32],
    row_start: &'a mut [u32],
}

impl WithSimd for Kernel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self) {
        match LANES / f32::lanes::<S>() {
            2 => self.compare::<S, 2, BLOCK>(0),
            4 => (0..BLOCK).step_by(HALF).for_each(|row| self.compare::<S, 4, HALF>(row)),
            8 => (0..BLOCK).step_by(HALF).for_each(|row| self.compare::<S, 8, HALF>(row)),
            _ => (0..BLOCK).step_by(HALF).for_each(|row| self.compare::<S, LANES, HALF>(row)),
        }
    }
}

impl Kernel<'_> {
    /// `R` rows from `row` on; `G` vectors are in every group of columns.
    #[inline(always)]
    fn compare<S: Simd, const G: usize, const R: usize>(&mut self, row: usize) {
        /// Vectors of columns at a time.
        const W: usize = 2;
        let lanes = f32::lanes::<S>();
        let packed = vectors::<S, f32>(self.packed).chunks_exact(self.dim * G);
        let halves = vectors::<S, f32>(self.half_norms).as_chunks::<G>().0;
        let scores = vectors_mut::<S, f32>(self.column_score).as_chunks_mut::<G>().0;
        let indices = vectors_mut::<S, u32>(self.column_index).as_chunks_mut::<G>().0;
        let row_scores = vectors_mut::<S, f32>(self.row_score);
        let row_starts = vectors_mut::<S, u32>(self.row_start);
        let row_half: [Vector<S, f32>; R] = std::array::from_fn(|q| self.rows.half_norms[row + q].splat());
        let row_id: [Vector<S, u32>; R] = std::array::from_fn(|q| self.rows.ids[row + q].splat());
        let mut best_score: [Vector<S, f32>; R] = std::array::from_fn(|q| row_scores[(row + q) * G]);
        let mut best_start: [Vector<S, u32>; R] = std::array::from_fn(|q| row_starts[(row + q) * G]);
        let values = self.rows.values[row * self.dim..(row + R) * self.dim].as_chunks::<R>().0;
        let groups = packed.zip(halves).zip(scores).zip(indices);
        for (group, (((ys, halves), scores), indices)) in groups.enumerate() {
            for at in (0..G).step_by(W) {
                let mut dot = [[0f32.splat::<S>(); W]; R];
                for (x, y) in values.iter().zip(ys.as_chunks::<G>().0) {
                    for q in 0..R {
                        let x = x[q].splat::<S>();
                        for w in 0..W {
                            dot[q][w] = x.fma(y[at + w], dot[q][w]);
                        }
                    }
                }
                for w in 0..W {
                    let start = ((self.first + group * LANES + (at + w) * lanes) as u32).splat::<S>();
                    let (mut score, mut index) = (scores[at + w], indices[at + w]);
                    for q in 0..R {
                        let of_row = dot[q][w] - halves[at + w];
                        best_start[q] = select(best_score[q].lt(of_row), start, best_start[q]);
                        best_score[q] = of_row.max(best_score[q]);
                        let of_column = dot[q][w] - row_half[q];
                        index = select(score.lt(of_column), row_id[q], index);
                        score = of_column.max(score);
                    }
                    (scores[at + w], indices[at + w]) = (score, index);
                }
            }
        }
        for q in 0..R {
            row_scores[(row + q) * G] = best_score[q];
            row_starts[(row + q) * G] = best_start[q];
        }
    }
}

/// Where the mask is set `one`, elsewhere `other`.
#[inline(always)]
fn select<S: Simd>(mask: Mask<S, f32>, one: Vector<S, u32>, other: Vector<S, u32>) -> Vector<S, u32> {
    mask.select(one.reinterpret::<f32>(), other.reinterpret::<f32>()).reinterpret::<u32>()
}

/// Aligned numbers, whole vectors of them, as vectors.
#[inline(always)]
fn vectors<S: Simd, T: Scalar>(values: &[T]) -> &[Vector<S, T>] {
    bytemuck::cast_slice(values)
}

/// The same, to be written.
#[inline(always)]
fn vectors_mut<S: Simd, T: Scalar>(values: &mut [T]) -> &mut [Vector<S, T>] {
    bytemuck::cast_slice_mut(values)
}

/// The best over the lanes of a row; `starts` are the columns of their first lane.
fn lowest(scores: &[f32], starts: &[u32]) -> Best {
    scores.iter().zip(starts).enumerate().fold(Best::NONE, |best, (lane, (&score, &start))| match start {
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
        // One pair at a time, summed up in the same order: the same to the bit, whatever the processor.
        let nearest = |of: &Descriptors, i: usize, with_scan_count_prior: &Descriptors| {
            let score = |j: usize| {
                let dot = of
                    .row(i)
                    .iter()
                    .zip(with_scan_count_prior.row(j))
                    .fold(0f32, |sum, (x, y)| x.mul_add(*y, sum));
                dot - half_norm(with_scan_count_prior.row(j))
            };
            let best = (0..with_scan_count_prior.len())
                .max_by(|&j, &k| score(j).total_cmp(&score(k)).then(k.cmp(&j)))
                .unwrap();
            Best { score: score(best), index: best as u32 }
        };
        for (i, best) in found.of_rows.iter().enumerate() {
            assert_eq!(*best, nearest(&rows, i, &columns), "row {i}");
        }
        for (j, best) in found.of_columns.iter().enumerate() {
            assert_eq!(*best, nearest(&columns, j, &rows), "column {j}");
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
        assert_eq!(nearest_both(some.values(), &[0], &Columns::new(&none)).of_rows, vec![Best::NONE]);
        assert_eq!(nearest_both(none.values(), &[], &Columns::new(&some)).of_columns, vec![Best::NONE]);
    }
}
