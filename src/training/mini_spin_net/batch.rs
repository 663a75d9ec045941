//! What a step is computed from: patches, changed at random, and the points they pick.

use super::module::MAP;
use super::pairs::{PairScene, PatchPair};
use super::{TrainConfig, generator};
use crate::descriptor::mini_spin_net::{CELLS, GROUP, NEIGHBOURS, Patch, RADII, Sphere, Weights};
use nalgebra::{Rotation3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Pairs of a step: patches `[2 · pairs]`, first one of each pair, then the other of each.
pub struct Batch {
    /// The patches.
    pub patches: Vec<Patch>,
    /// `[pairs · pairs]`: whether the second patch of a column is a negative of the first of a row.
    pub negatives: Vec<bool>,
}

impl Batch {
    /// The pairs of a step, half of them from each of two scenes; they follow from the seed and
    /// the step's number alone.
    pub fn draw(scenes: &[PairScene], step: usize, config: &TrainConfig) -> Self {
        let mut rng = generator(config.seed, step as u64, 0);
        let mut chosen: Vec<(usize, &PatchPair)> = Vec::with_capacity(config.pairs_per_step);
        while chosen.len() < config.pairs_per_step {
            let scene = rng.random_range(0..scenes.len());
            let half = config.pairs_per_step.div_ceil(2).min(config.pairs_per_step - chosen.len());
            let pairs = &scenes[scene].pairs;
            chosen.extend((0..half).map(|_| (scene, &pairs[rng.random_range(0..pairs.len())])));
        }
        let patches = (0..2 * chosen.len()).into_par_iter().map(|at| {
            let (side, at) = (at / chosen.len(), at % chosen.len());
            let mut rng = generator(config.seed, step as u64, 1 + (2 * at + side) as u64);
            changed(&chosen[at].1.points[side], config, &mut rng)
        });
        let square = (config.negative_radius as f32).powi(2);
        let negatives = chosen.iter().flat_map(|(scene, a)| {
            chosen.iter().map(move |(other, b)| {
                let away: f32 = a.place.iter().zip(&b.place).map(|(a, b)| (a - b).powi(2)).sum();
                scene != other || away > square
            })
        });
        Self { patches: patches.collect(), negatives: negatives.collect() }
    }
}

/// A patch turned about its axis at random, tilted, thinned, cut and made noisy.
fn changed(points: &[[f32; 3]], config: &TrainConfig, rng: &mut ChaCha8Rng) -> Patch {
    let turn = rng.random_range(0.0..std::f32::consts::TAU);
    let tilt = (config.tilt_deg.to_radians() as f32) * Vector3::new(normal(rng), normal(rng), 0.0);
    let rotation = Rotation3::from_scaled_axis(tilt) * Rotation3::from_axis_angle(&Vector3::z_axis(), turn);
    let keep = rng.random_range(config.keep_min as f32..=1.0);
    let noise = rng.random_range(0.0..=config.noise as f32);
    let hole = (rng.random_range(0.0..1.0) < config.hole_chance && !points.is_empty()).then(|| {
        let centre = points[rng.random_range(0..points.len())];
        (Vector3::from(centre), rng.random_range(0.1f32..0.5))
    });
    let mut patch = Patch::default();
    let mut kept = Vec::with_capacity(points.len());
    for point in points {
        let point = Vector3::from(*point);
        let cut = hole.is_some_and(|(centre, radius)| (point - centre).norm() < radius);
        if !cut && rng.random_range(0.0f32..1.0) < keep {
            let moved = rotation * point + noise * Vector3::new(normal(rng), normal(rng), normal(rng));
            kept.push(moved.into());
        }
    }
    patch.fill(kept);
    patch
}

/// A standard normal number (Box and Muller).
fn normal(rng: &mut ChaCha8Rng) -> f32 {
    let (u, v): (f32, f32) = (rng.random_range(f32::MIN_POSITIVE..1.0), rng.random_range(0.0..1.0));
    (-2.0 * u.ln()).sqrt() * (std::f32::consts::TAU * v).cos()
}

/// For every patch, cell and channel of the point layer the point where the channel is largest:
/// `[n][elevation · azimuth][radius · channels][3]`. A cell with fewer neighbours than its number
/// has the zero vector among them.
pub fn picked(patches: &[Patch], weights: &Weights) -> Vec<f32> {
    let filter = weights.layers[0].folded().0;
    let by_axis: [Vec<f32>; 3] =
        std::array::from_fn(|axis| filter.iter().skip(axis).step_by(3).copied().collect());
    let sphere = Sphere::default();
    let (filter, sphere) = (&by_axis, &sphere);
    let of_patch = |patch: &Patch| pulp::Arch::new().dispatch(Pick { filter, sphere, patch });
    patches.par_iter().flat_map_iter(of_patch).collect()
}

/// [`picked`] for one patch, in the widest vectors the processor has.
struct Pick<'a> {
    filter: &'a [Vec<f32>; 3],
    sphere: &'a Sphere,
    patch: &'a Patch,
}

impl pulp::WithSimd for Pick<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<f32> {
        let [wx, wy, wz] = self.filter.each_ref().map(|w| w.as_chunks::<GROUP>().0);
        let channels = wx.len() * GROUP;
        let mut all = vec![0.0f32; CELLS * channels * 3];
        for cell in 0..CELLS {
            let (points, count) = self.sphere.neighbours(self.patch, cell);
            if count == 0 {
                continue;
            }
            let points = &points[..(count + 1).min(NEIGHBOURS)];
            let to = (cell % MAP * RADII + cell / MAP) * channels * 3;
            for (group, out) in all[to..][..channels * 3].chunks_exact_mut(GROUP * 3).enumerate() {
                let (mut best, mut which) = ([f32::NEG_INFINITY; GROUP], [0usize; GROUP]);
                for (at, [x, y, z]) in points.iter().enumerate() {
                    for lane in 0..GROUP {
                        let value = wx[group][lane] * x + wy[group][lane] * y + wz[group][lane] * z;
                        if value > best[lane] {
                            (best[lane], which[lane]) = (value, at);
                        }
                    }
                }
                for (out, which) in out.chunks_exact_mut(3).zip(which) {
                    out.copy_from_slice(&points[which]);
                }
            }
        }
        all
    }
}
