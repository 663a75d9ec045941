//! Fits the weights of the evidence model to attempts whose outcome is known.
//!
//! Usage: `cargo run --release --example evidence_calibration -- [--keypoints N]… SCENE…`
//!
//! Each SCENE is a folder of scans with true poses. For meta-shapes of 1 to 16 scans at
//! their true poses, ten other scans of the scene and four of other scenes are
//! registered against the meta-shape. An attempt is right when the scan belongs to the
//! scene and its pose is within 10° and 6τ of the truth; attempts between that and 20°,
//! 9τ are left out. Prints the fitted weights, and for every scene what weights fitted
//! without it make of it: log loss, how often a probability above one half is right, and
//! how the probabilities compare with the outcomes.

use nalgebra::{DMatrix, DVector};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scanweave::Silent;
use scanweave::config::Config;
use scanweave::descriptor::{keypoints, scale, surface};
use scanweave::evaluation::pose_error::PoseError;
use scanweave::geometry::RigidMotion;
use scanweave::registration::config::{EvidenceWeights, RegistrationConfig};
use scanweave::registration::evidence::predictors;
use scanweave::registration::growth::{Attempt, Growth};
use scanweave::registration::incremental::{Lengths, ScanInput};
use scanweave::scan::{DeclineReason, Features, ScanId, SimilarityMatrix, Support, Surface};

/// Meta-shapes tried per scene and keypoint count.
const META_SHAPES: usize = 10;
/// Scans of the scene that are tried against each.
const OWN: usize = 10;
/// Scans of other scenes that are tried against each.
const STRANGERS: usize = 4;

struct Scene {
    name: String,
    features: Vec<Features>,
    surfaces: Vec<Surface>,
    world_from_scan: Vec<RigidMotion>,
    lengths: Lengths,
}

struct Example {
    x: [f64; 6],
    right: bool,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut counts, mut folders) = (Vec::new(), Vec::new());
    let mut arguments = std::env::args().skip(1);
    while let Some(a) = arguments.next() {
        if a == "--keypoints" {
            counts.push(arguments.next().ok_or("--keypoints needs a number")?.parse::<usize>()?);
        } else {
            folders.push(a);
        }
    }
    if counts.is_empty() {
        counts = vec![5000, 1000];
    }
    let scenes = folders.iter().map(|f| read(f)).collect::<Result<Vec<_>, _>>()?;
    let examples: Vec<Vec<Example>> = (0..scenes.len())
        .map(|s| counts.iter().flat_map(|&count| attempts(&scenes, s, count)).collect())
        .collect();
    for (held, scene) in scenes.iter().enumerate() {
        let rest = examples.iter().enumerate().filter(|e| e.0 != held).flat_map(|e| e.1);
        report(&scene.name, &examples[held], &fit(rest));
    }
    let all: Vec<&Example> = examples.iter().flatten().collect();
    let weights = fit(all.iter().copied());
    report("all, on themselves", &examples.into_iter().flatten().collect::<Vec<_>>(), &weights);
    let [constant, ln_inliers, ln_lead, normal_agreement, plane_residual, overlap] = weights;
    println!(
        "{:#?}",
        EvidenceWeights { constant, ln_inliers, ln_lead, normal_agreement, plane_residual, overlap }
    );
    Ok(())
}

fn read(folder: &str) -> Result<Scene, Box<dyn std::error::Error>> {
    let scene = scanweave::io::dataset::read_scene(folder)?;
    let truth = scene.world_from_scan.ok_or_else(|| format!("{folder}: no true poses"))?.value;
    let scans = scanweave::io::read_scans(&scene.scans, &Silent)?;
    let config = Config::default();
    let clouds: Vec<_> = scans.iter().map(|s| &s.cloud).collect();
    let scale = scale::choose(&config.scale, &clouds)?.scale;
    let surfaces: Vec<Surface> = scans.iter().map(|s| surface::thin(&s.cloud, &scale)).collect();
    let features = scans
        .iter()
        .zip(&surfaces)
        .map(|(scan, surface)| scanweave::descriptor::describe(scan, surface, &scale, &config.descriptor, 0))
        .collect::<Result<_, _>>()?;
    let lengths = Lengths { inlier_radius_m: scale.inlier_radius_m, voxel_m: scale.voxel_m };
    Ok(Scene { name: scene.name, features, surfaces, world_from_scan: truth, lengths })
}

