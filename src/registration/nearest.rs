//! Exact nearest neighbours between two sets of descriptors, in both directions at once.
//!
//! Squared Euclidean distance ‖x−y‖² is least where x·y − ½‖y‖² is greatest, so one
//! pass over the dot products serves the rows (x) and the columns (y). Every dot product
//! is accumulated in the same order whatever the blocking, so that results computed
//! piece by piece are bit-identical to results computed in one go.

use crate::scan::Descriptors;
use pulp::bytemuck::cast_slice;
use rayon::prelude::*;
use std::slice::from_ref;

const LANES: usize = 16;
/// Rows that go through the columns together.
const BLOCK: usize = 8;
/// Rows handled by one task.
const CHUNK: usize = 512;

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
    let mut column_score = vec![f32::NEG_INFINITY; padded];
    let mut column_index = vec![u32::MAX; padded];
    let mut of_rows = Vec::with_capacity(ids.len());
    for block in ids.chunks(BLOCK) {
        let rows = RowBlock::new(values, block, columns.dim);
        let kernel =
            Kernel { rows: &rows, columns, column_score: &mut column_score, column_index: &mut column_index };
        let best = pulp::Arch::new().dispatch(kernel);
        of_rows.extend_from_slice(&best[..block.len()]);
    }
    let of_columns = (0..columns.len)
        .map(|c| match column_index[c] {
            u32::MAX => Best::NOBODY,
            index => Best { score: column_score[c], index },
        })
        .collect();
    Nearest { of_rows, of_columns }
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

/// One block of rows against all columns, in the widest vectors the processor has.
struct Kernel<'a> {
    rows: &'a RowBlock,
    columns: &'a Columns,
    column_score: &'a mut [f32],
    column_index: &'a mut [u32],
}

impl pulp::WithSimd for Kernel<'_> {
    type Output = [Best; BLOCK];

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) -> [Best; BLOCK] {
        let Kernel { rows, columns, column_score, column_index } = self;
        let (vectors, _) = S::as_simd_f32s(&columns.packed);
        let (halves, _) = S::as_simd_f32s(&columns.half_norms);
        let (scores, _) = S::as_mut_simd_f32s(column_score);
        let (indices, _) = S::as_mut_simd_u32s(column_index);
        let per_group = LANES / S::F32_LANES;
        let row_half = rows.half_norms.map(|h| simd.splat_f32s(h));
        let row_id = rows.ids.map(|id| simd.splat_u32s(id));
        let mut best_score = [simd.splat_f32s(f32::NEG_INFINITY); BLOCK];
        let mut best_start = [simd.splat_u32s(u32::MAX); BLOCK];
        for at in 0..halves.len() {
            let first = at / per_group * columns.dim * per_group + at % per_group;
            let mut dot = [simd.splat_f32s(0.0); BLOCK];
            let column = vectors[first..].iter().step_by(per_group);
            for (x, &y) in rows.values.chunks_exact(BLOCK).zip(column) {
                for q in 0..BLOCK {
                    dot[q] = simd.mul_add_f32s(simd.splat_f32s(x[q]), y, dot[q]);
                }
            }
            let start = simd.splat_u32s((at * S::F32_LANES) as u32);
            let (mut score, mut index) = (scores[at], indices[at]);
            for q in 0..BLOCK {
                let of_row = simd.sub_f32s(dot[q], halves[at]);
                let nearer = simd.less_than_f32s(best_score[q], of_row);
                best_score[q] = simd.select_f32s(nearer, of_row, best_score[q]);
                best_start[q] = simd.select_u32s(nearer, start, best_start[q]);
                let of_column = simd.sub_f32s(dot[q], row_half[q]);
                let nearer = simd.less_than_f32s(score, of_column);
                score = simd.select_f32s(nearer, of_column, score);
                index = simd.select_u32s(nearer, row_id[q], index);
            }
            (scores[at], indices[at]) = (score, index);
        }
        std::array::from_fn(|q| {
            let scores: &[f32] = cast_slice(from_ref(&best_score[q]));
            lowest(scores, cast_slice(from_ref(&best_start[q])))
        })
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
    fn ties_go_to_the_lower_index_in_both_directions() {
        let same = Descriptors::new(3, [1.0f32, 0.0, 0.0].repeat(40)).unwrap();
        let ids: Vec<u32> = (0..40).collect();
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
