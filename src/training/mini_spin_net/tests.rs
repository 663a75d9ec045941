use super::batch::{Batch, picked};
use super::learner::{Learner, State, circle_loss};
use super::module::{MAP, MiniSpinNet, Mode, parameters_of, statistics_of, values, weights_from};
use super::*;
use crate::Silent;
use crate::descriptor::mini_spin_net::{RADII, Weights};
use crate::geometry::{Point, RigidMotion};
use crate::scan::Surface;
use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::Vector3;

/// A network that trains in seconds.
fn config() -> TrainConfig {
    TrainConfig {
        channels: vec![16, 16, 16],
        pairs_per_scene: 60,
        keypoint_offset: 0.0,
        flat_share: 1.0,
        steps: 48,
        pairs_per_step: 16,
        learning_rate: 3e-3,
        checkpoint_every: 12,
        validate_every: 24,
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
        let normals = crate::preprocessing::normals(&points, &viewpoint, 0.1);
        PosedSurface {
            surface: Surface { points, normals, viewpoint, ..Surface::default() },
            world_from_scan,
        }
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

#[test]
fn keypoints_of_a_pair_are_apart_by_up_to_the_offset() {
    // Heights and distances along the axis of one place differ by the sampling alone; two places
    // on the bumpy ground differ the more, the farther apart they are.
    let spread = |keypoint_offset: f64| {
        let data = data(&TrainConfig { keypoint_offset, ..config() });
        let mean = |points: &[[f32; 3]]| points.iter().map(|p| p[2]).sum::<f32>() / points.len() as f32;
        let pairs: Vec<&PatchPair> = data.train.iter().flat_map(|s| &s.pairs).collect();
        assert_eq!(pairs.len(), 120);
        pairs.iter().map(|p| (mean(&p.points[0]) - mean(&p.points[1])).abs()).sum::<f32>() / 120.0
    };
    let spreads = [0.0, 0.2, 0.6].map(spread);
    assert!(spreads[1] > 2.0 * spreads[0] && spreads[2] > 1.5 * spreads[1], "{spreads:?}");
}

/// Descriptors of four pairs, and which of them are negatives.
fn few_descriptors(dim: usize) -> (Vec<f64>, Vec<bool>) {
    let unit = |row: usize| {
        let v: Vec<f64> = (0..dim).map(|d| (1.7 * (row * dim + d) as f64).sin()).collect();
        let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        v.into_iter().map(move |x| x / norm)
    };
    let negatives = (0..16).map(|at| at / 4 != at % 4 && at != 1 && at != 4).collect();
    ((0..8).flat_map(unit).collect(), negatives)
}

/// The loss of `rows` with loops in double precision; the brackets are those of `brackets`.
fn loss_by_hand(rows: &[f64], brackets: &[f64], negatives: &[bool], config: &TrainConfig) -> f64 {
    let dim = rows.len() / 8;
    let product = |rows: &[f64], i: usize, j: usize| -> f64 {
        (0..dim).map(|d| rows[i * dim + d] * rows[(4 + j) * dim + d]).sum()
    };
    let (gamma, m) = (config.circle_scale, config.circle_margin);
    let mut loss = 0.0;
    for i in 0..4 {
        let pull = (1.0 + m - product(brackets, i, i)).max(0.0) * (product(rows, i, i) - 1.0 + m);
        for transposed in [false, true] {
            let at = |j: usize| if transposed { (j, i) } else { (i, j) };
            let push = |(r, c): (usize, usize)| {
                (gamma * (product(brackets, r, c) + m).max(0.0) * (product(rows, r, c) - m)).exp()
            };
            let sum: f64 = (0..4).map(at).filter(|&(r, c)| negatives[r * 4 + c]).map(push).sum();
            loss += (1.0 + sum * (-gamma * pull).exp()).ln() / 8.0;
        }
    }
    loss
}

#[test]
fn the_loss_and_its_slope_equal_the_formula() {
    let config = TrainConfig { circle_scale: 5.0, circle_margin: 0.3, ..config() };
    let (rows, negatives) = few_descriptors(3);
    let flat: Vec<f32> = rows.iter().map(|v| *v as f32).collect();
    let tensor =
        Tensor::<2>::from_data(TensorData::new(flat, [8, 3]), &Device::flex().autodiff()).require_grad();
    let loss = circle_loss(tensor.clone(), &negatives, &config);
    let got = f64::from(loss.clone().inner().into_scalar::<f32>());
    let expected = loss_by_hand(&rows, &rows, &negatives, &config);
    assert!((got - expected).abs() < 1e-4, "{got} {expected}");
    // The brackets pass no gradient: they stay while the rest moves.
    let slopes = values(tensor.grad(&loss.backward()).unwrap());
    for (at, slope) in slopes.iter().enumerate() {
        let moved = |by: f64| {
            let mut moved = rows.clone();
            moved[at] += by;
            loss_by_hand(&moved, &rows, &negatives, &config)
        };
        let expected = (moved(1e-5) - moved(-1e-5)) / 2e-5;
        assert!((f64::from(*slope) - expected).abs() < 1e-4, "{at}: {slope} {expected}");
    }
}

/// Of a weighted sum of descriptors: through pooling, attention, convolutions and normalisation.
#[test]
fn gradients_equal_finite_differences() {
    let config = TrainConfig { channels: vec![16, 16, 16], pairs_per_step: 4, ..config() };
    let batch = Batch::draw(&data(&config).train, 0, &config);
    let start = Weights::initial(&config.architecture(), 1);
    let (parameters, statistics) = (parameters_of(&start), statistics_of(&start));
    let n = batch.patches.len();
    let points = picked(&batch.patches, &start);
    let sum = |parameters: &[Vec<f32>], device: &Device| {
        let module = MiniSpinNet::new(&weights_from(&start.architecture, parameters, &statistics), device);
        let shape = [n * MAP, RADII * 16, 3];
        let points = Tensor::from_data(TensorData::new(points.clone(), shape), device);
        let factors: Vec<f32> = (0..n * 16).map(|i| (1.3 * i as f32).sin()).collect();
        let factors = Tensor::from_data(TensorData::new(factors, [n, 16]), device);
        ((module.forward(points, Mode::Batch).0 * factors).sum(), module)
    };
    let (total, module) = sum(&parameters, &Device::flex().autodiff());
    let gradients = module.gradients(&total.backward());
    let mut checked = 0;
    for p in 0..parameters.len() {
        let size = |i: &usize| gradients[p][*i].abs();
        let at = (0..gradients[p].len()).max_by(|a, b| size(a).total_cmp(&size(b))).unwrap();
        let moved = |by: f32| {
            let mut moved = parameters.clone();
            moved[p][at] += by;
            f64::from(sum(&moved, &Device::flex()).0.into_scalar::<f32>())
        };
        let h = 2e-3;
        let expected = (moved(h) - moved(-h)) / (2.0 * f64::from(h));
        let got = f64::from(gradients[p][at]);
        // A bias in front of a normalisation has no effect: rounding is all that is left.
        assert!((got - expected).abs() < 3e-3 + 0.05 * expected.abs(), "{p}: {got} {expected}");
        checked += usize::from(expected.abs() > 0.03);
    }
    assert!(checked >= 6, "{checked}");
}

#[test]
fn a_resumed_run_equals_one_that_never_stopped_and_the_loss_falls() {
    let config = config();
    let data = data(&config);
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let report = train(&data, &config, folders[0].path(), false, &Silent).unwrap();
    let losses: Vec<f64> = report.records.iter().map(|r| r.loss).collect();
    assert!(losses[3] < 0.85 * losses[0], "{losses:?}");
    assert!(report.records[3].accuracy.unwrap() > 0.1, "{:?}", report.records);

    /// Stops after some steps.
    struct Stopper(std::sync::atomic::AtomicUsize);
    impl crate::Monitor for Stopper {
        fn cancelled(&self) -> bool {
            self.0.fetch_add(1, std::sync::atomic::Ordering::Relaxed) >= 14
        }
    }
    assert!(train(&data, &config, folders[1].path(), false, &Stopper(0.into())).is_err());
    let resumed = train(&data, &config, folders[1].path(), true, &Silent).unwrap();
    assert_eq!(resumed.steps, 36);
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
    // More steps than were planned are only more steps.
    let longer = TrainConfig { steps: config.steps + 1, ..config.clone() };
    assert_eq!(train(&data, &longer, folders[1].path(), true, &Silent).unwrap().steps, 1);
    let less = PairData { valid: vec![], ..data.clone() };
    assert!(message(&config, &less, true).contains("other patches"));
}

#[test]
fn the_learning_rate_falls_over_the_last_steps_alone() {
    let config = TrainConfig { steps: 10, cooldown: 4, learning_rate: 1e-3, ..config() };
    let rates: Vec<f64> = (0..10).map(|done| config.learning_rate_after(done) / 1e-3).collect();
    assert_eq!(rates, [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.75, 0.5, 0.25]);
    // The same step at a quarter of the rate moves every parameter a quarter as far (Adam scales with it).
    let data = data(&config);
    let start = State::new(&Weights::initial(&config.architecture(), 5));
    let batch = Batch::draw(&data.train, 0, &config);
    let moved = |config: &TrainConfig| -> Vec<f32> {
        let mut state = start.clone();
        Learner::new(config).step(&mut state, &batch).unwrap();
        let pairs = state.parameters.iter().flatten().zip(start.parameters.iter().flatten());
        pairs.map(|(after, before)| after - before).collect()
    };
    let (whole, quarter) = (moved(&config), moved(&TrainConfig { steps: 1, ..config.clone() }));
    assert!(whole.iter().zip(&quarter).all(|(w, q)| (w / 4.0 - q).abs() < 1e-6));
    assert!(whole.iter().any(|w| w.abs() > 5e-4));
}

/// A run that dies before its state is written does the steps again: the log must not lack them.
#[test]
fn the_log_is_written_before_the_state_it_belongs_to() {
    /// Puts a folder where the state would go.
    struct Blocked(std::path::PathBuf);
    impl crate::Monitor for Blocked {
        fn advance(&self, _: usize) {
            std::fs::create_dir_all(self.0.join("in the way")).unwrap();
        }
    }
    let config = config();
    let folder = tempfile::tempdir().unwrap();
    let last = folder.path().join("last.safetensors");
    let message = train(&data(&config), &config, folder.path(), false, &Blocked(last.clone())).unwrap_err();
    assert!(message.to_string().contains("last.safetensors"), "{message}");
    let log = std::fs::read_to_string(folder.path().join("metrics.jsonl")).unwrap();
    assert_eq!(log.lines().count(), 1, "{log}");
}
