//! Generalised-mean and mean pooling of local descriptors.

use super::pooling::{add_scaled, unit_row};
use crate::scan::Descriptors;

/// Generalised-mean pooling.
///
/// Radenović, Tolias, Chum, "Fine-tuning CNN Image Retrieval with No Human Annotation", PAMI 2018,
/// <https://arxiv.org/abs/1711.02512>, equation 3, per channel d:
///
/// f_d = (1/N Σ_n max(x_nd + s, ε)^p)^{1/p} − s,  then scaled to unit length
///
/// with p the exponent (learnable), s the shift and ε the floor that keeps the power defined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gem {
    /// Exponent p; 1 is the mean, large values approach the maximum.
    pub power: f32,
    /// Added to every value before the power and taken off after the root, so that descriptors
    /// with negative values keep them (1 covers all unit-length descriptors).
    pub shift: f32,
    /// Floor ε of the shifted values.
    pub floor: f32,
}

impl Default for Gem {
    fn default() -> Self {
        Self { power: 3.0, shift: 0.0, floor: 1e-6 }
    }
}

impl Gem {
    /// Global feature of one scan.
    ///
    /// # Shapes
    /// - descriptors `[n,D]`, n ≥ 1
    /// - output `[D]`, unit length
    pub fn global_feature(&self, descriptors: &Descriptors) -> Vec<f32> {
        let raised = |v: f32| (v + self.shift).max(self.floor).powf(self.power);
        let mut feature = mean_of_unit_rows(descriptors, raised);
        feature.iter_mut().for_each(|v| *v = v.powf(1.0 / self.power) - self.shift);
        unit_row(&mut feature);
        feature
    }
}

/// Mean of the unit-length descriptors, scaled to unit length.
///
/// # Shapes
/// - descriptors `[n,D]`, n ≥ 1
/// - output `[D]`
pub fn mean_pooling(descriptors: &Descriptors) -> Vec<f32> {
    let mut feature = mean_of_unit_rows(descriptors, |v| v);
    unit_row(&mut feature);
    feature
}

/// Mean over the rows, scaled to unit length, of `f` of every value.
fn mean_of_unit_rows(descriptors: &Descriptors, f: impl Fn(f32) -> f32) -> Vec<f32> {
    let share = 1.0 / descriptors.len().max(1) as f32;
    let (mut mean, mut x) = (vec![0.0; descriptors.dim()], vec![0.0; descriptors.dim()]);
    for row in 0..descriptors.len() {
        x.copy_from_slice(descriptors.row(row));
        unit_row(&mut x);
        x.iter_mut().for_each(|v| *v = f(*v));
        add_scaled(&mut mean, &x, share);
    }
    mean
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: [f32; 6] = [0.6, 0.8, 0.0, 1.0, -0.8, 0.6];

    fn rows() -> Descriptors {
        Descriptors::new(2, ROWS.to_vec()).unwrap()
    }

    fn by_hand(p: f64, shift: f64) -> Vec<f64> {
        let channel = |c: usize| {
            let sum: f64 = (0..3).map(|n| (f64::from(ROWS[n * 2 + c]) + shift).max(1e-6).powf(p)).sum();
            (sum / 3.0).powf(1.0 / p) - shift
        };
        let (a, b) = (channel(0), channel(1));
        vec![a / a.hypot(b), b / a.hypot(b)]
    }

    #[test]
    fn gem_follows_the_equation() {
        for (power, shift) in [(3.0, 0.0), (3.0, 1.0), (1.0, 1.0), (6.0, 1.0)] {
            let got = Gem { power, shift, floor: 1e-6 }.global_feature(&rows());
            for (g, e) in got.iter().zip(by_hand(f64::from(power), f64::from(shift))) {
                assert!((f64::from(*g) - e).abs() < 1e-5, "p {power} s {shift}: {g} against {e}");
            }
        }
    }

    #[test]
    fn mean_pooling_is_gem_of_power_one() {
        for (g, e) in mean_pooling(&rows()).iter().zip(by_hand(1.0, 1.0)) {
            assert!((f64::from(*g) - e).abs() < 1e-6);
        }
    }
}
