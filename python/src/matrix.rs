//! Rigid motions, matrices and lists of points as arrays.

use nalgebra::Matrix4;
use numpy::ndarray::{Array2, ArrayView2};
use numpy::{PyArray2, PyReadonlyArray2, ToPyArray};
use pyo3::prelude::*;
use scanweave::geometry::RigidMotion;
use scanweave::geometry::motion_from_matrix;
use scanweave::{Error, Result};

/// A matrix that is so far from a rotation is none.
const ORTHONORMAL: f64 = 1e-2;

/// A 4×4 array of a motion.
pub fn array(py: Python<'_>, motion: &RigidMotion) -> Py<PyArray2<f64>> {
    let m = motion.to_homogeneous();
    Array2::from_shape_fn((4, 4), |(r, c)| m[(r, c)]).to_pyarray(py).unbind()
}

/// The rigid motion of a 4×4 array; `subject` says in errors whose it is.
pub fn motion(subject: &str, array: &PyReadonlyArray2<'_, f64>) -> Result<RigidMotion> {
    of_view(subject, &array.as_array())
}

fn of_view(subject: &str, values: &ArrayView2<'_, f64>) -> Result<RigidMotion> {
    let expected = "a 4x4 matrix of a rotation and a translation, with 0 0 0 1 as last row";
    let remedy = "pass target_from_source as [[R, t], [0, 1]]";
    if values.dim() != (4, 4) {
        let (rows, columns) = values.dim();
        return Err(Error::input(
            subject,
            format!("an array of shape ({rows}, {columns})"),
            expected,
            remedy,
        ));
    }
    let matrix = Matrix4::from_fn(|r, c| values[[r, c]]);
    match motion_from_matrix(&matrix, ORTHONORMAL) {
        Some((motion, _)) => Ok(motion),
        None => Err(Error::input(subject, "a matrix that is no rigid motion", expected, remedy)),
    }
}

/// An `[n,D]` array of values that come row by row.
pub fn rows<T: numpy::Element + Copy>(
    py: Python<'_>,
    n: usize,
    columns: usize,
    value: impl Fn(usize, usize) -> T,
) -> Py<PyArray2<T>> {
    Array2::from_shape_fn((n, columns), |(i, c)| value(i, c)).to_pyarray(py).unbind()
}
