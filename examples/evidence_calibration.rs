//! Fits the weights of the evidence model to relative poses whose truth is known.
//!
//! Usage: `cargo run --release --example evidence_calibration -- [--keypoints N]… [--features DIR] [--table FILE] SCENE…`
//!
//! Each SCENE is a folder of scans with true poses; features are computed, or read from
//! `DIR/<scene>/<scan>.npz` (`scanweave describe` writes those of other descriptors). Scans are
//! registered with the 25 most similar ones, a group of scans of
//! every other place among them. Random groups of one to sixteen overlapping scans, at poses a little off the
//! truth, are then compared as the registration does it. A proposed relative pose is right when it
//! is within 5° and 3τ of the truth at the centre of the second group; what lies between that and
//! 10°, 6τ is left out. Prints for every scene the quality of weights fitted to the other scenes (log
//! loss, how often a probability above a threshold is right, reliability), and the weights fitted to all.
//! `--table` writes the measurements of every proposal as CSV.

use nalgebra::{DMatrix, DVector, Vector3};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use scanweave::Silent;
use scanweave::config::Config;
use scanweave::evaluation::ground_truth::overlap_matrix;
use scanweave::geometry::{Point, RigidMotion};
use scanweave::pipeline::{self, FeatureSource};
use scanweave::registration::Agglomeration;
use scanweave::registration::ScanModel;
use scanweave::registration::config::{AgglomerativeConfig, EvidenceWeights, SurfaceVerification};
use scanweave::registration::predictors;
use scanweave::registration::{Lengths, ScanInput};
use scanweave::registration::{PairScorer, most_similar_pairs};
use scanweave::registration::{ScoredHypothesis, Verifier};
use scanweave::retrieval::similarity_of;
use scanweave::scan::{Evidence, Features, ScanId, SimilarityMatrix, Surface};
use std::path::{Path, PathBuf};

/// Rounds of random groups per scene and keypoint count.
const ROUNDS: usize = 8;
/// Scans of every other place, at most, that are compared with the scene: alone and as a group.
const UNRELATED: usize = 8;
const PREDICTORS: usize = 10;

type Failure = Box<dyn std::error::Error>;

struct Scene {
    name: String,
    features: Vec<Features>,
    surfaces: Vec<Surface>,
    world_from_scan: Vec<RigidMotion>,
    overlap: SimilarityMatrix,
    lengths: Lengths,
}

#[derive(Clone)]
struct Example {
    x: [f64; PREDICTORS],
    right: bool,
    evidence: Evidence,
    /// Scans of the two groups.
    sizes: (usize, usize),
}

