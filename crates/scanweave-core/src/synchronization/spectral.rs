//! Eigenspaces by inverse iteration.

use crate::geometry::rigid::nearest_rotation;
use crate::geometry::sparse::BlockMatrix;
use nalgebra::{Matrix3, Rotation3, SMatrix};

/// Added to the eigenvalues, which lie between 0 and 2, so that a singular matrix has a factor.
const SHIFT: f64 = 1e-9;
/// Rounds at most.
const ROUNDS: usize = 200;
/// Distance between successive subspaces at which the iteration is done.
const STOP: f64 = 1e-11;

/// The eigenvectors of the three smallest eigenvalues of `laplacian·v = λ·degree·v`, one block
/// `[3,3]` a node, started at `start`.
pub(super) fn smallest_three(
    laplacian: &BlockMatrix<3>,
    degree: &[f64],
    start: Vec<Matrix3<f64>>,
) -> Option<Vec<Matrix3<f64>>> {
    let mut shifted = laplacian.clone();
    for (node, d) in degree.iter().enumerate() {
        shifted.add(node, node, &(Matrix3::identity() * (SHIFT * d)));
    }
    let factor = shifted.cholesky()?;
    let mut space = orthonormal(start, degree)?;
    for _ in 0..ROUNDS {
        let weighted: Vec<_> = space.iter().zip(degree).map(|(x, d)| x * *d).collect();
        let next = orthonormal(factor.solve(&weighted), degree)?;
        let moved = distance(&space, &next, degree);
        space = next;
        if moved < STOP {
            break;
        }
    }
    Some(space)
}

/// The same subspace with Σ d XᵀX = 1.
pub(super) fn orthonormal<const K: usize>(
    mut space: Vec<SMatrix<f64, K, K>>,
    degree: &[f64],
) -> Option<Vec<SMatrix<f64, K, K>>>
where
    nalgebra::Const<K>: nalgebra::DimMin<nalgebra::Const<K>, Output = nalgebra::Const<K>>,
{
    // Once more: the first pass loses digits where the columns were nearly parallel.
    for _ in 0..2 {
        let largest = space.iter().map(|x| x.amax()).fold(0.0, f64::max);
        if !(largest > 0.0 && largest.is_finite()) {
            return None;
        }
        space.iter_mut().for_each(|x| *x /= largest);
        let gram = inner(&space, &space, degree);
        let lower = gram.cholesky()?.unpack();
        let turn = lower.solve_lower_triangular(&SMatrix::identity())?.transpose();
        space.iter_mut().for_each(|x| *x *= turn);
    }
    Some(space)
}

/// Σ d AᵀB.
pub(super) fn inner<const K: usize>(
    a: &[SMatrix<f64, K, K>],
    b: &[SMatrix<f64, K, K>],
    degree: &[f64],
) -> SMatrix<f64, K, K> {
    a.iter().zip(b).zip(degree).fold(SMatrix::zeros(), |sum, ((a, b), d)| sum + a.transpose() * b * *d)
}

/// How far orthonormal `b` is from lying in the span of orthonormal `a`.
pub(super) fn distance<const K: usize>(
    a: &[SMatrix<f64, K, K>],
    b: &[SMatrix<f64, K, K>],
    degree: &[f64],
) -> f64 {
    let shared = inner(a, b, degree);
    let squared: f64 =
        a.iter().zip(b).zip(degree).map(|((a, b), d)| (b - a * shared).norm_squared() * d).sum();
    squared.sqrt()
}

/// The rotations nearest to blocks that are rotations up to one common factor, which may be a
/// reflection.
pub(super) fn rotations_of(blocks: &[Matrix3<f64>]) -> Option<Vec<Rotation3<f64>>> {
    let handedness: f64 = blocks
        .iter()
        .map(|b| {
            let scale = b.norm();
            if scale > 0.0 { (b / scale).determinant() } else { 0.0 }
        })
        .sum();
    let mirror = Matrix3::from_diagonal(&nalgebra::Vector3::new(1.0, 1.0, handedness.signum()));
    blocks
        .iter()
        .map(|b| {
            let scale = b.norm();
            (scale > 0.0).then_some(())?;
            nearest_rotation(&(b * mirror / scale))
        })
        .collect()
}
