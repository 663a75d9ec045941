//! Sparse symmetric positive definite systems made of small dense blocks.
//!
//! Every joint problem over scans has one block of unknowns a scan (three for a rotation,
//! six for a pose) and a non-zero block where two scans share an observation. Blocks are
//! nalgebra matrices; ordering and symbolic factorisation work on the graph of scans,
//! which is small.

use nalgebra::SMatrix;
use std::collections::BTreeMap;

/// Symmetric matrix of n×n blocks `[B,B]`, of which the lower ones are stored.
#[derive(Debug, Clone, PartialEq)]
pub struct BlockMatrix<const B: usize> {
    n: usize,
    /// Blocks at `(row, column)`, row ≥ column.
    blocks: BTreeMap<(usize, usize), SMatrix<f64, B, B>>,
}

impl<const B: usize> BlockMatrix<B> {
    /// The zero matrix of `n` block rows.
    pub fn zeros(n: usize) -> Self {
        Self { n, blocks: BTreeMap::new() }
    }

    /// Number of block rows n.
    pub fn len(&self) -> usize {
        self.n
    }

    /// True when there is no row.
    pub fn is_empty(&self) -> bool {
        self.n == 0
    }

    /// Adds `block` at block row `i`, block column `j` (both below n), and its transpose
    /// at `(j, i)`. A block on the diagonal must be symmetric and is added once.
    pub fn add(&mut self, i: usize, j: usize, block: &SMatrix<f64, B, B>) {
        debug_assert!(i < self.n && j < self.n, "block ({i}, {j}) of {} rows", self.n);
        if i >= j {
            *self.blocks.entry((i, j)).or_insert_with(SMatrix::zeros) += block;
        } else {
            *self.blocks.entry((j, i)).or_insert_with(SMatrix::zeros) += block.transpose();
        }
    }

    /// Adds `value` to every entry of the diagonal.
    pub fn add_to_diagonal(&mut self, value: f64) {
        let block = SMatrix::identity() * value;
        (0..self.n).for_each(|i| self.add(i, i, &block));
    }

    /// The diagonal block of row `i`.
    pub fn diagonal(&self, i: usize) -> SMatrix<f64, B, B> {
        self.blocks.get(&(i, i)).copied().unwrap_or_else(SMatrix::zeros)
    }

    /// The product with `x`, one block `[B,K]` a row.
    pub fn multiply<const K: usize>(&self, x: &[SMatrix<f64, B, K>]) -> Vec<SMatrix<f64, B, K>> {
        let mut product = vec![SMatrix::zeros(); self.n];
        for (&(i, j), block) in &self.blocks {
            product[i] += block * x[j];
            if i != j {
                product[j] += block.transpose() * x[i];
            }
        }
        product
    }

    /// The Cholesky factor, or `None` when the matrix is not positive definite.
    pub fn cholesky(&self) -> Option<BlockCholesky<B>> {
        BlockCholesky::new(self)
    }

    /// The solution of `A x = rhs`, or `None` when the matrix is not positive definite.
    pub fn solve<const K: usize>(&self, rhs: &[SMatrix<f64, B, K>]) -> Option<Vec<SMatrix<f64, B, K>>> {
        Some(self.cholesky()?.solve(rhs))
    }
}

/// A column of the factor L, in the order of elimination.
#[derive(Debug, Clone)]
struct Column<const B: usize> {
    /// Lower triangular block on the diagonal.
    diagonal: SMatrix<f64, B, B>,
    /// Blocks below it: places in the order of elimination, ascending.
    below: Vec<(usize, SMatrix<f64, B, B>)>,
}

/// `A = P L Lᵀ Pᵀ` with block lower triangular L.
#[derive(Debug, Clone)]
pub struct BlockCholesky<const B: usize> {
    /// `order[p]` is the row of A that is eliminated at place p.
    order: Vec<usize>,
    columns: Vec<Column<B>>,
}

impl<const B: usize> BlockCholesky<B> {
    /// Factorises `a`; `None` when it is not positive definite.
    pub fn new(a: &BlockMatrix<B>) -> Option<Self> {
        let Elimination { order, below } = Elimination::new(a.n, a.blocks.keys().copied());
        let mut columns = scatter(a, &order, &below);
        for k in 0..columns.len() {
            let (done, rest) = columns.split_at_mut(k + 1);
            let column = &mut done[k];
            column.diagonal = column.diagonal.cholesky()?.unpack();
            for (_, block) in &mut column.below {
                *block = column.diagonal.solve_lower_triangular(&block.transpose())?.transpose();
            }
            for (at, &(j, of_j)) in column.below.iter().enumerate() {
                let target = &mut rest[j - k - 1];
                subtract_product(&mut target.diagonal, &of_j, &of_j);
                // Both lists are ascending, and every row here is also in the target column.
                let mut place = 0;
                for (i, of_i) in &column.below[at + 1..] {
                    while target.below[place].0 != *i {
                        place += 1;
                    }
                    subtract_product(&mut target.below[place].1, of_i, &of_j);
                }
            }
        }
        Some(Self { order, columns })
    }

