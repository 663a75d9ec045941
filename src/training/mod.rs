//! From a training recipe to training data: posed scans of every kind, through the same stages as
//! a registration.

pub(crate) mod descriptor;
mod entries;
mod fragments;
pub mod mini_spin_net;
pub mod overlap_head;
pub(crate) mod run_folder;
mod synthetic_scenes;
pub mod verifier;

pub use entries::{RgbdEntry, ScenesEntry, Split, SynthEntry};

use crate::Monitor;
use crate::config::{Config, Layers};
use crate::descriptor::DescriptorConfig;
use crate::geometry::RigidMotion;
use crate::pipeline::{self, FeatureSource};
use crate::preprocessing::ScaleConfig;
use crate::retrieval::DescriptorTag;
use crate::scan::Scan;
use crate::training::overlap_head::{TrainConfig, TrainingData, TrainingScene};
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Everything that decides a trained head: settings, features, and what it is trained on.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Recipe {
    /// Settings of the training itself.
    pub train: TrainConfig,
    /// Lengths; those not given are chosen from the scans of every scene, as in a registration.
    pub scale: ScaleConfig,
    /// Keypoints and local descriptors.
    pub descriptor: DescriptorConfig,
    /// Folders of posed scans.
    pub scenes: Vec<ScenesEntry>,
    /// Depth images with poses, fused into scans.
    pub rgbd: Vec<RgbdEntry>,
    /// Synthetic buildings, made where they are not in the cache.
    pub synth: Vec<SynthEntry>,
}

/// Scans of one scene with their true poses.
struct PosedScans {
    name: String,
    scans: Vec<Scan>,
    world_from_scan: Vec<RigidMotion>,
}

impl Recipe {
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
        self.train.validate()?;
        self.scale.validate()?;
        self.descriptor.validate()?;
        check_entries(&self.scenes, &self.rgbd, &self.synth)
    }

    /// As a TOML file that gives the same recipe back.
    ///
    /// # Errors
    /// [`Error::Setting`] for a value TOML has no spelling for (a path that is not UTF-8).
    pub fn to_toml(&self) -> Result<String> {
        recipe_toml(self)
    }

    /// The settings that a registration computes the same features with.
    fn features(&self) -> Config {
        let mut config = Config::default();
        config.seed = self.train.seed;
        config.scale = self.scale.clone();
        config.descriptor = self.descriptor.clone();
        config
    }
}

/// Checks the data tables of a recipe.
fn check_entries(scenes: &[ScenesEntry], rgbd: &[RgbdEntry], synth: &[SynthEntry]) -> Result<()> {
    rgbd.iter().try_for_each(RgbdEntry::validate)?;
    synth.iter().try_for_each(SynthEntry::validate)?;
    let splits = scenes.iter().map(|e| e.split).chain(rgbd.iter().map(|e| e.split));
    if splits.chain(synth.iter().map(|e| e.split)).any(|s| s == Split::Train) {
        return Ok(());
    }
    Err(Error::setting(
        "recipe",
        "no training data",
        "at least one [[scenes]], [[rgbd]] or [[synth]] table with split = \"train\"",
        "add one",
    ))
}

fn recipe_toml<T: Serialize>(recipe: &T) -> Result<String> {
    toml::to_string(recipe).map_err(|e| {
        Error::setting("recipe", e.to_string(), "values that TOML can hold", "use plain UTF-8 paths")
    })
}

type Entries<'a> = (&'a [ScenesEntry], &'a [RgbdEntry], &'a [SynthEntry]);

/// Hands every scene of the data tables to `take`, one after another; synthetic buildings are kept
/// where features are.
fn each_scene(
    (scenes, rgbd, synth): Entries<'_>,
    root: &Path,
    source: &FeatureSource<'_>,
    monitor: &dyn Monitor,
    mut take: impl FnMut(Split, PosedScans) -> Result<()>,
) -> Result<()> {
    for entry in scenes {
        for folder in &entry.folders {
            take(entry.split, entries::read_posed(&root.join(folder), monitor)?)?;
        }
    }
    for entry in rgbd {
        take(entry.split, fragments::fuse(entry, root, monitor)?)?;
    }
    let cache = match source {
        FeatureSource::Cached(folder) => Some(*folder),
        _ => None,
    };
    for entry in synth {
        for &seed in &entry.seeds {
            take(entry.split, synthetic_scenes::building(entry, seed, cache, monitor)?)?;
        }
    }
    Ok(())
}

/// Scans of all scenes of a recipe, posed and described. Relative folders lie under `root`;
/// synthetic buildings are kept where features are.
///
/// # Errors
/// Data that cannot be read or has no poses, scenes whose descriptors mean different things, or
/// the user asked to stop.
pub fn load(
    recipe: &Recipe,
    root: &Path,
    source: &FeatureSource<'_>,
    monitor: &dyn Monitor,
) -> Result<TrainingData> {
    recipe.validate()?;
    let mut data = TrainingData::default();
    let add = |split: Split, posed: PosedScans| -> Result<()> {
        let (scene, tag) = described(posed, recipe, source, monitor)?;
        if data.descriptor.dim == 0 {
            data.descriptor = tag;
        } else if data.descriptor != tag {
            return Err(Error::input(
                format!("scene {}", scene.name),
                format!("descriptors `{}` with settings {}", tag.name, tag.settings_hash),
                format!("settings {} as in the scenes before", data.descriptor.settings_hash),
                "leave out scale.normal_radius_m and scale.feature_radius_m, or give scale.voxel_m with them",
            ));
        }
        match split {
            Split::Train => data.train.push(scene),
            Split::Valid => data.valid.push(scene),
        }
        Ok(())
    };
    each_scene((&recipe.scenes, &recipe.rgbd, &recipe.synth), root, source, monitor, add)?;
    Ok(data)
}

fn described(
    posed: PosedScans,
    recipe: &Recipe,
    source: &FeatureSource<'_>,
    monitor: &dyn Monitor,
) -> Result<(TrainingScene, DescriptorTag)> {
    let PosedScans { name, scans, world_from_scan } = posed;
    let config = recipe.features();
    let described = pipeline::describe(&scans, &config, source, monitor)?;
    let Some(tag) = pipeline::descriptor_tag(&config, &described.scale, &described.features)? else {
        return Err(Error::input(
            format!("scene {name}"),
            "no keypoint in any scan",
            "scans of some extent",
            "leave the scene out",
        ));
    };
    // Features are in frames of their own.
    let world_from_scan = world_from_scan.iter().zip(&described.frames).map(|(pose, frame)| pose * frame);
    let world_from_scan = world_from_scan.collect();
    Ok((TrainingScene { name, features: described.features, world_from_scan }, tag))
}

#[cfg(test)]
mod tests;

pub use descriptor::DescriptorRecipe;
