use super::batch::Batch;
use super::learner::{Learner, State, circle_loss};
use super::*;
use crate::geometry::{Point, RigidMotion};
use crate::monitor::Silent;
use crate::scan::Surface;
use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::Vector3;

/// A network that trains in seconds.
fn config() -> TrainConfig {
    TrainConfig {
        channels: vec![16, 16, 16],
        pairs_per_scene: 60,
        flat_share: 1.0,
        steps: 24,
        pairs_per_step: 16,
        learning_rate: 3e-3,
        checkpoint_every: 6,
        validate_every: 12,
        ..TrainConfig::default()
    }
}

/// Two scans of one bumpy ground from two places, posed.
fn scene(seed: u64) -> Vec<PosedSurface> {
    let phase = seed as f32;
    let height = |x: f32, y: f32| {
        0.1 * ((3.0 * x + phase).sin() * (4.0 * y).cos() + (7.0 * y + 2.0 * x).sin())
            + 0.2 * (x * y + phase).sin()
    };
    let poses = [
        RigidMotion::identity(),
        RigidMotion::new(Vector3::new(0.3, -0.2, 0.1), Vector3::new(0.1, 0.05, 0.9)),
    ];
    let scan = |world_from_scan: RigidMotion| {
        let back = world_from_scan.inverse().cast::<f32>();
        let at = |i: usize| ((i % 100) as f32 * 0.03 - 1.5, (i / 100) as f32 * 0.03 - 1.5);
        let points: Vec<Point> =
            (0..10_000).map(at).map(|(x, y)| back * Point::new(x, y, height(x, y))).collect();
        let viewpoint = back * Point::new(0.0, 0.0, 3.0);
        let normals = crate::descriptor::surface::normals(&points, &viewpoint, 0.1);
        PosedSurface { surface: Surface { points, normals, viewpoint }, viewpoint, world_from_scan }
    };
    poses.into_iter().map(scan).collect()
}

fn data(config: &TrainConfig) -> PairData {
    let lengths = PairLengths { radius_m: 0.3, match_m: 0.02 };
    let of = |seed: u64| PairScene { name: seed.to_string(), pairs: extract(&scene(seed), lengths, config) };
    PairData { train: vec![of(1), of(2)], valid: vec![of(3)] }
}

#[test]
fn pairs_show_one_place_twice() {
    let config = config();
    let data = data(&config);
    for pair in data.train.iter().flat_map(|s| &s.pairs) {
        // The axes differ by the sampling only, the frames by a turn about them: heights and
        // distances from the axis stay. Mean height tells one bump from another.
        let mean = |points: &[[f32; 3]]| points.iter().map(|p| p[2]).sum::<f32>() / points.len() as f32;
        let [a, b] = [0, 1].map(|side| mean(&pair.points[side]));
        assert!((a - b).abs() < 0.03 && pair.points[0].len() > 100, "{a} {b}");
    }
    assert_eq!(data.train[0].pairs.len(), 60);
    // The same seed, the same pairs.
    assert_eq!(data.train, super::tests::data(&config).train);
}

/// Equations of the loss with loops in double precision.
#[test]
fn the_loss_equals_its_formula() {
    let config = TrainConfig { circle_scale: 5.0, circle_margin: 0.3, ..config() };
    let (pairs, dim) = (4, 3);
    let rows: Vec<Vec<f64>> = (0..2 * pairs)
        .map(|r| {
            let v: Vec<f64> = (0..dim).map(|d| (1.7 * (r * dim + d) as f64).sin()).collect();
            let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
            v.iter().map(|x| x / norm).collect()
        })
        .collect();
    let negatives: Vec<bool> =
        (0..pairs * pairs).map(|at| at / pairs != at % pairs && at != 1 && at != 4).collect();
    let s = |i: usize, j: usize| -> f64 { rows[i].iter().zip(&rows[pairs + j]).map(|(a, b)| a * b).sum() };
    let (gamma, m) = (config.circle_scale, config.circle_margin);
    let mut expected = 0.0;
    for i in 0..pairs {
        let positive = (-gamma * (1.0 + m - s(i, i)).max(0.0) * (s(i, i) - 1.0 + m)).exp();
        for transposed in [false, true] {
            let at = |j: usize| if transposed { (j, i) } else { (i, j) };
            let terms = (0..pairs).map(at).filter(|&(r, c)| negatives[r * pairs + c]);
            let sum: f64 = terms.map(|(r, c)| (gamma * (s(r, c) + m).max(0.0) * (s(r, c) - m)).exp()).sum();
            expected += (1.0 + sum * positive).ln() / (2 * pairs) as f64;
        }
    }
    let flat: Vec<f32> = rows.concat().iter().map(|v| *v as f32).collect();
    let tensor = Tensor::from_data(TensorData::new(flat, [2 * pairs, dim]), &Device::flex().autodiff());
    let got = f64::from(circle_loss(tensor, &negatives, &config).inner().into_scalar::<f32>());
    assert!((got - expected).abs() < 1e-4, "{got} {expected}");
}