    /// The solution of `A x = rhs`, one block `[B,K]` a row.
    pub fn solve<const K: usize>(&self, rhs: &[SMatrix<f64, B, K>]) -> Vec<SMatrix<f64, B, K>> {
        let mut x: Vec<SMatrix<f64, B, K>> = self.order.iter().map(|&row| rhs[row]).collect();
        for (k, column) in self.columns.iter().enumerate() {
            column.diagonal.solve_lower_triangular_mut(&mut x[k]);
            let here = x[k];
            for (i, block) in &column.below {
                x[*i] -= block * here;
            }
        }
        for (k, column) in self.columns.iter().enumerate().rev() {
            for (i, block) in &column.below {
                let there = x[*i];
                x[k] -= block.transpose() * there;
            }
            column.diagonal.tr_solve_lower_triangular_mut(&mut x[k]);
        }
        let mut solution = vec![SMatrix::zeros(); x.len()];
        for (&row, value) in self.order.iter().zip(x) {
            solution[row] = value;
        }
        solution
    }

    /// Blocks of the factor, those on the diagonal included.
    pub fn filled(&self) -> usize {
        self.columns.iter().map(|c| 1 + c.below.len()).sum()
    }
}

/// The blocks of `a` in the columns of its factor.
fn scatter<const B: usize>(a: &BlockMatrix<B>, order: &[usize], below: &[Vec<usize>]) -> Vec<Column<B>> {
    let mut place = vec![0; order.len()];
    for (p, &row) in order.iter().enumerate() {
        place[row] = p;
    }
    let mut columns: Vec<Column<B>> = below
        .iter()
        .map(|rows| Column {
            diagonal: SMatrix::zeros(),
            below: rows.iter().map(|&i| (i, SMatrix::zeros())).collect(),
        })
        .collect();
    for (&(i, j), block) in &a.blocks {
        let (p, q) = (place[i], place[j]);
        if p == q {
            columns[p].diagonal = *block;
            continue;
        }
        let (low, high, block) = if p > q { (p, q, *block) } else { (q, p, block.transpose()) };
        let column = &mut columns[high].below;
        if let Ok(at) = column.binary_search_by_key(&low, |b| b.0) {
            column[at].1 = block;
        }
    }
    columns
}

/// `target −= a·bᵀ`, written out so that the compiler unrolls it for every block size.
#[inline]
fn subtract_product<const B: usize>(
    target: &mut SMatrix<f64, B, B>,
    a: &SMatrix<f64, B, B>,
    b: &SMatrix<f64, B, B>,
) {
    let (target, a, b) = (&mut target.data.0, &a.data.0, &b.data.0);
    for c in 0..B {
        for k in 0..B {
            let factor = b[k][c];
            for r in 0..B {
                target[c][r] -= a[k][r] * factor;
            }
        }
    }
}

/// An order of elimination by least degree, and what it fills.
struct Elimination {
    /// Row eliminated at each place.
    order: Vec<usize>,
    /// Places below the diagonal that are filled in each column, ascending.
    below: Vec<Vec<usize>>,
}

impl Elimination {
    /// Eliminates the row with fewest neighbours left, ties by index; its neighbours then
    /// become neighbours of each other (Tinney & Walker 1967).
    fn new(n: usize, blocks: impl Iterator<Item = (usize, usize)>) -> Self {
        let words = n.div_ceil(64);
        let mut neighbours = vec![vec![0u64; words]; n];
        for (i, j) in blocks.filter(|(i, j)| i != j) {
            neighbours[i][j / 64] |= 1 << (j % 64);
            neighbours[j][i / 64] |= 1 << (i % 64);
        }
        let mut degree: Vec<u32> =
            neighbours.iter().map(|row| row.iter().map(|w| w.count_ones()).sum()).collect();
        let mut left: Vec<usize> = (0..n).collect();
        let mut order = Vec::with_capacity(n);
        let mut rows_below: Vec<Vec<usize>> = Vec::with_capacity(n);
        while let Some(at) = (0..left.len()).min_by_key(|&at| (degree[left[at]], left[at])) {
            let row = left.swap_remove(at);
            let gone = std::mem::take(&mut neighbours[row]);
            let touched = members(&gone);
            for &other in &touched {
                let set = &mut neighbours[other];
                set.iter_mut().zip(&gone).for_each(|(word, new)| *word |= new);
                set[row / 64] &= !(1 << (row % 64));
                set[other / 64] &= !(1 << (other % 64));
                degree[other] = set.iter().map(|w| w.count_ones()).sum();
            }
            order.push(row);
            rows_below.push(touched);
        }
        let mut place = vec![0; n];
        for (p, &row) in order.iter().enumerate() {
            place[row] = p;
        }
        let below = rows_below
            .into_iter()
            .map(|rows| {
                let mut places: Vec<usize> = rows.into_iter().map(|row| place[row]).collect();
                places.sort_unstable();
                places
            })
            .collect();
        Self { order, below }
    }
}

