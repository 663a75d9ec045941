//! The settings of a run: a preset, a file laid over it, single keys laid over both.
//!
//! Every stage owns its own settings and their checks; this module only composes them.

mod keys;
mod layers;

pub use layers::Layers;

use crate::descriptor::DescriptorConfig;
use crate::error::{Error, Result};
use crate::io::ReadOptions;
use crate::preprocessing::ScaleConfig;
use crate::registration::RegistrationConfig;
use crate::retrieval::RetrievalConfig;
use crate::synchronization::{self, SynchronizationConfig};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Presets that are built in: name and TOML text.
pub const PRESETS: [(&str, &str); 2] = [
    ("default", include_str!("../../../../configs/default.toml")),
    ("paper", include_str!("../../../../configs/paper.toml")),
];

/// The preset used unless another is asked for.
pub const DEFAULT_PRESET: &str = "default";

/// How scans are registered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Method {
    /// Multiview registration by the strategy `registration.strategy`.
    #[default]
    Multiview,
    /// Pairs first, then spectral synchronisation on SE(3) (Arrigoni et al. 2016).
    Eigse3,
    /// Pairs first, then rotation averaging with ℓ1 weights (Chatterjee & Govindu 2013).
    L1Irls,
    /// Pairs first, then rotation averaging with ℓ½ weights (Chatterjee & Govindu 2018).
    Rotavg,
    /// Pairs first, then the learned graph network of Yew & Lee (2021).
    Lits,
    /// Pairs first, then hierarchical rotation averaging (Lee & Civera 2022).
    Hara,
    /// Pairs first, then spectral rotations with history reweighting (Wang et al. 2023).
    Sghr,
    /// Pairs first, then robust optimisation of all poses.
    PoseGraph,
}

impl Method {
    /// The synchronisation method, for those that register pairs first.
    pub fn synchronization(self) -> Option<synchronization::Method> {
        use synchronization::Method as Global;
        match self {
            Method::Multiview => None,
            Method::Eigse3 => Some(Global::Eigse3),
            Method::L1Irls => Some(Global::L1Irls),
            Method::Rotavg => Some(Global::Rotavg),
            Method::Lits => Some(Global::Lits),
            Method::Hara => Some(Global::Hara),
            Method::Sghr => Some(Global::Sghr),
            Method::PoseGraph => Some(Global::PoseGraph),
        }
    }
}

impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.synchronization() {
            Some(method) => method.fmt(f),
            None => f.write_str("multiview"),
        }
    }
}

/// What is written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct OutputConfig {
    /// Voxel to which merged.ply is thinned, metres; half of the working voxel where not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub merged_voxel_m: Option<f64>,
    /// Name of a scan that stays where its file has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference: Option<String>,
    /// Whether features and registered pairs are kept in the output folder for the next run.
    pub feature_cache: bool,
}

impl Default for OutputConfig {
    fn default() -> Self {
        Self { merged_voxel_m: None, reference: None, feature_cache: true }
    }
}

impl OutputConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        match self.merged_voxel_m {
            Some(v) if !(v > 0.0 && v.is_finite()) => Err(Error::setting(
                "output.merged_voxel_m",
                v.to_string(),
                "a positive length in metres",
                "correct it or leave it out",
            )),
            _ => Ok(()),
        }
    }
}

/// All settings of a registration: a default or a preset, of which fields are changed.
///
/// ```
/// let mut config = scanweave_core::Config::default();
/// config.seed = 7;
/// config.descriptor.keypoints.count = 1000;
/// config.validate()?;
/// # Ok::<(), scanweave_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Config {
    /// Name of the preset these settings started from; only a label.
    pub preset: String,
    /// Seed of all randomness: same seed, same result, whatever the number of threads.
    pub seed: u64,
    /// How scans are registered.
    pub method: Method,
    /// What files do not say themselves.
    pub input: ReadOptions,
    /// Lengths, chosen from the scans where not given.
    pub scale: ScaleConfig,
    /// Keypoints and local descriptors.
    pub descriptor: DescriptorConfig,
    /// Prediction of overlap.
    pub retrieval: RetrievalConfig,
    /// Multiview registration; its estimator also registers the pairs of a pose graph, and its
    /// multiview ICP ends every method.
    pub registration: RegistrationConfig,
    /// Pose graphs of the methods that register pairs first.
    pub synchronization: SynchronizationConfig,
    /// What is written.
    pub output: OutputConfig,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            preset: DEFAULT_PRESET.to_owned(),
            seed: 0,
            method: Method::default(),
            input: ReadOptions::default(),
            scale: ScaleConfig::default(),
            descriptor: DescriptorConfig::default(),
            retrieval: RetrievalConfig::default(),
            registration: RegistrationConfig::default(),
            synchronization: SynchronizationConfig::default(),
            output: OutputConfig::default(),
        }
    }
}

