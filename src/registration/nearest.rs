//! Exact nearest neighbours between two sets of descriptors, in both directions at once.
//!
//! Squared Euclidean distance ‖x−y‖² is least where x·y − ½‖y‖² is greatest, so one
//! pass over the dot products serves the rows (x) and the columns (y). Every dot product
//! is accumulated in the same order whatever the blocking, so that results computed
//! piece by piece are bit-identical to results computed in one go.

use crate::scan::Descriptors;
use rayon::prelude::*;

const LANES: usize = 16;
const BLOCK: usize = 4;
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

/// Half the squared norm of a row, accumulated like the dot products.
#[inline]
fn half_norm(row: &[f32]) -> f32 {
    0.5 * row.iter().fold(0.0f32, |sum, &v| v.mul_add(v, sum))
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
        for i in 0..len {
            let (group, lane) = (i / LANES, i % LANES);
            for (d, &v) in descriptors.row(i).iter().enumerate() {
                packed[(group * dim + d) * LANES + lane] = v;
            }
            half_norms[i] = half_norm(descriptors.row(i));
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
    pulp::Arch::new().dispatch(|| {
        let mut blocks = ids.chunks_exact(BLOCK);
        for block in &mut blocks {
            let rows: [&[f32]; BLOCK] = std::array::from_fn(|q| row(values, block[q], columns.dim));
            let ids: [u32; BLOCK] = std::array::from_fn(|q| block[q]);
            of_rows.extend(block_kernel(rows, ids, columns, &mut column_score, &mut column_index));
        }
        for &id in blocks.remainder() {
            let rows = [row(values, id, columns.dim)];
            of_rows.extend(block_kernel(rows, [id], columns, &mut column_score, &mut column_index));
        }
    });
    let of_columns = (0..columns.len)
        .map(|c| {
            if column_index[c] == u32::MAX {
                Best::NOBODY
            } else {
                Best { score: column_score[c], index: column_index[c] }
            }
        })
        .collect();
    Nearest { of_rows, of_columns }
}

#[inline(always)]
fn row(values: &[f32], id: u32, dim: usize) -> &[f32] {
    &values[id as usize * dim..(id as usize + 1) * dim]
}

/// `Q` rows against all columns.
#[inline(always)]
fn block_kernel<const Q: usize>(
    rows: [&[f32]; Q],
    ids: [u32; Q],
    columns: &Columns,
    column_score: &mut [f32],
    column_index: &mut [u32],
) -> [Best; Q] {
    let dim = columns.dim;
    let row_half: [f32; Q] = std::array::from_fn(|q| half_norm(rows[q]));
    let mut best_score = [[f32::NEG_INFINITY; LANES]; Q];
    let mut best_group = [[u32::MAX; LANES]; Q];
    let groups = columns.packed.chunks_exact(dim * LANES);
    let scores = column_score.chunks_exact_mut(LANES);
    let indices = column_index.chunks_exact_mut(LANES);
    let halves = columns.half_norms.chunks_exact(LANES);
    for (g, (((group, score), index), half)) in groups.zip(scores).zip(indices).zip(halves).enumerate() {
        let mut dot = [[0.0f32; LANES]; Q];
        for (d, column) in group.chunks_exact(LANES).enumerate() {
            for q in 0..Q {
                let x = rows[q][d];
                for l in 0..LANES {
                    dot[q][l] = x.mul_add(column[l], dot[q][l]);
                }
            }
        }
        for q in 0..Q {
            for l in 0..LANES {
                let of_row = dot[q][l] - half[l];
                let nearer = of_row > best_score[q][l];
                best_score[q][l] = if nearer { of_row } else { best_score[q][l] };
                best_group[q][l] = if nearer { g as u32 } else { best_group[q][l] };
                let of_column = dot[q][l] - row_half[q];
                let nearer = of_column > score[l];
                score[l] = if nearer { of_column } else { score[l] };
                index[l] = if nearer { ids[q] } else { index[l] };
            }
        }
    }
    std::array::from_fn(|q| {
        (0..LANES).fold(Best::NOBODY, |best, l| {
            if best_group[q][l] == u32::MAX {
                best
            } else {
                best.or(Best { score: best_score[q][l], index: best_group[q][l] * LANES as u32 + l as u32 })
            }
        })
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
