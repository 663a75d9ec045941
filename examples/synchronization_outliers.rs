//! Robustness of the synchronisation methods to wrong edges.
//!
//! Usage: `cargo run --release --example synchronization_outliers -- [--weights LITS_FILE]`
//!
//! Pose graphs of 30 scans with half of all pairs as edges, 1° and 2 cm of noise per axis and an
//! increasing share of random motions among the edges. Prints, for every method (the learned one
//! where its weights are given), the mean over
//! ten graphs of the share of all pairs of scans whose relative pose is within 15° and 0.3 m
//! of the truth, and the median rotation error of these.

use scanweave::Silent;
use scanweave::geometry::{rotation_error_rad, translation_error_m};
use scanweave::scan::ScanId;
use scanweave::synchronization::{LitsWeights, Method, synchronize};
use scanweave::synthetic::{KnownPoseGraph, PoseGraphConfig};

const SHARES: [f64; 6] = [0.0, 0.1, 0.3, 0.5, 0.6, 0.7];
const GRAPHS: u64 = 10;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let lits = match std::env::args().skip(1).collect::<Vec<_>>().as_slice() {
        [] => None,
        [flag, file] if flag == "--weights" => Some(LitsWeights::load(file.as_ref())?),
        _ => return Err("usage: synchronization_outliers [--weights LITS_FILE]".into()),
    };
    print!("{:12}", "wrong edges");
    SHARES.iter().for_each(|s| print!("{:>16}", format!("{:.0} %", 100.0 * s)));
    println!();
    for method in Method::ALL.into_iter().filter(|&m| m != Method::Lits || lits.is_some()) {
        print!("{:12}", method.to_string());
        for outliers in SHARES {
            let (mut share, mut errors) = (0.0, Vec::new());
            for seed in 0..GRAPHS {
                let config = PoseGraphConfig {
                    rotation_noise_rad: 1f64.to_radians(),
                    translation_noise_m: 0.02,
                    outliers,
                    seed,
                    ..PoseGraphConfig::default()
                };
                let (right, all) = right_pairs(&config.generate(), method, lits.as_ref())?;
                share += right.len() as f64 / all as f64 / GRAPHS as f64;
                errors.extend(right);
            }
            errors.sort_by(f64::total_cmp);
            let median =
                errors.get(errors.len() / 2).map_or("–".to_owned(), |e| format!("{:.2}°", e.to_degrees()));
            print!("{:>16}", format!("{:.0} % {median}", 100.0 * share));
        }
        println!();
    }
    Ok(())
}

/// Rotation errors of the pairs that came out right, and the number of all pairs.
fn right_pairs(
    known: &KnownPoseGraph,
    method: Method,
    lits: Option<&LitsWeights>,
) -> scanweave::Result<(Vec<f64>, usize)> {
    let found = synchronize(&known.graph, method, lits, &Silent)?;
    let truth = &known.world_from_scan;
    let (mut right, mut all) = (Vec::new(), 0);
    for i in 0..truth.len() {
        for j in i + 1..truth.len() {
            all += 1;
            let Some(relative) = found.relative(ScanId(i), ScanId(j)) else { continue };
            let expected = truth[i].inverse() * truth[j];
            let rotation = rotation_error_rad(&relative, &expected);
            if rotation < 15f64.to_radians() && translation_error_m(&relative, &expected) < 0.3 {
                right.push(rotation);
            }
        }
    }
    Ok((right, all))
}
