//! Input of one training step: crops of one scene's scans, and their true overlap.

use super::TrainConfig;
use super::targets::overlap_matrix;
use crate::geometry::PointMover;
use crate::geometry::{Point, RigidMotion};
use crate::random::generator;
use crate::scan::{Features, SimilarityMatrix};
use crate::{Error, Result};
use rand::RngExt;
use rand::seq::SliceRandom;
use rayon::prelude::*;

/// Posed scans of one scene. How the features and poses get here is the caller's business.
#[derive(Debug, Clone)]
pub struct TrainingScene {
    /// Name for the log and the checkpoint.
    pub name: String,
    /// Features of every scan.
    pub features: Vec<Features>,
    /// Pose of every scan in the scene's frame.
    pub world_from_scan: Vec<RigidMotion>,
}

/// A scene with what every step needs of it.
pub(super) struct PreparedScene<'a> {
    scene: &'a TrainingScene,
    /// Keypoints in the scene's frame, shifted to its first scan so that single precision holds.
    world: Vec<Vec<Point>>,
    /// Scans that have keypoints.
    usable: Vec<usize>,
    /// True overlap of the whole scans, where the config asks for it.
    full: Option<SimilarityMatrix>,
}

/// One step's input.
pub(super) struct Batch {
    /// Row-major descriptors `[m·D]` of every crop, after dropout.
    pub crops: Vec<Vec<f32>>,
    /// Target of pair (i, j).
    pub targets: SimilarityMatrix,
}

impl TrainingScene {
    /// Keypoints of all scans in the scene's frame, relative to the first scan's position.
    pub(super) fn world_keypoints(&self) -> Vec<Vec<Point>> {
        let shift = self.world_from_scan.first().map(|p| p.translation.vector).unwrap_or_default();
        let place = |(f, pose): (&Features, &RigidMotion)| {
            let mut pose = *pose;
            pose.translation.vector -= shift;
            PointMover::new(&pose).points(&f.keypoints)
        };
        self.features.iter().zip(&self.world_from_scan).map(place).collect()
    }

    fn check(&self, dim: usize) -> Result<()> {
        let subject = format!("training scene {}", self.name);
        if self.features.len() != self.world_from_scan.len() {
            return Err(Error::input(
                subject,
                format!("{} scans and {} poses", self.features.len(), self.world_from_scan.len()),
                "one pose a scan",
                "complete the scene or leave it out",
            ));
        }
        if let Some((i, f)) =
            self.features.iter().enumerate().find(|(_, f)| !f.is_empty() && f.descriptors.dim() != dim)
        {
            return Err(Error::input(
                subject,
                format!("{} descriptor dimensions in scan {i}", f.descriptors.dim()),
                format!("{dim}"),
                "compute the features of all scenes with one descriptor",
            ));
        }
        let usable = self.features.iter().filter(|f| !f.is_empty()).count();
        if usable < 2 {
            return Err(Error::input(
                subject,
                format!("{usable} scans with keypoints"),
                "at least 2",
                "leave the scene out",
            ));
        }
        Ok(())
    }
}

impl<'a> PreparedScene<'a> {
    pub fn new(scene: &'a TrainingScene, dim: usize, config: &TrainConfig) -> Result<Self> {
        scene.check(dim)?;
        let world = scene.world_keypoints();
        let usable = (0..world.len()).filter(|&i| !world[i].is_empty()).collect();
        // Crops of scans that do not touch cannot touch either: only a threshold needs the whole.
        let full = (config.min_scan_overlap > 0.0)
            .then(|| overlap_matrix(&world, config.overlap_radius_m as f32))
            .transpose()?;
        Ok(Self { scene, world, usable, full })
    }

    /// Draws the input of step `step`; the same step always draws the same.
    pub fn batch(&self, step: usize, config: &TrainConfig) -> Result<Batch> {
        let scans = self.draw_scans(step, config);
        let drawn: Vec<(Vec<Point>, Vec<f32>)> =
            scans.par_iter().map(|&scan| self.draw_crop(scan, step, config)).collect();
        let (points, crops): (Vec<_>, Vec<_>) = drawn.into_iter().unzip();
        let targets = overlap_matrix(&points, config.overlap_radius_m as f32)?;
        Ok(Batch { crops, targets: self.without_apart(targets, &scans, config)? })
    }