fn main() -> Result<(), Failure> {
    let (mut counts, mut folders, mut given, mut table) = (Vec::new(), Vec::new(), None, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(a) = arguments.next() {
        match a.as_str() {
            "--keypoints" => {
                counts.push(arguments.next().ok_or("--keypoints needs a number")?.parse::<usize>()?)
            }
            "--features" => given = Some(PathBuf::from(arguments.next().ok_or("--features needs a folder")?)),
            "--table" => table = Some(PathBuf::from(arguments.next().ok_or("--table needs a file")?)),
            _ => folders.push(a),
        }
    }
    if counts.is_empty() {
        counts = vec![2500, 1000];
    }
    let most = counts.iter().copied().max().unwrap_or(0);
    let scenes = folders.iter().map(|f| read(f, given.as_deref(), most)).collect::<Result<Vec<_>, _>>()?;
    let mut examples: Vec<Vec<Example>> = Vec::new();
    for s in 0..scenes.len() {
        let mut of_scene = Vec::new();
        for &count in &counts {
            of_scene.extend(compare(&scenes, s, count)?);
        }
        eprintln!("{}: {} proposals", scenes[s].name, of_scene.len());
        examples.push(of_scene);
    }
    if let Some(path) = table {
        std::fs::write(path, csv(&scenes, &examples))?;
    }
    for (held, scene) in scenes.iter().enumerate() {
        let rest = examples.iter().enumerate().filter(|e| e.0 != held).flat_map(|e| e.1);
        report(&scene.name, &examples[held], &fit(rest));
    }
    let weights = fit(examples.iter().flatten());
    report("all, on themselves", &examples.concat(), &weights);
    println!("{:#?}", EvidenceWeights::from_array(weights));
    Ok(())
}

fn csv(scenes: &[Scene], examples: &[Vec<Example>]) -> String {
    let mut lines = String::from(
        "scene,right,scans_a,scans_b,matches,inliers,second_best_inliers,overlap,normal_agreement,plane_residual,\
         free_space_violation,localizability,chance_inliers\n",
    );
    for (scene, of_scene) in scenes.iter().zip(examples) {
        for Example { right, evidence: s, sizes: (a, b), .. } in of_scene {
            let shares = [
                s.overlap,
                s.normal_agreement,
                s.plane_residual,
                s.free_space_violation,
                s.localizability,
                s.chance_inliers,
            ];
            let shares = shares.map(|x| x.to_string()).join(",");
            let (right, name) = (u8::from(*right), &scene.name);
            let counts =
                [*a, *b, s.matches, s.inliers, s.second_best_inliers].map(|n| n.to_string()).join(",");
            lines += &format!("{name},{right},{counts},{shares}\n");
        }
    }
    lines
}

fn read(folder: &str, given: Option<&Path>, keypoints: usize) -> Result<Scene, Failure> {
    let scene = scanweave::io::dataset::read_scene(folder)?;
    let truth = scene.world_from_scan.ok_or_else(|| format!("{folder}: no true poses"))?.value;
    let scans = scanweave::io::read_scans(&scene.scans, &Silent)?;
    let mut config = Config::default();
    config.descriptor.keypoints.count = keypoints;
    let read = match given.map(|g| g.join(&scene.name)).filter(|g| g.is_dir()) {
        Some(folder) => Some(pipeline::read_features(&folder, &scans, &Silent)?),
        None => None,
    };
    let source = read.as_deref().map_or(FeatureSource::Computed, FeatureSource::Given);
    let described = pipeline::describe(&scans, &config, &source, &Silent)?;
    let scale = described.scale;
    // Of the frames that surfaces and features are in.
    let truth: Vec<RigidMotion> = truth.iter().zip(&described.frames).map(|(pose, f)| pose * f).collect();
    let views: Vec<&[Point]> = described.surfaces.iter().map(|s| s.points.as_slice()).collect();
    let overlap = overlap_matrix(&views, &truth, scale.inlier_radius_m as f32)?;
    let lengths = Lengths { inlier_radius_m: scale.inlier_radius_m, voxel_m: scale.voxel_m };
    let (features, surfaces) = (described.features, described.surfaces);
    Ok(Scene { name: scene.name, features, surfaces, world_from_scan: truth, overlap, lengths })
}

/// Scenes whose names agree up to the last dash may show the same place: no unrelated scans.
fn place(name: &str) -> &str {
    name.rsplit_once('-').map_or(name, |n| n.0)
}

/// Labelled proposals between random groups of scene `s`, and between its scans and unrelated scans.
fn compare(scenes: &[Scene], s: usize, count: usize) -> Result<Vec<Example>, Failure> {
    let scene = &scenes[s];
    let n = scene.features.len();
    let mut rng = ChaCha8Rng::seed_from_u64(count as u64);
    rng.set_stream(s as u64);
    // A connected group of every other place: each scan after the first overlaps one before it.
    let elsewhere: Vec<(usize, Vec<(ScanId, RigidMotion)>)> = (0..scenes.len())
        .filter(|&o| place(&scenes[o].name) != place(&scene.name))
        .map(|o| {
            let mut taken = vec![false; scenes[o].features.len()];
            (o, random_group(&scenes[o], &mut taken, UNRELATED..=UNRELATED, &mut rng))
        })
        .collect();
    let unrelated: Vec<(usize, usize)> =
        elsewhere.iter().flat_map(|(o, members)| members.iter().map(|m| (*o, m.0.0))).collect();
    let all = scene.features.iter().chain(unrelated.iter().map(|&(o, i)| &scenes[o].features[i]));
    let features: Vec<Features> =
        all.map(|f| scanweave::descriptor::subsample_features(f, count, 0)).collect();
    let surfaces: Vec<&Surface> =
        scene.surfaces.iter().chain(unrelated.iter().map(|&(o, i)| &scenes[o].surfaces[i])).collect();
    let inputs: Vec<ScanInput<'_>> =
        features.iter().zip(&surfaces).map(|(features, surface)| ScanInput { features, surface }).collect();
    let config = Config::default();
    let settings = SurfaceVerification::default();
    let similarity = similarity_of(&features, &config.retrieval, None, 0, &Silent)?.0;
    let radius_m = scene.lengths.inlier_radius_m;
    let mut models: Vec<ScanModel<'_>> =
        surfaces.par_iter().map(|s| ScanModel::new(s, radius_m as f32, &config.registration)).collect();
    models.iter_mut().for_each(|model| model.set_borne_out(1.0));
    let verifier = Verifier::new(&models, &settings, radius_m);
    let usable: Vec<ScanId> = (0..inputs.len()).map(ScanId).collect();
    let pairs = most_similar_pairs(&similarity, &usable, AgglomerativeConfig::default().neighbours);
    let pairs =
        PairScorer::new(&inputs, &config.registration.estimator, 0).register(&pairs, &verifier, &Silent)?;
    let keypoints: Vec<_> = inputs.iter().map(|s| s.features.keypoints.as_slice()).collect();
    let mut examples = Vec::new();
    for round in 0..ROUNDS {
        let mut taken = vec![false; n];
        // The first round compares scans alone, as a registration starts.
        let alone = round == 0;
        let most = if alone { 1 } else { 16 };
        let mut groups: Vec<Vec<(ScanId, RigidMotion)>> = Vec::new();
        for _ in 0..if alone { n } else { 6 } {
            groups.push(random_group(scene, &mut taken, 1..=most, &mut rng));
        }
        groups.retain(|g| !g.is_empty());
        let own = groups.len();
        let mut first = n;
        for (_, members) in &elsewhere {
            let numbers = (first..first + members.len()).map(ScanId);
            let mut members = numbers.zip(members.iter().map(|m| m.1));
            first += members.len();
            let together = if alone { 1 } else { rng.random_range(1..=members.len()) };
            groups.push(members.by_ref().take(together).collect());
            groups.extend(members.map(|m| vec![m]));
        }
        let mut agglomeration =
            Agglomeration::of_groups(&verifier, &config.registration, keypoints.clone(), groups);
        agglomeration.add_pairs(pairs.clone());
        for (a, b, scored_hypotheses) in agglomeration.scored_hypotheses() {
            if a.min(b) >= own {
                continue;
            }
            // Poses of both groups are near the truth: the true motion is near the identity.
            let related = a.max(b) < own;
            for scored in scored_hypotheses {
                let label =
                    if related { judge(&scored, agglomeration.centre(b), radius_m) } else { Some(false) };
                if let (Some(right), true) = (label, scored.evidence.inliers >= 3) {
                    let (x, evidence) = (predictors(&scored.evidence), scored.evidence);
                    let sizes = (agglomeration.size(a), agglomeration.size(b));
                    examples.push(Example { x, right, evidence, sizes });
                }
            }
        }
    }
    Ok(examples)
}

/// A group of as many scans, if there are, each overlapping one before it, at poses a little off the truth.
fn random_group(
    scene: &Scene,
    taken: &mut [bool],
    sizes: std::ops::RangeInclusive<usize>,
    rng: &mut ChaCha8Rng,
) -> Vec<(ScanId, RigidMotion)> {
    let free: Vec<usize> = (0..taken.len()).filter(|&i| !taken[i]).collect();
    if free.is_empty() {
        return Vec::new();
    }
    let off = |rng: &mut ChaCha8Rng, scale: f64| Vector3::from_fn(|_, _| rng.random_range(-scale..scale));
    let radius_m = scene.lengths.inlier_radius_m;
    // Errors add up from each scan to the one it was found by, as they do in a registration.
    let first = free[rng.random_range(0..free.len())];
    taken[first] = true;
    let mut members = vec![(first, RigidMotion::identity())];
    let size = rng.random_range(sizes);
    while members.len() < size {
        let near = |m: usize, i: usize| scene.overlap.get(m, i) > 0.3;
        let mut next: Vec<(usize, RigidMotion)> = (0..taken.len())
            .filter(|&i| !taken[i])
            .filter_map(|i| members.iter().find(|m| near(m.0, i)).map(|m| (i, m.1)))
            .collect();
        next.shuffle(rng);
        let Some(&(i, error)) = next.first() else { break };
        taken[i] = true;
        let centre = scene.world_from_scan[i].translation;
        let wrong = centre * RigidMotion::new(off(rng, 0.35 * radius_m), off(rng, 0.012)) * centre.inverse();
        members.push((i, wrong * error));
    }
    members.into_iter().map(|(i, error)| (ScanId(i), error * scene.world_from_scan[i])).collect()
}

fn judge(scored: &ScoredHypothesis, centre: nalgebra::Point3<f64>, radius_m: f64) -> Option<bool> {
    let turned = scored.a_from_b.rotation.angle().to_degrees();
    let moved = (scored.a_from_b * centre - centre).norm();
    let within = |deg: f64, radii: f64| turned <= deg && moved <= radii * radius_m;
    if within(5.0, 3.0) {
        Some(true)
    } else if within(10.0, 6.0) {
        None
    } else {
        Some(false)
    }
}

/// Logistic regression by Newton's method with a light ridge.
fn fit<'a>(examples: impl Iterator<Item = &'a Example>) -> [f64; PREDICTORS] {
    let examples: Vec<&Example> = examples.collect();
    let mut w = DVector::<f64>::zeros(PREDICTORS);
    for _ in 0..50 {
        let (mut gradient, mut hessian) =
            (&w * 0.01, DMatrix::<f64>::identity(PREDICTORS, PREDICTORS) * 0.01);
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

fn report(name: &str, examples: &[Example], weights: &[f64; PREDICTORS]) {
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
    println!("{name}: {} proposals, {right} right, log loss {loss:.3}", judged.len());
    for threshold in [0.5, 0.8, 0.9, 0.95, 0.99] {
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
    println!("  right with_scan_count_prior p in {}", bins.join(", "));
}
