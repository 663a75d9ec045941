//! The Burn module against the inference of the core.

use super::batch::picked;
use super::module::{self, MAP, MiniSpinNet, Mode, parameters_of, statistics_of, weights_from};
use crate::descriptor::mini_spin_net::{Architecture, Network, Norm, Patch, RADII, Weights, Workspace};
use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn random(n: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| rng.random_range(-1.0f32..1.0)).collect()
}

/// Weights with normalisations of every kind, as an imported network has them.
fn weights(architecture: &Architecture) -> Weights {
    let mut weights = Weights::initial(architecture, 3);
    let last = weights.layers.len() - 1;
    for (at, layer) in weights.layers.iter_mut().enumerate() {
        let outputs = layer.bias.len();
        layer.bias = random(outputs, 100 + at as u64).iter().map(|v| 0.2 * v).collect();
        let affine = (at == 0 || at + 1 >= last).then(|| {
            let scale = random(outputs, 300 + at as u64).iter().map(|v| 1.0 + 0.3 * v).collect();
            (scale, random(outputs, 400 + at as u64).iter().map(|v| 0.5 + 0.2 * v).collect())
        });
        if layer.norm.is_some() || affine.is_some() {
            let variance = random(outputs, 200 + at as u64).iter().map(|v| 1.2 + v).collect();
            layer.norm = Some(Norm { mean: random(outputs, 500 + at as u64), variance, affine });
        }
    }
    weights
}

/// Patches of different sizes: a bent sheet, its points turned about z by `turn`.
fn sheet(count: usize, seed: u64, turn: f32) -> Patch {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut point = || {
        let (x, y) = (rng.random_range(-0.9f32..0.9), rng.random_range(-0.9f32..0.9));
        let p = Vector3::new(x, y, 0.3 * x * x - 0.2 * (3.0 * y).sin());
        nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), turn) * p
    };
    let mut patch = Patch::default();
    patch.fill((0..count).map(|_| point().into()));
    patch
}

fn run(network: &Network, patches: &[Patch]) -> Vec<f32> {
    let mut values = vec![0.0; patches.len() * network.dim()];
    network.describe(patches, &mut Workspace::default(), &mut values);
    values
}

#[test]
fn the_module_and_the_fast_path_agree() {
    for architecture in [
        Architecture::default(),
        Architecture { point_channels: 32, channels: vec![48, 16], attention_channels: 32 },
    ] {
        let weights = weights(&architecture);
        let patches = [sheet(400, 1, 0.0), sheet(30, 2, 0.0), sheet(3, 3, 0.0)];
        let fast = run(&Network::new(&weights), &patches);
        let shape = [patches.len() * MAP, RADII * architecture.point_channels, 3];
        let points = TensorData::new(picked(&patches, &weights), shape);
        let points = Tensor::from_data(points, &Device::flex());
        let module = MiniSpinNet::new(&weights, &Device::flex());
        let (slow, _) = module.forward(points, Mode::Running(&statistics_of(&weights)));
        let slow = module::values(slow);
        let worst = fast.iter().zip(&slow).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 2e-5 && fast.iter().any(|v| v.abs() > 0.1), "{worst}");
        // Parameters and back.
        let parameters = parameters_of(&weights);
        let again = weights_from(&architecture, &parameters, &statistics_of(&weights));
        assert_eq!(parameters_of(&again), parameters);
    }
}
