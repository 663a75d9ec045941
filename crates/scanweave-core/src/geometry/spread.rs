//! The principal directions of points.

use super::Direction;
use nalgebra::{Matrix3, Vector3};

/// Moments of points, given relative to a place among them.
#[derive(Debug, Default)]
pub struct Spread {
    count: usize,
    sum: Vector3<f64>,
    square: Matrix3<f64>,
}

impl Spread {
    /// Counts one more point.
    pub fn add(&mut self, offset: Vector3<f64>) {
        self.count += 1;
        self.sum += offset;
        // What is above the diagonal follows at the end.
        let [x, y, z] = *offset.as_ref();
        for (at, product) in [(0, x * x), (1, y * x), (2, z * x), (4, y * y), (5, z * y), (8, z * z)] {
            self.square[at] += product;
        }
    }

    /// Direction of least variance about the mean; none where points are fewer than three or
    /// on one line.
    pub fn least_direction(&self) -> Option<Direction> {
        // Relative spread below which the second direction is rounding noise of single precision.
        const LINE: f64 = 1e-8;
        if self.count < 3 {
            return None;
        }
        let n = self.count as f64;
        let mut square = self.square;
        square.fill_upper_triangle_with_lower_triangle();
        let eigen = (square / n - self.sum * self.sum.transpose() / (n * n)).symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_unstable_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let [least, middle, most] = order;
        if eigen.eigenvalues[middle] <= LINE * eigen.eigenvalues[most] {
            return None;
        }
        Some(eigen.eigenvectors.column(least).normalize().cast::<f32>())
    }
}
