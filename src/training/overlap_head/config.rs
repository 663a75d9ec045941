//! Settings of a training run.

use crate::retrieval::{BiasRule, SimilaritySource};
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where the NetVLAD centroids start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CentroidStart {
    /// k-means of the training descriptors.
    #[default]
    Kmeans,
    /// `U[0,1]`, as in the published code.
    Uniform,
}

/// Settings of a training run. Real numbers are double precision so that they survive the JSON of a
/// checkpoint unchanged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Kind of head; the mean has nothing to train.
    pub head: SimilaritySource,
    /// NetVLAD clusters K.
    pub clusters: usize,
    /// NetVLAD sharpness α of the starting assignment.
    pub alpha: f64,
    /// NetVLAD rule for the starting bias.
    pub bias: BiasRule,
    /// NetVLAD starting centroids.
    pub centroids: CentroidStart,
    /// Most descriptors used by k-means.
    pub kmeans_sample: usize,
    /// Most rounds of k-means.
    pub kmeans_rounds: usize,
    /// GeM starting exponent.
    pub gem_power: f64,
    /// Passes over the training scenes; one scene is one step.
    pub epochs: usize,
    /// Learning rate of the first epoch; it falls to 0 along half a cosine.
    pub learning_rate: f64,
    /// Weight decay, added to the gradient as in PyTorch's Adam.
    pub weight_decay: f64,
    /// Adam's ε.
    pub epsilon: f64,
    /// Share of descriptor values set to zero while training.
    pub dropout: f64,
    /// A scene with more scans than this is thinned to between this and `frames_max` of them.
    pub frames_min: usize,
    /// Most scans of a step.
    pub frames_max: usize,
    /// Fewest keypoints m of a crop.
    pub crop_min: usize,
    /// Most keypoints m of a crop.
    pub crop_max: usize,
    /// The crop's keypoints are drawn from this many times m nearest to its centre.
    pub crop_pool: f64,
    /// Distance within which a keypoint has a counterpart, metres.
    pub overlap_radius_m: f64,
    /// Scans whose whole keypoint sets overlap by no more than this have target 0, whatever their
    /// crops do.
    pub min_scan_overlap: f64,
    /// Epochs between validations.
    pub validate_every: usize,
    /// k of the validation's recall at k.
    pub recall_k: usize,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            head: SimilaritySource::Netvlad,
            clusters: 64,
            alpha: 10.0,
            bias: BiasRule::Norm,
            centroids: CentroidStart::Kmeans,
            kmeans_sample: 50_000,
            kmeans_rounds: 30,
            gem_power: 3.0,
            epochs: 300,
            learning_rate: 1e-3,
            weight_decay: 1e-4,
            epsilon: 1e-8,
            dropout: 0.3,
            frames_min: 8,
            frames_max: 59,
            crop_min: 1024,
            crop_max: 4999,
            crop_pool: 1.2,
            overlap_radius_m: 0.08,
            min_scan_overlap: 0.0,
            validate_every: 5,
            recall_k: 10,
            seed: 0,
        }
    }
}

impl TrainConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first setting that cannot be used.
    pub fn validate(&self) -> Result<()> {
        let refuse = |key: &str, found: String, expected: &str| {
            Err(Error::setting(format!("train.{key}"), found, expected, "correct the training config"))
        };
        if self.head == SimilaritySource::Mean {
            return refuse("head", "mean".into(), "netvlad or gem: the mean has nothing to train");
        }
        let counts = [
            ("clusters", self.clusters, 1),
            ("kmeans_sample", self.kmeans_sample, 1),
            ("epochs", self.epochs, 1),
            ("frames_min", self.frames_min, 2),
            ("frames_max", self.frames_max, self.frames_min),
            ("crop_min", self.crop_min, 1),
            ("crop_max", self.crop_max, self.crop_min),
            ("validate_every", self.validate_every, 1),
            ("recall_k", self.recall_k, 1),
        ];
        if let Some((key, found, least)) = counts.into_iter().find(|&(_, v, least)| v < least) {
            return refuse(key, found.to_string(), &format!("at least {least}"));
        }
        let reals = [
            ("alpha", self.alpha, f64::MIN_POSITIVE, 1e6),
            ("gem_power", self.gem_power, f64::MIN_POSITIVE, 1e3),
            ("learning_rate", self.learning_rate, f64::MIN_POSITIVE, 1.0),
            ("weight_decay", self.weight_decay, 0.0, 1.0),
            ("epsilon", self.epsilon, f64::MIN_POSITIVE, 1.0),
            ("dropout", self.dropout, 0.0, 0.999),
            ("crop_pool", self.crop_pool, 1.0, 1e6),
            ("overlap_radius_m", self.overlap_radius_m, f64::MIN_POSITIVE, 1e6),
            ("min_scan_overlap", self.min_scan_overlap, 0.0, 1.0),
        ];
        // A NaN lies in no range.
        match reals.into_iter().find(|&(_, v, low, high)| !(low..=high).contains(&v)) {
            None => Ok(()),
            Some((key, found, low, high)) if low > 0.0 && low < 1e-300 => {
                refuse(key, found.to_string(), &format!("above 0, at most {high}"))
            }
            Some((key, found, low, high)) => {
                refuse(key, found.to_string(), &format!("between {low} and {high}"))
            }
        }
    }

    /// Learning rate of an epoch, counted from 0: half a cosine from the full rate to nothing
    /// (Loshchilov and Hutter 2017, without restarts).
    pub fn learning_rate_at(&self, epoch: usize) -> f64 {
        let phase = std::f64::consts::PI * epoch as f64 / self.epochs as f64;
        0.5 * self.learning_rate * (1.0 + phase.cos())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_schedule_is_half_a_cosine() {
        let c = TrainConfig::default();
        assert_eq!(c.learning_rate_at(0), 1e-3);
        assert!((c.learning_rate_at(150) - 0.5e-3).abs() < 1e-15);
        assert!((c.learning_rate_at(100) - 0.75e-3).abs() < 1e-15);
        assert!(c.learning_rate_at(300).abs() < 1e-15);
    }

    #[test]
    fn unusable_settings_are_named() {
        assert!(TrainConfig::default().validate().is_ok());
        let message = |c: TrainConfig| c.validate().unwrap_err().to_string();
        let bad = TrainConfig { dropout: 1.0, ..TrainConfig::default() };
        assert!(message(bad).starts_with("train.dropout: found 1, expected between 0 and 0.999"));
        let bad = TrainConfig { learning_rate: f64::NAN, ..TrainConfig::default() };
        assert!(message(bad).starts_with("train.learning_rate: found NaN, expected above 0"));
        let bad = TrainConfig { crop_max: 10, ..TrainConfig::default() };
        assert!(message(bad).starts_with("train.crop_max: found 10, expected at least 1024"));
        let bad = TrainConfig { head: SimilaritySource::Mean, ..TrainConfig::default() };
        assert!(message(bad).starts_with("train.head: found mean"));
    }
}
