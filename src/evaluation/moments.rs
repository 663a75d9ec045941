//! How far a wrong pose moves a scan's points.

use crate::geometry::{Point, RigidMotion};
use nalgebra::{Matrix3, Vector3};

/// Centre and covariance of a scan's points: all it takes to tell how far a motion moves them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moments {
    /// Mean of the points, metres, scan frame.
    pub centre: Vector3<f64>,
    /// Mean of (p − centre)(p − centre)ᵀ.
    pub covariance: Matrix3<f64>,
}

impl Moments {
    /// Moments of points; zero when there is none.
    pub fn of(points: &[Point]) -> Self {
        let n = points.len().max(1) as f64;
        let centre = points.iter().map(|p| p.coords.cast::<f64>()).sum::<Vector3<f64>>() / n;
        let covariance = points.iter().fold(Matrix3::zeros(), |sum, p| {
            let d = p.coords.cast::<f64>() - centre;
            sum + d * d.transpose()
        }) / n;
        Self { centre, covariance }
    }

    /// Root mean square distance that `motion`, given in the scan's frame, moves the points:
    /// √(‖(R − I)c + t‖² + tr((R − I) C (R − I)ᵀ)), metres.
    pub fn displacement_m(&self, motion: &RigidMotion) -> f64 {
        let turn = motion.rotation.to_rotation_matrix().into_inner() - Matrix3::identity();
        let shift = turn * self.centre + motion.translation.vector;
        let spread = (turn * self.covariance * turn.transpose()).trace();
        (shift.norm_squared() + spread.max(0.0)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn displacement_is_what_moving_every_point_gives() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        let mut number = |low: f32, high: f32| rng.random_range(low..high);
        let points: Vec<Point> =
            (0..500).map(|_| Point::new(number(-1.0, 2.0), number(0.0, 1.0), number(1.0, 4.0))).collect();
        let moments = Moments::of(&points);
        for (t, r) in
            [([0.3, 0.0, -0.1], [0.0; 3]), ([0.0; 3], [0.2, -0.1, 0.4]), ([1.0, 2.0, 0.5], [3.0, 0.1, 0.0])]
        {
            let motion = RigidMotion::new(t.into(), r.into());
            let squares = points.iter().map(|p| {
                let p = p.cast::<f64>();
                (motion * p - p).norm_squared()
            });
            let expected = (squares.sum::<f64>() / 500.0).sqrt();
            assert!((moments.displacement_m(&motion) - expected).abs() < 1e-6, "{t:?} {r:?}");
        }
        assert_eq!(Moments::of(&[]).displacement_m(&RigidMotion::translation(0.0, 3.0, 4.0)), 5.0);
    }
}
