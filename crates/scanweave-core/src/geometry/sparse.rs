//! Sparse symmetric positive definite systems made of small dense blocks.
//!
//! Every joint problem over scans has one block of unknowns a scan (three for a rotation,
//! six for a pose) and a non-zero block where two scans share an observation. Blocks are
//! nalgebra matrices; factors and solutions are faer's, on one thread, so that the bytes
//! do not depend on how many there are.

use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMat, SymbolicSparseColMat};
use faer::{Mat, Side};
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

/// `A = P L Lᵀ Pᵀ` with lower triangular L and P chosen by approximate minimum degree.
#[derive(Debug, Clone)]
pub struct BlockCholesky<const B: usize> {
    factor: Llt<usize, f64>,
}

impl<const B: usize> BlockCholesky<B> {
    /// Factorises `a`; `None` when it is not positive definite.
    pub fn new(a: &BlockMatrix<B>) -> Option<Self> {
        let matrix = lower_columns(a);
        let symbolic = SymbolicLlt::try_new(matrix.symbolic(), Side::Lower).ok()?;
        let factor = Llt::try_new_with_symbolic(symbolic, matrix.as_ref(), Side::Lower).ok()?;
        Some(Self { factor })
    }

    /// The solution of `A x = rhs`, one block `[B,K]` a row.
    pub fn solve<const K: usize>(&self, rhs: &[SMatrix<f64, B, K>]) -> Vec<SMatrix<f64, B, K>> {
        let mut x = Mat::from_fn(rhs.len() * B, K, |row, column| rhs[row / B][(row % B, column)]);
        self.factor.solve_in_place(&mut x);
        (0..rhs.len()).map(|i| SMatrix::from_fn(|row, column| x[(i * B + row, column)])).collect()
    }
}

/// The lower triangle of `a` by columns of scalars, with every entry of the diagonal in it.
fn lower_columns<const B: usize>(a: &BlockMatrix<B>) -> SparseColMat<usize, f64> {
    let mut below: Vec<Vec<(usize, &SMatrix<f64, B, B>)>> = vec![Vec::new(); a.n];
    for (&(i, j), block) in a.blocks.iter().filter(|((i, j), _)| i > j) {
        below[j].push((i, block));
    }
    let (mut starts, mut rows, mut values) = (vec![0], Vec::new(), Vec::new());
    for (j, below) in below.iter().enumerate() {
        let diagonal = a.diagonal(j);
        for column in 0..B {
            for row in column..B {
                rows.push(j * B + row);
                values.push(diagonal[(row, column)]);
            }
            // Ascending, because the map of blocks is.
            for (i, block) in below {
                for row in 0..B {
                    rows.push(i * B + row);
                    values.push(block[(row, column)]);
                }
            }
            starts.push(rows.len());
        }
    }
    let pattern = SymbolicSparseColMat::new_checked(a.n * B, a.n * B, starts, None, rows);
    SparseColMat::new(pattern, values)
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
    fn long_chains_and_wide_stars_are_solved_without_filling() {
        // A factor filled by eliminating a star's centre first would have 18 million entries.
        let chain: Vec<_> = (1..3000).map(|i| (i - 1, i)).collect();
        let star: Vec<_> = (1..3000).map(|i| (0, i)).collect();
        for links in [chain, star] {
            let a = system::<2>(3000, &links, 1);
            let rhs = vec![SMatrix::<f64, 2, 1>::repeat(1.0); 3000];
            let started = std::time::Instant::now();
            let x = a.solve(&rhs).unwrap();
            assert!(started.elapsed().as_secs_f64() < 1.0);
            for (product, expected) in a.multiply(&x).iter().zip(&rhs) {
                assert_relative_eq!(product, expected, epsilon = 1e-9);
            }
        }
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        let mut a = system::<3>(10, &random_links(10, 20, 3), 3);
        a.add_to_diagonal(-50.0);
        assert!(a.cholesky().is_none());
        assert!(BlockMatrix::<3>::zeros(2).cholesky().is_none());
    }
}
