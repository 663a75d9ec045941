//! What a registration makes of places that look alike from one place to another.
//!
//! `cargo run --release --example ambiguous_scenes -- [SEEDS] [--rough SHARE,DEG] [--upright DEG] [key=value …]`:
//! for every place of `synthetic::ambiguous` the scans of so many seeds (ten), registered with FPFH, with
//! settings. A scan is wrong when it lies wrong relative to most others of its component.
//!
//! `--rough` gives every scan its true pose, off by normal errors with a deviation of this share of the
//! size of a scan along each axis and so many degrees about each; `--upright` turns the coordinates of every
//! scan so that z points up, off by so many degrees about each horizontal axis.

use nalgebra::{Translation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scanweave::config::{Config, Layers};
use scanweave::geometry::RigidMotion;
use scanweave::pipeline::{self, FeatureSource};
use scanweave::registration::Axis;
use scanweave::scan::{Outcome, Reconstruction, Scan};
use scanweave::synthetic::{AmbiguousSet, Place, ambiguous_scans};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1).peekable();
    let seeds = arguments.next_if(|a| a.parse::<u64>().is_ok()).map_or(10, |a| a.parse().unwrap_or(10));
    let mut layers = Layers::new::<Config>();
    layers.add_assignment("descriptor.kind=fpfh")?;
    let mut known = Known::default();
    while let Some(assignment) = arguments.next() {
        if assignment == "--rough" {
            let value = arguments.next().unwrap_or_default();
            let (share, degrees) = value.split_once(',').ok_or("--rough takes SHARE,DEG")?;
            known.rough = Some((share.parse()?, degrees.parse()?));
            continue;
        }
        if assignment == "--upright" {
            known.upright_deg = Some(arguments.next().unwrap_or_default().parse()?);
            continue;
        }
        layers.add_assignment(&assignment)?;
    }
    let config: Config = layers.read()?;
    config.validate()?;
    println!(
        "place                 scans  placed  wrong  wrong above .9  pairs right %  median p of right, of wrong"
    );
    for place in Place::ALL {
        let (mut scans, mut probabilities) = (0, [Vec::new(), Vec::new()]);
        let (mut right_pairs, mut pairs) = (0, 0);
        for seed in 0..seeds {
            let (set, config) = known.of(ambiguous_scans(place, seed), &config, seed);
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

/// What is known of poses before.
#[derive(Default)]
struct Known {
    rough: Option<(f64, f64)>,
    upright_deg: Option<f64>,
}

impl Known {
    /// The set and the settings with it.
    fn of(&self, mut set: AmbiguousSet, config: &Config, seed: u64) -> (AmbiguousSet, Config) {
        let mut config = config.clone();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // The sum of twelve even numbers of variance 1/12.
        let mut normal = || (0..12).map(|_| rng.random_range(-0.5f64..0.5)).sum::<f64>();
        let mut normals = |deviation: f64| Vector3::from_fn(|_, _| deviation * normal());
        if let Some(degrees) = self.upright_deg {
            config.registration.prior.up = Some(Axis::Z);
            config.registration.prior.tilt_deviation_deg = degrees;
            for (scan, world_from_scan) in set.scans.iter_mut().zip(&mut set.world_from_scan) {
                let tilt = normals(degrees.to_radians()).component_mul(&Vector3::new(1.0, 1.0, 0.0));
                let turn = RigidMotion::rotation(Vector3::z() * normals(2.0).z);
                let turned_from_scan = RigidMotion::rotation(tilt) * turn * rotation_of(world_from_scan);
                let moved =
                    |p: &scanweave::geometry::Point| (turned_from_scan * p.cast::<f64>()).coords.into();
                let points: Vec<[f64; 3]> = scan.cloud.points.iter().map(moved).collect();
                *scan = Scan { id: scan.id, ..Scan::from_points(scan.name.clone(), &points) };
                *world_from_scan *= turned_from_scan.inverse();
            }
        }
        if let Some((share, degrees)) = self.rough {
            let sizes = set.scans.iter().map(|s| size(&s.cloud.points));
            let deviation_m = share * sizes.sum::<f64>() / set.scans.len() as f64;
            let prior = &mut config.registration.prior;
            prior.initial_poses = true;
            prior.position_deviation_m = Some(deviation_m);
            prior.rotation_deviation_deg = degrees;
            for (scan, world_from_scan) in set.scans.iter_mut().zip(&set.world_from_scan) {
                let off = RigidMotion::new(normals(deviation_m), Vector3::zeros())
                    * world_from_scan
                    * RigidMotion::rotation(normals(degrees.to_radians()));
                scan.initial_pose = Some(off);
            }
        }
        (set, config)
    }
}

fn rotation_of(motion: &RigidMotion) -> RigidMotion {
    RigidMotion::from_parts(Translation3::identity(), motion.rotation)
}

/// Root mean square distance of points from their mean, metres.
fn size(points: &[scanweave::geometry::Point]) -> f64 {
    let n = points.len().max(1) as f64;
    let mean = points.iter().map(|p| p.coords.cast::<f64>()).sum::<Vector3<f64>>() / n;
    (points.iter().map(|p| (p.coords.cast::<f64>() - mean).norm_squared()).sum::<f64>() / n).sqrt()
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
