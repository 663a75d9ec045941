//! What a registration makes of collections that it should see through.
//!
//! `cargo run --release --example adversarial_scenes -- [SEEDS] [key=value …]`: for every trouble of
//! `synthetic::adversarial` the scans of so many seeds (three), registered with FPFH, with settings. A placed
//! scan is wrong when it lies wrong relative to most others of its component, or most of them are of
//! another place. Mirrored scans are of one place, the mirrored room.

use scanweave::Silent;
use scanweave::config::{Config, Layers};
use scanweave::geometry::RigidMotion;
use scanweave::pipeline::{self, FeatureSource};
use scanweave::scan::{Outcome, Reconstruction};
use scanweave::synthetic::{AdversarialSet, Trouble, adversarial_scans};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1).peekable();
    let seeds = arguments.next_if(|a| a.parse::<u64>().is_ok()).map_or(3, |a| a.parse().unwrap_or(3));
    let mut layers = Layers::new::<Config>();
    layers.add_assignment("descriptor.kind=fpfh")?;
    arguments.try_for_each(|assignment| layers.add_assignment(&assignment))?;
    let config: Config = layers.read()?;
    config.validate()?;
    println!("trouble          scans  with company  placed  declined  wrong  wrong above .9");
    for trouble in Trouble::ALL {
        let mut total = Counts::default();
        for seed in 0..seeds {
            let set = adversarial_scans(trouble, seed, &Silent)?;
            let run = pipeline::run(&set.scans, &config, &FeatureSource::Computed, &Silent)?;
            total.add(&set, &run.reconstruction, run.scale.inlier_radius_m);
        }
        let Counts { scans, company, placed, wrong, sure } = total;
        let name = format!("{trouble:?}");
        println!("{name:15} {scans:6} {company:13} {placed:7} {:9} {wrong:6} {sure:15}", scans - placed);
    }
    Ok(())
}

#[derive(Default)]
struct Counts {
    scans: usize,
    /// Scans of a place that others are of: those that can be placed.
    company: usize,
    placed: usize,
    wrong: usize,
    /// Wrong at a stated probability above .9.
    sure: usize,
}

impl Counts {
    fn add(&mut self, set: &AdversarialSet, reconstruction: &Reconstruction, radius_m: f64) {
        let n = set.scans.len();
        self.scans += n;
        let alone = |i: usize| (0..n).all(|j| j == i || set.place[j] != set.place[i]);
        self.company += (0..n).filter(|&i| !alone(i)).count();
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
                agree += usize::from(right && set.place[i] == set.place[j]);
                all += 1;
            }
            self.placed += 1;
            self.wrong += usize::from(2 * agree < all);
            self.sure += usize::from(2 * agree < all && *stated > 0.9);
        }
    }
}
