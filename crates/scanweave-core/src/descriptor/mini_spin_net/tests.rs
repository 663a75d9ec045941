use super::weights::Norm;
use super::winograd::{Convolution, Scratch};
use super::*;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const MAP: usize = ELEVATIONS * AZIMUTHS;

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

struct Convolved<'a>(&'a Convolution, &'a [f32]);

impl pulp::WithSimd for Convolved<'_> {
    type Output = Vec<f32>;
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) -> Vec<f32> {
        let mut result = Vec::new();
        self.0.forward(simd, self.1, &mut Scratch::default(), &mut result);
        result
    }
}

/// The sum that defines a convolution, in double precision, on every vector width there is.
#[test]
fn convolution_equals_its_definition() {
    for (inputs, outputs, n) in [(48, 64, 2), (16, 32, 3), (32, 16, 1), (64, 128, 1)] {
        let (filter, bias) = (random(outputs * inputs * 9, 1), random(outputs, 2));
        let maps = random(n * MAP * inputs, 3);
        let convolution = Convolution::new(&filter, &bias, true);
        let mut results = vec![pulp::Arch::new().dispatch(Convolved(&convolution, &maps))];
        results.push(pulp::WithSimd::with_simd(Convolved(&convolution, &maps), pulp::Scalar::new()));
        for map in 0..n {
            for cell in 0..MAP {
                for output in 0..outputs {
                    let mut sum = f64::from(bias[output]);
                    for tap in 0..9 {
                        let elevation = (cell / AZIMUTHS + tap / 3) as i32 - 1;
                        if !(0..ELEVATIONS as i32).contains(&elevation) {
                            continue;
                        }
                        let azimuth = (cell % AZIMUTHS + tap % 3 + AZIMUTHS - 1) % AZIMUTHS;
                        let from = map * MAP + elevation as usize * AZIMUTHS + azimuth;
                        for input in 0..inputs {
                            let w = filter[(output * inputs + input) * 9 + tap];
                            sum += f64::from(w) * f64::from(maps[from * inputs + input]);
                        }
                    }
                    for result in &results {
                        let got = f64::from(result[(map * MAP + cell) * outputs + output]);
                        // Values reach some 20; F(4×4) loses about two digits of single precision.
                        assert!((got - sum.max(0.0)).abs() < 2e-4, "{got} {sum}");
                    }
                }
            }
        }
    }
}

#[test]
fn a_turn_about_the_axis_by_a_cell_changes_nothing_and_company_neither() {
    let network = Network::new(&weights(&Architecture::default()));
    let turn = 3.0 * std::f32::consts::TAU / AZIMUTHS as f32;
    let (still, turned) = (sheet(300, 1, 0.0), sheet(300, 1, turn));
    let together = run(&network, &[still.clone(), turned, sheet(300, 2, 0.0)]);
    let (a, rest) = together.split_at(32);
    let worst = a.iter().zip(rest).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    // A point on the edge of a cell may change sides by rounding.
    assert!(worst < 0.02, "{worst}");
    let other: f32 = a.iter().zip(&rest[32..]).map(|(a, b)| (a - b).powi(2)).sum();
    assert!(other > 1e-5, "{other}");
    assert_eq!(run(&network, &[still]), a);
}

#[test]
fn a_checkpoint_comes_back_whole_and_a_damaged_one_does_not() {
    let weights = weights(&Architecture { point_channels: 16, channels: vec![16], attention_channels: 16 });
    let meta = Meta {
        format_version: 1,
        descriptor: "mini-spin-net".into(),
        name: "a".into(),
        architecture: weights.architecture.clone(),
        source: "here".into(),
        licence: "MIT".into(),
        recipe: serde_json::json!({ "steps": 3 }),
        metrics: [("accuracy".to_owned(), 0.25)].into(),
        steps: 3,
    };
    let checkpoint = Checkpoint { meta, weights };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    checkpoint.save(&path).unwrap();
    assert_eq!(Checkpoint::load(&path).unwrap(), checkpoint);
    let bytes = std::fs::read(&path).unwrap();
    let message = |bytes: &[u8]| Checkpoint::from_bytes(&path, bytes).unwrap_err().to_string();
    let mut flipped = bytes.clone();
    *flipped.last_mut().unwrap() ^= 1;
    assert!(message(&flipped).contains("checksum"), "{}", message(&flipped));
    assert!(message(&bytes[..bytes.len() / 2]).contains("not a whole safetensors file"));
    let mut other = checkpoint.clone();
    other.meta.format_version = 2;
    other.save(&path).unwrap();
    assert!(Checkpoint::load(&path).unwrap_err().to_string().contains("format 2"));
    other.meta.format_version = 1;
    other.weights.layers.pop();
    other.save(&path).unwrap();
    assert!(Checkpoint::load(&path).unwrap_err().to_string().contains("no attention.1.weight"));
}

/// Points on a bumpy sheet, `per_side`² of them over 2 m × 2 m.
fn ground(per_side: usize) -> Vec<Point> {
    let step = 2.0 / per_side as f32;
    let at = |i: usize| ((i % per_side) as f32 * step - 1.0, (i / per_side) as f32 * step - 1.0);
    let height = |x: f32, y: f32| 1.0 + 0.1 * (4.0 * x).sin() * (5.0 * y).cos();
    (0..per_side * per_side).map(at).map(|(x, y)| Point::new(x, y, height(x, y))).collect()
}

#[test]
fn poor_surroundings_have_zeros_and_any_density_a_unit_descriptor() {
    let network = Network::new(&Weights::initial(&Architecture::default(), 2));
    let describe = |points: &[Point], keypoints: &[Point]| {
        descriptors(&network, points, &Point::origin(), keypoints, 0.3, 1)
    };
    let lone = [[0.0, 0.0, 1.0], [5.0, 0.0, 1.0], [5.1, 0.0, 1.0]].map(Point::from);
    let line: Vec<Point> = (0..50).map(|i| Point::new(i as f32 * 0.01, 0.0, 1.0)).collect();
    for points in [&lone[..], &line] {
        assert!(describe(points, points).iter().all(|v| *v == 0.0));
    }
    assert!(describe(&[], &[]).is_empty());
    // 2.5 cm, and a tenth and ten times as many points: 45, 452 and 4520 a patch, of which 512 go in.
    let keypoints: Vec<Point> =
        ground(10).into_iter().filter(|p| p.x.abs() < 0.6 && p.y.abs() < 0.6).collect();
    let [usual, sparse, dense] = [80, 25, 253].map(|n| describe(&ground(n), &keypoints));
    for row in usual.chunks(32).chain(sparse.chunks(32)).chain(dense.chunks(32)) {
        assert!((row.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
    }
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
    let likeness = |other: &[f32]| {
        usual.chunks(32).zip(other.chunks(32)).map(|(a, b)| dot(a, b)).sum::<f32>() / keypoints.len() as f32
    };
    // Nearer to themselves at ten times the density than a tenth of it, which leaves cells empty.
    assert!(
        likeness(&dense) > likeness(&sparse) && likeness(&dense) > 0.99,
        "{} {}",
        likeness(&dense),
        likeness(&sparse)
    );
}

#[test]
fn threads_do_not_change_a_bit() {
    let network = Network::new(&Weights::initial(&Architecture::default(), 2));
    let points = ground(60);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| descriptors(&network, &points, &Point::origin(), &points[..200], 0.3, 1))
    };
    assert_eq!(with(1), with(3));
    assert_ne!(with(1), descriptors(&network, &points, &Point::origin(), &points[..200], 0.3, 2));
}
