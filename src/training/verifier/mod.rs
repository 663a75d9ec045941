//! The verifier: the weights that turn the evidence of a relative pose into a probability, learned from
//! candidates of many kinds of scans.
//!
//! ```text
//! 1  collect: every hypothesis of every registered pair of a kind's collections, with its evidence as
//!    a registration has it, and whether the true poses make it right          candidates.rs
//! 2  fit: monotone logistic regression, a ridge toward given weights          fit.rs
//! 3  judge: every kind by weights that were fitted to all others              report.rs
//! ```

mod candidates;
mod fit;
mod report;

pub use candidates::{Candidate, KindCandidates, collect};
pub use fit::fit;
pub use report::{Accepted, Judgement, KindRow, ReliabilityBin, VerifierReport};

use crate::Monitor;
use crate::config::Layers;
use crate::descriptor::{DescriptorConfig, DescriptorKind, KeypointConfig};
use crate::registration::EvidenceWeights;
use crate::synthetic::ambiguous::Place;
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Everything that decides a trained verifier: features, fit, and what it is trained on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct VerifierRecipe {
    /// Seed of the registrations.
    pub seed: u64,
    /// Strength of the ridge toward `given`, in nats for one standard deviation of a predictor squared. Much
    /// of it keeps the given weights, and `inf` keeps them whole.
    pub ridge: f64,
    /// Seeds of every synthetic place.
    pub synthetic_seeds: Vec<u64>,
    /// Synthetic places, one kind each; all where not given.
    pub synthetic_places: Vec<Place>,
    /// Weights that the ridge draws to, and that the candidates are found with.
    pub given: EvidenceWeights,
    /// Keypoints and local descriptors.
    pub descriptor: DescriptorConfig,
    /// Kinds of scans.
    pub kinds: Vec<KindEntry>,
}

/// Collections of one kind: together they weigh as much as those of any other kind.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct KindEntry {
    /// What tables call it.
    pub name: String,
    /// Folders of scans with true poses, below the data root; one collection each.
    pub folders: Vec<PathBuf>,
}

impl Default for VerifierRecipe {
    fn default() -> Self {
        Self {
            seed: 0,
            ridge: 1.0,
            synthetic_seeds: vec![0, 1],
            synthetic_places: Place::ALL.to_vec(),
            given: EvidenceWeights::default(),
            descriptor: {
                let mut changed = DescriptorConfig::default();
                changed.kind = DescriptorKind::Fpfh;
                changed.keypoints = KeypointConfig::new(1500);
                changed
            },
            kinds: Vec::new(),
        }
    }
}

impl VerifierRecipe {
    /// Reads a recipe. An unknown key is an error that names the nearest one.
    ///
    /// # Errors
    /// [`Error::Read`], and [`Error::Setting`] naming file and key.
    pub fn load(path: &Path) -> Result<Self> {
        let mut layers = Layers::new::<Self>();
        layers.add_file(path)?;
        let recipe: Self = layers.read()?;
        recipe.validate().map(|()| recipe)
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        self.descriptor.validate()?;
        if self.ridge.is_nan() || self.ridge < 0.0 {
            return Err(refusal("ridge", self.ridge.to_string(), "0 or more"));
        }
        let weights = self.given.as_array().into_iter().zip(EvidenceWeights::SIGNS);
        for ((weight, sign), name) in weights.zip(EvidenceWeights::NAMES) {
            if !weight.is_finite() || weight * sign < 0.0 {
                let expected = match sign {
                    0.0 => "a finite weight",
                    s if s > 0.0 => "a weight of 0 or more: more of it makes a pose more probable",
                    _ => "a weight of 0 or less: more of it makes a pose less probable",
                };
                return Err(refusal(&format!("given.{name}"), weight.to_string(), expected));
            }
        }
        let mut names = self.synthetic_kinds().map(|p| p.name()).collect::<Vec<_>>();
        for (at, kind) in self.kinds.iter().enumerate() {
            if kind.name.trim().is_empty() || names.contains(&kind.name.as_str()) {
                let expected = "a name that no other kind has, synthetic places included";
                return Err(refusal(&format!("kinds[{at}].name"), format!("`{}`", kind.name), expected));
            }
            names.push(&kind.name);
            if kind.folders.is_empty() {
                return Err(refusal(&format!("kinds[{at}].folders"), "no folder".into(), "at least one"));
            }
            // The recipe is part of what is shipped, which names no place on a machine.
            if let Some(folder) = kind.folders.iter().find(|f| f.is_absolute()) {
                let found = folder.display().to_string();
                return Err(refusal(
                    &format!("kinds[{at}].folders"),
                    found,
                    "folders relative to --data-root",
                ));
            }
        }
        if names.len() < 2 {
            let found = format!("{} of them", names.len());
            return Err(refusal(
                "kinds",
                found,
                "at least two kinds: each is judged by weights of the others",
            ));
        }
        Ok(())
    }

    /// As a TOML file that gives the same recipe back.
    ///
    /// # Errors
    /// [`Error::Setting`] for a value TOML has no spelling for (a path that is not UTF-8).
    pub fn to_toml(&self) -> Result<String> {
        super::recipe_toml(self)
    }

    /// Synthetic places that there are scans of.
    fn synthetic_kinds(&self) -> impl Iterator<Item = Place> + '_ {
        self.synthetic_places.iter().copied().filter(|_| !self.synthetic_seeds.is_empty())
    }
}

fn refusal(key: &str, found: String, expected: &str) -> Error {
    Error::setting(key, found, expected, "correct the recipe")
}

/// Trains and judges a verifier. Relative folders lie under `root`. The result depends on the recipe
/// and the scans alone, not on the number of threads.
///
/// # Errors
/// Data that cannot be read or has no poses, kinds without a candidate to learn from, or the user asked
/// to stop.
pub fn train(recipe: &VerifierRecipe, root: &Path, monitor: &dyn Monitor) -> Result<VerifierReport> {
    recipe.validate()?;
    // 1
    let kinds = collect(recipe, root, monitor)?;
    if kinds.iter().filter(|k| !k.candidates.is_empty()).count() < 2 {
        return Err(Error::input(
            "the recipe",
            "fewer than two kinds with a candidate of enough inliers",
            "overlapping scans of at least two kinds",
            "add kinds or keypoints",
        ));
    }
    // 2, 3
    Ok(VerifierReport::new(recipe, &kinds))
}

#[cfg(test)]
mod tests;