/// Indices of the bits that are set, ascending.
fn members(set: &[u64]) -> Vec<usize> {
    let mut found = Vec::new();
    for (w, &word) in set.iter().enumerate() {
        let mut word = word;
        while word != 0 {
            found.push(w * 64 + word.trailing_zeros() as usize);
            word &= word - 1;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn dense<const B: usize>(a: &BlockMatrix<B>) -> DMatrix<f64> {
        let mut full = DMatrix::zeros(a.len() * B, a.len() * B);
        for (&(i, j), block) in &a.blocks {
            full.view_mut((i * B, j * B), (B, B)).copy_from(block);
            full.view_mut((j * B, i * B), (B, B)).copy_from(&block.transpose());
        }
        full
    }

    /// JᵀJ of random observations between `links`, slightly damped: positive definite.
    fn system<const B: usize>(n: usize, links: &[(usize, usize)], seed: u64) -> BlockMatrix<B> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut block = || SMatrix::<f64, B, B>::from_fn(|_, _| rng.random_range(-1.0..1.0));
        let mut a = BlockMatrix::zeros(n);
        a.add_to_diagonal(0.1);
        for &(i, j) in links {
            let (of_i, of_j) = (block(), block());
            a.add(i, i, &(of_i.transpose() * of_i));
            a.add(j, j, &(of_j.transpose() * of_j));
            a.add(i, j, &(of_i.transpose() * of_j));
        }
        a
    }

    fn random_links(n: usize, count: usize, seed: u64) -> Vec<(usize, usize)> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let pairs = (0..count).map(|_| (rng.random_range(0..n), rng.random_range(0..n)));
        pairs.filter(|(i, j)| i != j).collect()
    }

    fn assert_solves<const B: usize>(n: usize, links: &[(usize, usize)], seed: u64) {
        let a = system::<B>(n, links, seed);
        let mut rng = ChaCha8Rng::seed_from_u64(seed + 1);
        let rhs: Vec<SMatrix<f64, B, 2>> =
            (0..n).map(|_| SMatrix::from_fn(|_, _| rng.random_range(-1.0..1.0))).collect();
        let x = a.solve(&rhs).unwrap();
        let lu = dense(&a).lu();
        for column in 0..2 {
            let flat = |blocks: &[SMatrix<f64, B, 2>]| {
                DVector::from_fn(n * B, |row, _| blocks[row / B][(row % B, column)])
            };
            let expected = lu.solve(&flat(&rhs)).unwrap();
            assert_relative_eq!(flat(&x), expected, epsilon = 1e-9, max_relative = 1e-9);
            assert_relative_eq!(flat(&a.multiply(&x)), flat(&rhs), epsilon = 1e-9);
        }
    }

    #[test]
    fn solutions_agree_with_a_dense_lu() {
        // Independent of the factor: nalgebra's pivoted LU of the full matrix.
        for seed in 0..5 {
            assert_solves::<3>(40, &random_links(40, 90, seed), seed);
            assert_solves::<6>(25, &random_links(25, 60, seed), seed);
        }
        assert_solves::<1>(70, &random_links(70, 200, 9), 9);
        assert_solves::<6>(1, &[], 0);
    }

    #[test]
    fn a_chain_fills_nothing_and_a_star_is_eliminated_from_its_ends() {
        let chain: Vec<_> = (1..200).map(|i| (i - 1, i)).collect();
        assert_eq!(system::<6>(200, &chain, 1).cholesky().unwrap().filled(), 200 + 199);
        // Eliminating the centre first would fill all 200² / 2 blocks.
        let star: Vec<_> = (1..200).map(|i| (0, i)).collect();
        assert_eq!(system::<3>(200, &star, 1).cholesky().unwrap().filled(), 200 + 199);
        // Every elimination shortens the ring by one and joins two neighbours, down to a triangle.
        let ring: Vec<_> = (0..200).map(|i| (i, (i + 1) % 200)).collect();
        assert_eq!(system::<3>(200, &ring, 1).cholesky().unwrap().filled(), 200 + 200 + 197);
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        let mut a = system::<3>(10, &random_links(10, 20, 3), 3);
        a.add_to_diagonal(-50.0);
        assert!(a.cholesky().is_none());
        assert!(BlockMatrix::<3>::zeros(2).cholesky().is_none());
    }
}
