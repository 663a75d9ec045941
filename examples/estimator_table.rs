//! How often and how fast the robust estimators find a motion, by the share of right matches.
//!
//! Usage: `cargo run --release --example estimator_table -- [--matches N] [--trials N]`
//!
//! Matches are points of a box of 4 m, a share of them moved by one random motion with 1 cm noise
//! (each coordinate uniform on ±1 cm), the others by nothing in common. A trial succeeds within 5°
//! and 0.2 m, with τ = 0.07 m. Prints success in percent and milliseconds a pair, one thread.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scanweave::geometry::{Point, RigidMotion};
use scanweave::geometry::{rotation_error_rad, translation_error_m};
use scanweave::registration::Matches;
use scanweave::registration::estimate;
use scanweave::registration::{EstimatorConfig, RansacConfig, SpatialCompatibilityConfig};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut count, mut trials) = (1000usize, 100u64);
    let mut arguments = std::env::args().skip(1);
    while let Some(a) = arguments.next() {
        let value = arguments.next().ok_or_else(|| format!("{a} needs a number"))?;
        match a.as_str() {
            "--matches" => count = value.parse()?,
            "--trials" => trials = value.parse()?,
            _ => return Err(format!("unknown argument {a}").into()),
        }
    }
    let estimators = [
        (
            "spatial compatibility, 200 seeds",
            EstimatorConfig::SpatialCompatibility(SpatialCompatibilityConfig::default()),
        ),
        ("RANSAC, 1000 triples", EstimatorConfig::Ransac(RansacConfig::default())),
        (
            "RANSAC, 10000 triples",
            EstimatorConfig::Ransac({
                let mut changed = RansacConfig::default();
                changed.hypotheses = 10_000;
                changed
            }),
        ),
    ];
    println!("{count} matches, {trials} trials: success %, ms a pair");
    println!("{:34} {:>14} {:>14} {:>14} {:>14}", "right matches", "5 %", "10 %", "20 %", "50 %");
    for (name, config) in estimators {
        let mut line = format!("{name:34}");
        for share in [0.05, 0.1, 0.2, 0.5] {
            let (mut found, mut seconds) = (0, 0.0);
            for seed in 0..trials {
                let (matches, truth) = scene(count, share, seed);
                let start = Instant::now();
                let best = estimate(&matches, &config, 0.07, seed).into_iter().next();
                seconds += start.elapsed().as_secs_f64();
                found += usize::from(best.is_some_and(|b| {
                    rotation_error_rad(&b.target_from_source, &truth).to_degrees() < 5.0
                        && translation_error_m(&b.target_from_source, &truth) < 0.2
                }));
            }
            let percent = 100.0 * found as f64 / trials as f64;
            line += &format!(" {percent:6.1} {:7.2}", 1e3 * seconds / trials as f64);
        }
        println!("{line}");
    }
    Ok(())
}

fn scene(count: usize, share: f64, seed: u64) -> (Matches, RigidMotion) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut point = |scale: f32| Point::from(Vector3::from_fn(|_, _| rng.random_range(-scale..scale)));
    let turn = point(1.8).coords.cast();
    let truth = RigidMotion::new(point(3.0).coords.cast(), turn);
    let right = (count as f64 * share) as usize;
    let mut matches = Matches::default();
    for i in 0..count {
        let source = point(2.0);
        let exact = (truth * source.cast::<f64>()).cast::<f32>();
        let target = if i < right { exact + point(0.01).coords } else { exact + point(2.0).coords * 2.0 };
        matches.pairs.push((i as u32, i as u32));
        matches.source.push(source);
        matches.target.push(target);
        matches.scores.push(0.0);
    }
    (matches, truth)
}
