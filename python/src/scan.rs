//! Scans.

use crate::errors::{OrRaise, exception};
use crate::matrix;
use nalgebra::{Point3, Vector3};
use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use scanweave::geometry::Point;
use scanweave::{Error, Result, Scan};
use std::sync::{Arc, Mutex, PoisonError};

/// Coordinates in either precision, of any strides.
#[derive(FromPyObject)]
pub enum Coordinates<'py> {
    Single(PyReadonlyArray2<'py, f32>),
    Double(PyReadonlyArray2<'py, f64>),
}

/// One scan. A scan that was made for one call is taken by it, so that its points are not copied again.
#[pyclass(frozen, name = "Scan", module = "scanweave._scanweave")]
pub struct PyScan {
    scan: Mutex<Option<Arc<Scan>>>,
}

impl PyScan {
    pub fn of(scan: Scan) -> Self {
        Self { scan: Mutex::new(Some(Arc::new(scan))) }
    }

    fn get(&self) -> Result<Arc<Scan>> {
        let held = self.scan.lock().unwrap_or_else(PoisonError::into_inner).clone();
        held.ok_or_else(|| {
            Error::input("scan", "one that a call has taken", "one that is there", "make it anew")
        })
    }

    /// The scan, taken away or cloned.
    pub fn give(&self, take: bool) -> Result<Scan> {
        let scan = match take {
            true => self.scan.lock().unwrap_or_else(PoisonError::into_inner).take(),
            false => None,
        };
        let scan = scan.map_or_else(|| self.get(), Ok)?;
        Ok(Arc::try_unwrap(scan).unwrap_or_else(|shared| (*shared).clone()))
    }
}

#[pymethods]
impl PyScan {
    /// Shapes were checked by `scanweave/_inputs.py`.
    #[new]
    #[pyo3(signature = (name, points, colors=None, normals=None, viewpoint=None, initial_pose=None))]
    fn new(
        py: Python<'_>,
        name: &str,
        points: Coordinates<'_>,
        colors: Option<PyReadonlyArray2<'_, u8>>,
        normals: Option<PyReadonlyArray2<'_, f32>>,
        viewpoint: Option<[f64; 3]>,
        initial_pose: Option<PyReadonlyArray2<'_, f64>>,
    ) -> PyResult<Self> {
        let rows = match &points {
            Coordinates::Single(array) => array.as_array().nrows(),
            Coordinates::Double(array) => array.as_array().nrows(),
        };
        let columns = match &points {
            Coordinates::Single(array) => array.as_array().ncols(),
            Coordinates::Double(array) => array.as_array().ncols(),
        };
        let others =
            [colors.as_ref().map(|a| a.as_array().dim()), normals.as_ref().map(|a| a.as_array().dim())];
        if columns != 3 || others.iter().flatten().any(|dim| *dim != (rows, 3)) {
            let found = format!("{rows} rows of {columns} coordinates, colours or normals of another shape");
            let error = Error::input(format!("scan {name}"), found, "arrays of shape (n, 3)", "reshape them");
            return Err(exception(py, &error));
        }
        let colors = colors.as_ref().map(|array| array.as_array());
        let normals = normals.as_ref().map(|array| array.as_array());
        let rgb = colors.as_ref().map(|a| move |i: usize| [a[[i, 0]], a[[i, 1]], a[[i, 2]]]);
        let rgb = rgb.as_ref().map(|rgb| rgb as &dyn Fn(usize) -> [u8; 3]);
        let normal = normals.as_ref().map(|a| move |i: usize| [a[[i, 0]], a[[i, 1]], a[[i, 2]]]);
        let normal = normal.as_ref().map(|normal| normal as &dyn Fn(usize) -> [f32; 3]);
        let mut scan = match &points {
            Coordinates::Single(array) => {
                let a = array.as_array();
                Scan::from_rows(name, rows, |i| [a[[i, 0]], a[[i, 1]], a[[i, 2]]].map(f64::from), rgb, normal)
            }
            Coordinates::Double(array) => {
                let a = array.as_array();
                Scan::from_rows(name, rows, |i| [a[[i, 0]], a[[i, 1]], a[[i, 2]]], rgb, normal)
            }
        };
        if let Some(viewpoint) = viewpoint {
            scan = scan.with_viewpoint(viewpoint);
        }
        scan.initial_pose = match &initial_pose {
            Some(pose) => Some(matrix::motion(&format!("initial_pose of {name}"), pose).or_raise(py)?),
            None => None,
        };
        Ok(Self::of(scan))
    }

    #[getter]
    fn name(&self, py: Python<'_>) -> PyResult<String> {
        Ok(self.get().or_raise(py)?.name.clone())
    }

    /// The same scan under another name.
    fn renamed(&self, py: Python<'_>, name: String) -> PyResult<Self> {
        Ok(Self::of(Scan { name, ..self.give(false).or_raise(py)? }))
    }

    #[getter]
    fn file(&self, py: Python<'_>) -> PyResult<Option<String>> {
        Ok(self.get().or_raise(py)?.path.as_ref().map(|path| path.display().to_string()))
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        Ok(self.get().or_raise(py)?.cloud.len())
    }

    #[getter]
    fn points(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        let scan = self.get().or_raise(py)?;
        Ok(points(py, &scan.cloud.points, &scan.cloud.origin_m))
    }

    #[getter]
    fn colors(&self, py: Python<'_>) -> PyResult<Option<Py<PyArray2<u8>>>> {
        let scan = self.get().or_raise(py)?;
        Ok(scan.cloud.colors.as_ref().map(|colors| matrix::rows(py, colors.len(), 3, |i, c| colors[i][c])))
    }

    #[getter]
    fn normals(&self, py: Python<'_>) -> PyResult<Option<Py<PyArray2<f32>>>> {
        let scan = self.get().or_raise(py)?;
        Ok(scan
            .cloud
            .normals
            .as_ref()
            .map(|normals| matrix::rows(py, normals.len(), 3, |i, c| normals[i][c])))
    }

    #[getter]
    fn viewpoint(&self, py: Python<'_>) -> PyResult<Option<Py<PyArray1<f64>>>> {
        let scan = self.get().or_raise(py)?;
        let place = |v: Point| (Point3::from(v.coords.cast::<f64>()) + scan.cloud.origin_m).coords;
        Ok(scan.cloud.viewpoint.map(|v| PyArray1::from_slice(py, place(v).as_slice()).unbind()))
    }

    #[getter]
    fn initial_pose(&self, py: Python<'_>) -> PyResult<Option<Py<PyArray2<f64>>>> {
        Ok(self.get().or_raise(py)?.initial_pose.map(|pose| matrix::array(py, &pose)))
    }

    /// Rows that were left out because they are not finite, and stray points that were.
    #[getter]
    fn left_out(&self, py: Python<'_>) -> PyResult<(usize, usize)> {
        let scan = self.get().or_raise(py)?;
        Ok((scan.cloud.dropped_rows, scan.cloud.stray_points))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let scan = self.get().or_raise(py)?;
        Ok(format!("Scan({:?}, {} points)", scan.name, scan.cloud.len()))
    }
}

/// `[n,3]` in the coordinates that the origin is in.
pub fn points(py: Python<'_>, points: &[Point], origin_m: &Vector3<f64>) -> Py<PyArray2<f64>> {
    matrix::rows(py, points.len(), 3, |i, c| f64::from(points[i][c]) + origin_m[c])
}