    /// All scans up to `frames_min` of them, else a random number of random ones.
    fn draw_scans(&self, step: usize, config: &TrainConfig) -> Vec<usize> {
        let mut scans = self.usable.clone();
        if scans.len() > config.frames_min {
            let mut rng = generator(config.seed, "scans of a step", step as u64);
            let count = rng.random_range(config.frames_min..=config.frames_max);
            scans.shuffle(&mut rng);
            scans.truncate(count);
        }
        scans
    }

    /// Random centre keypoint, its `crop_pool`·m nearest keypoints, m of those at random.
    fn draw_crop(&self, scan: usize, step: usize, config: &TrainConfig) -> (Vec<Point>, Vec<f32>) {
        let mut rng = generator(config.seed, &format!("crop of step {step}"), scan as u64);
        let features = &self.scene.features[scan];
        let m = rng.random_range(config.crop_min..=config.crop_max);
        let center = features.keypoints[rng.random_range(0..features.len())];
        let pool = ((config.crop_pool * m as f64) as usize).clamp(m, features.len().max(m));
        let distance = |i: usize| ((features.keypoints[i] - center).norm_squared(), i);
        let mut near: Vec<(f32, usize)> = (0..features.len()).map(distance).collect();
        let order = |a: &(f32, usize), b: &(f32, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        let mut kept: Vec<usize> = if pool < near.len() {
            // Those before the first that is left out, in the order of the scan: no sorting.
            let beyond = *near.select_nth_unstable_by(pool, order).1;
            (0..features.len()).filter(|&i| order(&distance(i), &beyond).is_lt()).collect()
        } else {
            (0..features.len()).collect()
        };
        let (kept, _) = kept.partial_shuffle(&mut rng, m);
        let mut values = Vec::with_capacity(kept.len() * features.descriptors.dim());
        kept.iter().for_each(|&i| values.extend_from_slice(features.descriptors.row(i)));
        drop_out(&mut values, config.dropout, &mut rng);
        (kept.iter().map(|&i| self.world[scan][i]).collect(), values)
    }

    fn without_apart(
        &self,
        targets: SimilarityMatrix,
        scans: &[usize],
        config: &TrainConfig,
    ) -> Result<SimilarityMatrix> {
        let Some(full) = &self.full else { return Ok(targets) };
        let n = scans.len();
        let value = |i: usize, j: usize| {
            let apart = f64::from(full.get(scans[i], scans[j])) <= config.min_scan_overlap;
            if apart { 0.0 } else { targets.get(i, j) }
        };
        SimilarityMatrix::new(n, (0..n * n).map(|at| value(at / n, at % n)).collect())
    }
}

/// Sets a share of the values to zero. The usual 1/(1 − share) is left out: the heads scale every
/// descriptor to unit length next. The share is exact to 1/65536.
fn drop_out(values: &mut [f32], share: f64, rng: &mut impl RngExt) {
    if share > 0.0 {
        let below = (share * 65536.0).round() as u16;
        let mut draws = vec![0u16; values.len()];
        rng.fill(&mut draws[..]);
        // A choice between two values instead of a branch mispredicted every third time.
        values.iter_mut().zip(&draws).for_each(|(v, &draw)| *v = if draw < below { 0.0 } else { *v });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Descriptors;

    /// Twelve scans of 400 points each on a line, every one half a length further, posed apart.
    fn scene() -> TrainingScene {
        let mut features = Vec::new();
        let mut poses = Vec::new();
        for i in 0..12 {
            let points: Vec<Point> = (0..400).map(|k| Point::new(k as f32 * 0.01, 0.0, 0.0)).collect();
            let values = (0..400).flat_map(|k| [k as f32 + 1.0, 1.0]).collect();
            features.push(Features::new(points, None, Descriptors::new(2, values).unwrap()).unwrap());
            poses.push(RigidMotion::translation(1000.0 + 2.0 * f64::from(i), 0.0, 0.0));
        }
        TrainingScene { name: "line".into(), features, world_from_scan: poses }
    }

    fn config() -> TrainConfig {
        TrainConfig {
            crop_min: 100,
            crop_max: 100,
            frames_max: 10,
            overlap_radius_m: 0.004,
            ..TrainConfig::default()
        }
    }

    #[test]
    fn a_crop_is_m_of_the_nearest_and_repeats_with_its_step() {
        let scene = scene();
        let c = TrainConfig { dropout: 0.0, ..config() };
        let prepared = PreparedScene::new(&scene, 2, &c).unwrap();
        for step in 0..20 {
            let (points, values) = prepared.draw_crop(0, step, &c);
            assert_eq!((points.len(), values.len()), (100, 200));
            let mut rows: Vec<usize> = values.chunks_exact(2).map(|v| v[0] as usize - 1).collect();
            // Point and descriptor stay together.
            for (p, &row) in points.iter().zip(&rows) {
                assert!((p.x - row as f32 * 0.01).abs() < 1e-4);
            }
            rows.sort_unstable();
            rows.dedup();
            // Without replacement, from the 120 nearest on a line: they span at most 120 rows.
            assert!(rows.len() == 100 && rows[99] - rows[0] < 120, "{rows:?}");
            assert_eq!(prepared.draw_crop(0, step, &c).1, values);
        }
        assert_ne!(prepared.draw_crop(0, 0, &c).1, prepared.draw_crop(0, 1, &c).1);
    }

    #[test]
    fn steps_take_the_right_number_of_scans() {
        let scene = scene();
        let prepared = PreparedScene::new(&scene, 2, &config()).unwrap();
        let counts: Vec<usize> = (0..200).map(|s| prepared.draw_scans(s, &config()).len()).collect();
        assert_eq!((counts.iter().min(), counts.iter().max()), (Some(&8), Some(&10)));
        let small = TrainConfig { frames_min: 12, frames_max: 12, ..config() };
        assert_eq!(prepared.draw_scans(0, &small), (0..12).collect::<Vec<_>>());
    }

    #[test]
    fn targets_are_the_overlap_of_the_crops_and_zero_where_scans_are_apart() {
        let scene = scene();
        // m as large as the scan: the crop is the scan, neighbours share half of it.
        let c = TrainConfig { crop_min: 400, crop_max: 400, frames_min: 12, frames_max: 12, ..config() };
        let whole = PreparedScene::new(&scene, 2, &c).unwrap().batch(0, &c).unwrap().targets;
        assert!((whole.get(3, 4) - 0.5).abs() < 1e-6);
        assert_eq!(whole.get(3, 5), 0.0);
        let strict = TrainConfig { min_scan_overlap: 0.6, ..c };
        let none = PreparedScene::new(&scene, 2, &strict).unwrap().batch(0, &strict).unwrap().targets;
        assert!((0..12).all(|i| none.row(i).iter().all(|&v| v == 0.0)));
    }

    #[test]
    fn dropout_zeroes_its_share() {
        let mut values = vec![1.0f32; 100_000];
        drop_out(&mut values, 0.3, &mut generator(1, "test", 0));
        let zeros = values.iter().filter(|&&v| v == 0.0).count() as f64 / 1e5;
        // Standard deviation of the share: 0.00145.
        assert!((zeros - 0.3).abs() < 0.006, "{zeros}");
    }

    #[test]
    fn scenes_that_cannot_be_used_say_why() {
        let mut short = scene();
        short.world_from_scan.pop();
        let message = |s: &TrainingScene, d| PreparedScene::new(s, d, &config()).err().unwrap().to_string();
        assert!(message(&short, 2).contains("training scene line: found 12 scans and 11 poses"));
        assert!(message(&scene(), 3).contains("2 descriptor dimensions in scan 0"));
    }
}
