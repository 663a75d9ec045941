//! From a training recipe to pairs of patches, for the training of local descriptors.

use super::{PosedScans, RgbdEntry, ScenesEntry, Split, SynthEntry};
use crate::Monitor;
use crate::config::Layers;
use crate::pipeline;
use crate::pipeline::FeatureSource;
use crate::preprocessing::ScaleConfig;
use crate::scan::PointCloud;
use crate::training::mini_spin_net::{PairData, PairLengths, PairScene, PosedSurface, TrainConfig, extract};
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Farthest counterpart of a keypoint, in voxels: thinned clouds meet within a cell's diagonal.
const MATCH_VOXELS: f64 = 1.0;

/// Everything that decides a trained descriptor: settings and what it is trained on.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DescriptorRecipe {
    /// Network and settings of the training itself.
    pub train: TrainConfig,
    /// Lengths; those not given are chosen from the scans of every scene, as in a registration.
    pub scale: ScaleConfig,
    /// Folders of posed scans.
    pub scenes: Vec<ScenesEntry>,
    /// Depth images with poses, fused into scans.
    pub rgbd: Vec<RgbdEntry>,
    /// Synthetic buildings, made on the fly.
    pub synth: Vec<SynthEntry>,
}

impl DescriptorRecipe {
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
        super::check_entries(&self.scenes, &self.rgbd, &self.synth)
    }

    /// As a TOML file that gives the same recipe back.
    ///
    /// # Errors
    /// [`Error::Setting`] for a value TOML has no spelling for (a path that is not UTF-8).
    pub fn to_toml(&self) -> Result<String> {
        super::recipe_toml(self)
    }
}

/// Pairs of patches of all scenes of a recipe. Relative folders lie under `root`.
///
/// # Errors
/// Data that cannot be read or has no poses, or the user asked to stop.
pub fn load(recipe: &DescriptorRecipe, root: &Path, monitor: &dyn Monitor) -> Result<PairData> {
    recipe.validate()?;
    let mut data = PairData::default();
    let entries = (&recipe.scenes[..], &recipe.rgbd[..], &recipe.synth[..]);
    super::each_scene(entries, root, &FeatureSource::Computed, monitor, |split, posed| {
        let scene = pairs_of(posed, recipe, monitor)?;
        match split {
            Split::Train => data.train.push(scene),
            Split::Valid => data.valid.push(scene),
        }
        Ok(())
    })?;
    Ok(data)
}

fn pairs_of(posed: PosedScans, recipe: &DescriptorRecipe, monitor: &dyn Monitor) -> Result<PairScene> {
    let PosedScans { name, scans, world_from_scan } = posed;
    let (scans, frames) = crate::preprocessing::localize(&scans);
    let world_from_scan = world_from_scan.iter().zip(&frames).map(|(pose, frame)| pose * frame);
    let clouds: Vec<&PointCloud> = scans.iter().map(|s| &s.cloud).collect();
    let scale = crate::preprocessing::choose_scale(&recipe.scale, &clouds)?.scale;
    let surfaces = pipeline::thin(&scans, &frames, &scale, monitor)?;
    let posed: Vec<PosedSurface> = surfaces
        .into_iter()
        .zip(world_from_scan)
        .map(|(surface, world_from_scan)| PosedSurface { surface, world_from_scan })
        .collect();
    let lengths = PairLengths {
        radius_m: scale.feature_radius_m as f32,
        match_m: (MATCH_VOXELS * scale.voxel_m) as f32,
    };
    let pairs = extract(&posed, lengths, &recipe.train);
    if pairs.len() < 2 {
        return Err(Error::input(
            format!("scene {name}"),
            format!("{} places seen in two scans", pairs.len()),
            "scans that overlap under their poses",
            "leave the scene out, or check its poses",
        ));
    }
    Ok(PairScene { name, pairs })
}