/// Labelled attempts against random meta-shapes of scene `s`.
fn attempts(scenes: &[Scene], s: usize, count: usize) -> Vec<Example> {
    let scene = &scenes[s];
    let n = scene.features.len();
    let mut rng = ChaCha8Rng::seed_from_u64(count as u64);
    rng.set_stream(s as u64);
    let mut examples = Vec::new();
    for _ in 0..META_SHAPES {
        // Strangers follow the scene's own scans.
        let strangers: Vec<(usize, usize)> = (0..if scenes.len() > 1 { STRANGERS } else { 0 })
            .map(|_| {
                let other = (s + rng.random_range(1..scenes.len())) % scenes.len();
                (other, rng.random_range(0..scenes[other].features.len()))
            })
            .collect();
        let own = scene.features.iter().chain(strangers.iter().map(|&(o, i)| &scenes[o].features[i]));
        let features: Vec<Features> = own.map(|f| keypoints::subsample(f, count, 0)).collect();
        let surfaces = scene.surfaces.iter().chain(strangers.iter().map(|&(o, i)| &scenes[o].surfaces[i]));
        let inputs: Vec<ScanInput<'_>> = features
            .iter()
            .zip(surfaces)
            .map(|(features, surface)| ScanInput { features, surface })
            .collect();
        let similarity =
            SimilarityMatrix::new(inputs.len(), vec![0.0; inputs.len() * inputs.len()]).expect("square");
        let config = RegistrationConfig::default();
        let mut growth = Growth::new(&inputs, &similarity, &config, scene.lengths, 0);
        let mut order: Vec<usize> = (0..n).collect();
        order.shuffle(&mut rng);
        let members = &order[..rng.random_range(1..=16usize.min(n - 1))];
        growth.start_meta_shape(ScanId(members[0]));
        let meta_from_world = scene.world_from_scan[members[0]].inverse();
        for &m in &members[1..] {
            let pose = meta_from_world * scene.world_from_scan[m];
            growth.merge(&at_truth(ScanId(m), pose), pose);
        }
        // The order is random: its next scans are a random choice of those left.
        let own = order[members.len()..].iter().take(OWN).copied();
        let tried: Vec<ScanId> = own.chain(n..inputs.len()).map(ScanId).collect();
        for attempt in growth.register_pairwise(&tried) {
            let right = match scene.world_from_scan.get(attempt.scan.0) {
                None => Some(false),
                Some(world) => judge(&attempt, &(meta_from_world * world), scene.lengths.inlier_radius_m),
            };
            if let (Some(right), true) = (right, attempt.support.inliers >= 3) {
                examples.push(Example { x: predictors(&attempt.support), right });
            }
        }
    }
    examples
}

fn at_truth(scan: ScanId, world_from_scan: RigidMotion) -> Attempt {
    let refusal: Option<DeclineReason> = None;
    Attempt { scan, world_from_scan, support: Support::default(), residual_m: 0.0, parent: None, refusal }
}

fn judge(attempt: &Attempt, truth: &RigidMotion, radius_m: f64) -> Option<bool> {
    let error = PoseError::between(&attempt.world_from_scan, truth);
    let within = |deg: f64, radii: f64| error.rotation_deg <= deg && error.translation_m <= radii * radius_m;
    if within(10.0, 6.0) {
        Some(true)
    } else if within(20.0, 9.0) {
        None
    } else {
        Some(false)
    }
}

/// Logistic regression by Newton's method with a light ridge.
fn fit<'a>(examples: impl Iterator<Item = &'a Example>) -> [f64; 6] {
    let examples: Vec<&Example> = examples.collect();
    let mut w = DVector::<f64>::zeros(6);
    for _ in 0..50 {
        let (mut gradient, mut hessian) = (&w * 0.01, DMatrix::<f64>::identity(6, 6) * 0.01);
        for e in &examples {
            let x = DVector::from_row_slice(&e.x);
            let p = 1.0 / (1.0 + (-w.dot(&x)).exp());
            gradient += &x * (p - f64::from(u8::from(e.right)));
            hessian += &x * x.transpose() * (p * (1.0 - p));
        }
        match hessian.cholesky() {
            Some(factor) => w -= factor.solve(&gradient),
            None => break,
        }
    }
    std::array::from_fn(|i| w[i])
}

fn report(name: &str, examples: &[Example], weights: &[f64; 6]) {
    let judged: Vec<(f64, bool)> = examples
        .iter()
        .map(|e| {
            let score: f64 = e.x.iter().zip(weights).map(|(x, w)| x * w).sum();
            (1.0 / (1.0 + (-score).exp()), e.right)
        })
        .collect();
    let n = judged.len().max(1) as f64;
    let loss: f64 =
        judged.iter().map(|&(p, r)| -(if r { p } else { 1.0 - p }).max(1e-12).ln()).sum::<f64>() / n;
    let right = judged.iter().filter(|j| j.1).count();
    println!("{name}: {} attempts, {right} right, log loss {loss:.3}", judged.len());
    for threshold in [0.5, 0.9, 0.95] {
        let accepted: Vec<bool> = judged.iter().filter(|j| j.0 >= threshold).map(|j| j.1).collect();
        let wrong = accepted.iter().filter(|r| !**r).count();
        println!(
            "  p ≥ {threshold}: {} of {right} right ones, {wrong} wrong ones ({:.2} %)",
            accepted.len() - wrong,
            100.0 * wrong as f64 / accepted.len().max(1) as f64
        );
    }
    let bins: Vec<String> = (0..5)
        .map(|b| {
            let (low, high) = (0.2 * f64::from(b), 0.2 * f64::from(b + 1));
            let inside: Vec<bool> =
                judged.iter().filter(|j| j.0 >= low && (j.0 < high || b == 4)).map(|j| j.1).collect();
            let share = inside.iter().filter(|r| **r).count() as f64 / inside.len().max(1) as f64;
            format!("{low:.1}–{high:.1}: {share:.2} of {}", inside.len())
        })
        .collect();
    println!("  right among p in {}", bins.join(", "));
}
