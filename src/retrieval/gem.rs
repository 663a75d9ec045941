//! Generalised-mean and mean pooling of local descriptors.

use super::netvlad::{unit_rows, values};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};

/// Shape and initialisation of a [`Gem`] layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GemConfig {
    /// Starting exponent p; 1 is the mean, large values approach the maximum.
    pub power: f32,
    /// Added to every value before the power and taken off after the root, so that descriptors
    /// with negative values keep them (1 covers all unit-length descriptors).
    pub shift: f32,
    /// Floor ε of the shifted values.
    pub floor: f32,
}

impl Default for GemConfig {
    fn default() -> Self {
        Self { power: 3.0, shift: 0.0, floor: 1e-6 }
    }
}

impl GemConfig {
    /// Puts the layer on a device.
    pub fn init(&self, device: &Device) -> Gem {
        Gem {
            power: Param::from_data(TensorData::new(vec![self.power], [1]), device),
            shift: self.shift,
            floor: self.floor,
        }
    }
}

/// Generalised-mean pooling with a learnable exponent.
///
/// Radenović, Tolias, Chum, "Fine-tuning CNN Image Retrieval with No Human Annotation", PAMI 2018,
/// <https://arxiv.org/abs/1711.02512>, equation 3, per channel d:
///
/// f_d = (1/N Σ_n max(x_nd + s, ε)^p)^{1/p} − s,  then scaled to unit length
///
/// with p the exponent, s the shift and ε the floor that keeps the power defined.
#[derive(Module, Debug)]
pub struct Gem {
    /// p, `[1]`.
    pub power: Param<Tensor<1>>,
    shift: f32,
    floor: f32,
}

impl Gem {
    /// Global feature of one scan.
    ///
    /// # Shapes
    /// - descriptors `[n,D]`, n ≥ 1
    /// - output `[D]`, unit length
    pub fn forward(&self, descriptors: Tensor<2>) -> Tensor<1> {
        let [_, dim] = descriptors.dims();
        let x = (unit_rows(descriptors) + self.shift).clamp_min(self.floor);
        let power = self.power.val().unsqueeze::<2>();
        // x^p = exp(p ln x): the derivative with respect to p needs the logarithm anyway.
        let mean = (x.log() * power.clone()).exp().mean_dim(0);
        let root = (mean.log() / power).exp() - self.shift;
        unit_rows(root).reshape([dim])
    }

    /// The layer as plain numbers.
    pub fn config(&self) -> GemConfig {
        let power = values(self.power.val()).first().copied().unwrap_or(1.0);
        GemConfig { power, shift: self.shift, floor: self.floor }
    }
}

/// Mean of the unit-length descriptors, scaled to unit length.
///
/// # Shapes
/// - descriptors `[n,D]`, n ≥ 1
/// - output `[D]`
pub fn mean_pooling(descriptors: Tensor<2>) -> Tensor<1> {
    let [_, dim] = descriptors.dims();
    unit_rows(unit_rows(descriptors).mean_dim(0)).reshape([dim])
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: [f32; 6] = [0.6, 0.8, 0.0, 1.0, -0.8, 0.6];

    fn rows(device: &Device) -> Tensor<2> {
        Tensor::from_data(TensorData::new(ROWS.to_vec(), [3, 2]), device)
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
        let device = Device::flex();
        for (power, shift) in [(3.0, 0.0), (3.0, 1.0), (1.0, 1.0), (6.0, 1.0)] {
            let layer = GemConfig { power, shift, floor: 1e-6 }.init(&device);
            let got = values(layer.forward(rows(&device)));
            for (g, e) in got.iter().zip(by_hand(f64::from(power), f64::from(shift))) {
                assert!((f64::from(*g) - e).abs() < 1e-5, "p {power} s {shift}: {g} against {e}");
            }
        }
    }

    #[test]
    fn mean_pooling_is_gem_of_power_one() {
        let device = Device::flex();
        let mean = values(mean_pooling(rows(&device)));
        for (g, e) in mean.iter().zip(by_hand(1.0, 1.0)) {
            assert!((f64::from(*g) - e).abs() < 1e-6);
        }
    }
}