/// The gradient that Adam's first moment holds after one step, against differences of the loss.
#[test]
fn gradients_equal_finite_differences_of_the_loss() {
    let config = TrainConfig { weight_decay: 0.0, channels: vec![16, 16], ..config() };
    let batch = Batch::draw(&data(&config).train, 0, &config);
    let start = State::new(&initial_weights(&config.architecture(), 1));
    let learner = Learner::new(&config);
    let mut after = start.clone();
    learner.step(&mut after, &batch).unwrap();
    let mut checked = 0;
    // The point layer is left out: another maximum may be picked under a finite change.
    for p in 2..start.parameters.len() {
        let gradient: Vec<f32> = after.moments[p].0.iter().map(|m| m / 0.1).collect();
        let at =
            (0..gradient.len()).max_by(|&a, &b| gradient[a].abs().total_cmp(&gradient[b].abs())).unwrap();
        let loss = |by: f32| {
            let mut moved = start.clone();
            moved.parameters[p][at] += by;
            learner.step(&mut moved, &batch).unwrap()
        };
        let h = 4e-3;
        let expected = (loss(h) - loss(-h)) / (2.0 * f64::from(h));
        let got = f64::from(gradient[at]);
        assert!((got - expected).abs() < 1e-3 + 0.08 * expected.abs(), "{p}: {got} {expected}");
        checked += usize::from(expected.abs() > 5e-3);
    }
    assert!(checked >= 4, "{checked}");
}

#[test]
fn a_resumed_run_equals_one_that_never_stopped_and_the_loss_falls() {
    let config = config();
    let data = data(&config);
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let report = train(&data, &config, folders[0].path(), false, &Silent).unwrap();
    let losses: Vec<f64> = report.records.iter().map(|r| r.loss).collect();
    assert!(losses[3] < 0.8 * losses[0], "{losses:?}");
    assert!(report.records[3].accuracy.unwrap() > 0.1, "{:?}", report.records);

    /// Stops after some steps.
    struct Stopper(std::sync::atomic::AtomicUsize);
    impl crate::monitor::Monitor for Stopper {
        fn cancelled(&self) -> bool {
            self.0.fetch_add(1, std::sync::atomic::Ordering::Relaxed) >= 14
        }
    }
    assert!(train(&data, &config, folders[1].path(), false, &Stopper(0.into())).is_err());
    let resumed = train(&data, &config, folders[1].path(), true, &Silent).unwrap();
    assert_eq!(resumed.steps, 12);
    for name in ["best.safetensors", "last.safetensors"] {
        let [a, b] = [0, 1].map(|i| std::fs::read(folders[i].path().join(name)).unwrap());
        assert!(a == b, "{name}");
    }
    let message = |config: &TrainConfig, data: &PairData, resume| {
        train(data, config, folders[1].path(), resume, &Silent).unwrap_err().to_string()
    };
    assert!(message(&config, &data, false).contains("--force"));
    let other = TrainConfig { noise: 0.0, ..config.clone() };
    assert!(message(&other, &data, true).contains("other settings"));
    let less = PairData { valid: vec![], ..data.clone() };
    assert!(message(&config, &less, true).contains("other patches"));
}
