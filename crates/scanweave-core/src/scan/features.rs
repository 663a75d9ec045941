//! Local features of a scan.

use crate::error::{Error, Result};
use crate::geometry::{Direction, Point};
use std::sync::Arc;

/// Row-major descriptors, one row a keypoint. Clones share the values.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Descriptors {
    dim: usize,
    values: Arc<Vec<f32>>,
}

impl Descriptors {
    /// Wraps `values` `[n·dim]`.
    ///
    /// # Errors
    /// When `dim` is zero, does not divide the length, or a value is not finite.
    pub fn new(dim: usize, values: Vec<f32>) -> Result<Self> {
        if dim == 0 || !values.len().is_multiple_of(dim) {
            return Err(Error::input(
                "descriptors",
                format!("{} values", values.len()),
                format!("a multiple of the dimension {dim}, which must be positive"),
                "check the shape of the descriptor array",
            ));
        }
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            return Err(Error::input(
                "descriptors",
                format!("{} in row {}", values[at], at / dim),
                "finite numbers",
                "compute the features again or drop that keypoint",
            ));
        }
        Ok(Self { dim, values: Arc::new(values) })
    }

    /// Scales every row to unit length; a zero row stays zero.
    pub fn normalized(mut self) -> Self {
        for row in Arc::make_mut(&mut self.values).chunks_exact_mut(self.dim) {
            let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt();
            if norm > 0.0 {
                row.iter_mut().for_each(|v| *v /= norm);
            }
        }
        self
    }

    /// Dimension D of a row.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// Number of rows n.
    pub fn len(&self) -> usize {
        self.values.len().checked_div(self.dim).unwrap_or(0)
    }

    /// True when there is no row.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Row `i`, `[D]`.
    pub fn row(&self, i: usize) -> &[f32] {
        &self.values[i * self.dim..(i + 1) * self.dim]
    }

    /// All values, row-major `[n·D]`.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// The chosen rows, in the given order.
    pub fn select(&self, rows: &[usize]) -> Self {
        let values = rows.iter().flat_map(|&i| self.row(i).iter().copied()).collect();
        Self { dim: self.dim, values: Arc::new(values) }
    }
}

/// Keypoints of one scan and what describes them.
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    /// `[n,3]`, metres, in the scan's frame.
    pub keypoints: Vec<Point>,
    /// `[n,3]` unit normals turned to the viewpoint, where they were computed.
    pub normals: Option<Vec<Direction>>,
    /// `[n,D]` unit-length descriptors.
    pub descriptors: Descriptors,
}

impl Features {
    /// Joins keypoints and descriptors.
    ///
    /// # Errors
    /// When the lengths disagree or a keypoint is not finite.
    pub fn new(
        keypoints: Vec<Point>,
        normals: Option<Vec<Direction>>,
        descriptors: Descriptors,
    ) -> Result<Self> {
        let n = keypoints.len();
        if descriptors.len() != n || normals.as_ref().is_some_and(|v| v.len() != n) {
            return Err(Error::input(
                "features",
                format!("{n} keypoints and {} descriptors", descriptors.len()),
                "one descriptor for every keypoint",
                "write both arrays from the same run",
            ));
        }
        if let Some(at) = keypoints.iter().position(|p| !p.coords.iter().all(|v| v.is_finite())) {
            return Err(Error::input(
                "features",
                format!("keypoint {at} at {:?}", keypoints[at].coords.as_slice()),
                "finite coordinates",
                "remove keypoints that are NaN or infinite",
            ));
        }
        Ok(Self { keypoints, normals, descriptors })
    }

    /// Number of keypoints.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// True when there is no keypoint.
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }

    /// The chosen keypoints, in the given order.
    pub fn select(&self, rows: &[usize]) -> Self {
        Self {
            keypoints: rows.iter().map(|&i| self.keypoints[i]).collect(),
            normals: self.normals.as_ref().map(|v| rows.iter().map(|&i| v[i]).collect()),
            descriptors: self.descriptors.select(rows),
        }
    }
}
