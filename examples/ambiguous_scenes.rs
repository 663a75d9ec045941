//! What a registration makes of places that look alike from one place to another.
//!
//! `cargo run --release --example ambiguous_scenes -- [SEEDS] [key=value …]`: for every place of
//! `synthetic::ambiguous` the scans of so many seeds (ten), registered with FPFH, with settings. A scan
//! is wrong when it lies wrong relative to most others of its component.

use scanweave::config::{Config, Layers};
use scanweave::geometry::RigidMotion;
use scanweave::pipeline::{self, FeatureSource};
use scanweave::scan::{Outcome, Reconstruction};
use scanweave::synthetic::ambiguous::{AmbiguousSet, Place, scans_of};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1).peekable();
    let seeds = arguments.next_if(|a| a.parse::<u64>().is_ok()).map_or(10, |a| a.parse().unwrap_or(10));
    let mut layers = Layers::new::<Config>();
    layers.add_assignment("descriptor.kind=fpfh")?;
    for assignment in arguments {
        layers.add_assignment(&assignment)?;
    }
    let config: Config = layers.read()?;
    println!(
        "place                 scans  placed  wrong  wrong above .9  pairs right %  median p of right, of wrong"
    );
    for place in Place::ALL {
        let (mut scans, mut probabilities) = (0, [Vec::new(), Vec::new()]);
        let (mut right_pairs, mut pairs) = (0, 0);
        for seed in 0..seeds {
            let set = scans_of(place, seed);
            let run = pipeline::run(&set.scans, &config, &FeatureSource::Computed, &scanweave::Silent)?;
            scans += set.scans.len();
            pairs += set.scans.len() * (set.scans.len() - 1) / 2;
            right_pairs += judge(&set, &run.reconstruction, run.scale.inlier_radius_m, &mut probabilities);
        }
        let [right, wrong] = &mut probabilities;
        println!(
            "{:20} {scans:6} {:7} {:6} {:15} {:14.1}  {:.3}, {:.3}",
            format!("{place:?}"),
            right.len() + wrong.len(),
            wrong.len(),
            wrong.iter().filter(|p| **p > 0.9).count(),
            100.0 * right_pairs as f64 / pairs as f64,
            median(right),
            median(wrong),
        );
    }
    Ok(())
}

/// Adds the stated probability of every placed scan to the right or to the wrong ones; right pairs.
fn judge(
    set: &AmbiguousSet,
    reconstruction: &Reconstruction,
    radius_m: f64,
    probabilities: &mut [Vec<f64>; 2],
) -> usize {
    let placed: Vec<Option<(usize, RigidMotion, f64)>> = reconstruction
        .outcomes
        .iter()
        .map(|o| match o {
            Outcome::Placed(p) => {
                let stated = p.evidence.and_then(|e| e.probability).unwrap_or(1.0);
                Some((p.component, p.world_from_scan, stated))
            }
            Outcome::Declined(_) => None,
        })
        .collect();
    let mut right_pairs = 0;
    for (i, one) in placed.iter().enumerate() {
        let Some((component, pose, stated)) = one else { continue };
        let (mut agree, mut all) = (0, 0);
        for (j, other) in placed.iter().enumerate() {
            let Some((_, other, _)) = other.as_ref().filter(|o| i != j && o.0 == *component) else {
                continue;
            };
            let truth = set.world_from_scan[i].inverse() * set.world_from_scan[j];
            let found = pose.inverse() * other;
            let off = (truth.translation.vector - found.translation.vector).norm();
            let right = off < 3.0 * radius_m && truth.rotation.angle_to(&found.rotation) < 0.1;
            agree += usize::from(right);
            all += 1;
            right_pairs += usize::from(right && i < j);
        }
        probabilities[usize::from(2 * agree < all)].push(*stated);
    }
    right_pairs
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