impl Config {
    /// A built-in preset.
    ///
    /// # Errors
    /// [`Error::Setting`] when there is none of that name.
    pub fn preset(name: &str) -> Result<Self> {
        let mut layers = Layers::new::<Self>();
        layers.add_preset(name)?;
        Self::from_layers(&layers)
    }

    /// The effective settings, ranges checked.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key and the layer it came from.
    pub fn from_layers(layers: &Layers) -> Result<Self> {
        let config: Self = layers.read()?;
        config.validate().map_err(|error| match error {
            Error::Setting { key, found, expected, remedy } => {
                let key = match layers.source_of(&key) {
                    Some(source) => format!("{source}: {key}"),
                    None => key,
                };
                Error::Setting { key, found, expected, remedy }
            }
            other => other,
        })?;
        Ok(config)
    }

    /// The method by name: the strategy where that decides.
    pub fn method_name(&self) -> String {
        match self.method {
            Method::Multiview => self.registration.strategy.to_string(),
            other => other.to_string(),
        }
    }

    /// Refuses settings of pose graphs where no pose graph is made.
    fn check_effects(&self) -> Result<()> {
        if self.method != Method::Multiview && self.registration.prior.is_in_use() {
            return Err(Error::setting(
                "registration.prior",
                format!("a prior, with method = \"{}\"", self.method),
                "method = \"multiview\", which weighs it",
                "choose that method, or leave out what is known of poses",
            ));
        }
        let given = &self.synchronization;
        let usual = SynchronizationConfig::default();
        let key = match () {
            () if self.method != Method::Multiview => return Ok(()),
            () if given.graph != usual.graph => "graph",
            () if given.neighbours != usual.neighbours => "neighbours",
            () if given.max_median_distance != usual.max_median_distance => "max_median_distance",
            () if given.lits_weights != usual.lits_weights => "lits_weights",
            () => return Ok(()),
        };
        Err(Error::setting(
            format!("synchronization.{key}"),
            "a value, which has no effect with method = \"multiview\"",
            "a method that makes a pose graph",
            "leave it out, or set method to eigse3, l1-irls, rotavg, lits, hara, sghr or pose-graph",
        ))
    }

    /// Checks the ranges of every stage.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        self.input.validate()?;
        self.scale.validate()?;
        self.descriptor.validate()?;
        self.retrieval.validate()?;
        self.registration.validate()?;
        self.synchronization.validate()?;
        self.check_effects()?;
        self.output.validate()
    }

    /// As a TOML file that gives the same settings back.
    ///
    /// # Errors
    /// [`Error::Setting`] for a value TOML has no spelling for (a path that is not UTF-8).
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).map_err(|e| {
            Error::setting(
                "configuration",
                e.to_string(),
                "values that TOML can hold",
                "use plain UTF-8 paths",
            )
        })
    }
}

/// TOML text of a built-in preset.
///
/// # Errors
/// [`Error::Setting`] when there is none of that name.
pub fn preset_text(name: &str) -> Result<&'static str> {
    if let Some((_, text)) = PRESETS.iter().find(|(n, _)| *n == name) {
        return Ok(text);
    }
    let names: Vec<&str> = PRESETS.iter().map(|p| p.0).collect();
    Err(Error::setting(
        "--preset",
        format!("`{name}`"),
        format!("one of {}", names.join(", ")),
        "pass a file of your own with --config",
    ))
}

/// JSON schema of configuration files.
pub fn schema() -> String {
    serde_json::to_string_pretty(&schemars::schema_for!(Config)).unwrap_or_default()
}

#[cfg(test)]
mod tests;
