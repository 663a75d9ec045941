//! Settings of a training run.

use crate::descriptor::mini_spin_net::Architecture;
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of a training run. Real numbers are double precision so that they survive the JSON of a
/// checkpoint unchanged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Channels of the layer that every point goes through; a multiple of 16, as all channels.
    pub point_channels: usize,
    /// Output channels of the convolutions; those of the last are the descriptor's dimension.
    pub channels: Vec<usize>,
    /// Hidden channels of the attention.
    pub attention_channels: usize,
    /// Pairs of patches taken from each scene.
    pub pairs_per_scene: usize,
    /// How far, in patch radii, the two keypoints of a pair may be apart: those of two scans are
    /// chosen independently and never fall on the same spot.
    pub keypoint_offset: f64,
    /// Share of the flat patches that are kept: they look alike wherever they are.
    pub flat_share: f64,
    /// Steps of the run.
    pub steps: usize,
    /// Pairs in a step, half of them from each of two scenes.
    pub pairs_per_step: usize,
    /// Learning rate, the same for every step but the last ones: what a run of so many steps gives
    /// does not depend on how many more were planned.
    pub learning_rate: f64,
    /// Steps at the end over which the learning rate falls evenly towards nothing; 0 for none.
    #[serde(skip_serializing_if = "none")]
    pub cooldown: usize,
    /// How much of the average of past parameters a step keeps; the average is what is validated
    /// and used (it does the work of a falling learning rate).
    pub average: f64,
    /// Weight decay, added to the gradient as in PyTorch's Adam.
    pub weight_decay: f64,
    /// Adam's ε.
    pub epsilon: f64,
    /// γ of the circle loss.
    pub circle_scale: f64,
    /// m of the circle loss.
    pub circle_margin: f64,
    /// Pairs of one scene nearer than this are no negatives of each other, in patch radii.
    pub negative_radius: f64,
    /// Standard deviation of the noise on points, in patch radii, at most.
    pub noise: f64,
    /// Standard deviation of the axis's tilt, degrees.
    pub tilt_deg: f64,
    /// Smallest share of the points that a thinned patch keeps.
    pub keep_min: f64,
    /// Probability that a ball of up to half the radius is cut out of a patch.
    pub hole_chance: f64,
    /// Steps between checkpoints.
    pub checkpoint_every: usize,
    /// Steps between validations; a multiple of `checkpoint_every`.
    pub validate_every: usize,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            point_channels: 16,
            channels: vec![32; 6],
            attention_channels: 16,
            pairs_per_scene: 3000,
            keypoint_offset: 0.2,
            flat_share: 0.2,
            steps: 4000,
            pairs_per_step: 96,
            learning_rate: 2e-3,
            cooldown: 0,
            average: 0.98,
            weight_decay: 1e-5,
            epsilon: 1e-8,
            circle_scale: 24.0,
            circle_margin: 0.25,
            negative_radius: 0.5,
            noise: 0.02,
            tilt_deg: 4.0,
            keep_min: 0.4,
            hole_chance: 0.3,
            checkpoint_every: 50,
            validate_every: 200,
            seed: 0,
        }
    }
}

/// As for `serde`: what is not used is not written.
fn none(steps: &usize) -> bool {
    *steps == 0
}

impl TrainConfig {
    /// Learning rate of the step after `done` steps.
    pub fn learning_rate_after(&self, done: usize) -> f64 {
        let left = self.steps.saturating_sub(done);
        match left < self.cooldown {
            true => self.learning_rate * left as f64 / self.cooldown as f64,
            false => self.learning_rate,
        }
    }

    /// The network's channels.
    pub fn architecture(&self) -> Architecture {
        Architecture {
            point_channels: self.point_channels,
            channels: self.channels.clone(),
            attention_channels: self.attention_channels,
        }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// Names the first setting that cannot be used.
    pub fn validate(&self) -> Result<()> {
        let refuse = |key: &str, found: String, expected: &str| {
            Err(Error::setting(format!("train.{key}"), found, expected, "correct the training config"))
        };
        if let Some(fault) = self.architecture().fault() {
            return refuse("channels", fault, "multiples of 16");
        }
        let counts = [
            ("pairs_per_scene", self.pairs_per_scene, 2),
            ("steps", self.steps, 1),
            ("pairs_per_step", self.pairs_per_step, 4),
            ("checkpoint_every", self.checkpoint_every, 1),
            ("validate_every", self.validate_every, 1),
        ];
        if let Some((key, found, least)) = counts.into_iter().find(|&(_, v, least)| v < least) {
            return refuse(key, found.to_string(), &format!("at least {least}"));
        }
        if !self.validate_every.is_multiple_of(self.checkpoint_every) {
            let expected = format!("a multiple of checkpoint_every = {}", self.checkpoint_every);
            return refuse("validate_every", self.validate_every.to_string(), &expected);
        }
        let reals = [
            ("keypoint_offset", self.keypoint_offset, 0.0, 1.0),
            ("flat_share", self.flat_share, 0.0, 1.0),
            ("learning_rate", self.learning_rate, 1e-12, 1.0),
            ("average", self.average, 0.0, 0.9999),
            ("weight_decay", self.weight_decay, 0.0, 1.0),
            ("epsilon", self.epsilon, 1e-30, 1.0),
            ("circle_scale", self.circle_scale, 1e-3, 80.0),
            ("circle_margin", self.circle_margin, 0.0, 1.0),
            ("negative_radius", self.negative_radius, 0.0, 1e3),
            ("noise", self.noise, 0.0, 1.0),
            ("tilt_deg", self.tilt_deg, 0.0, 45.0),
            ("keep_min", self.keep_min, 0.01, 1.0),
            ("hole_chance", self.hole_chance, 0.0, 1.0),
        ];
        // A NaN lies in no range.
        match reals.into_iter().find(|&(_, v, low, high)| !(low..=high).contains(&v)) {
            None => Ok(()),
            Some((key, found, low, high)) => {
                refuse(key, found.to_string(), &format!("between {low} and {high}"))
            }
        }
    }
}
