//! The file that says what is compared with what.

use crate::config::{Config, Layers};
use crate::descriptor::DescriptorKind;
use crate::evaluation::protocol::Protocol;
use crate::synthetic::SynthConfig;
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// A suite of benchmarks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Suite {
    /// What it is called.
    pub name: String,
    /// Numbers of keypoints a scan: seeded samples of `computed_keypoints`, smaller ones part of
    /// larger ones.
    pub keypoints: Vec<usize>,
    /// Keypoints a scan that features are computed for, once for all cells.
    pub computed_keypoints: usize,
    /// Seeds; each gives a table of its own, and together they give the spread.
    pub seeds: Vec<u64>,
    /// Whether every seed also chooses the computed keypoints anew. Off, as in the published
    /// tables, all seeds share the same ones.
    pub vary_features: bool,
    /// What is registered.
    pub datasets: Vec<DataSet>,
    /// How.
    pub methods: Vec<Method>,
    /// Published results, shown for comparison.
    pub quoted: Vec<Quoted>,
}

impl Default for Suite {
    fn default() -> Self {
        Self {
            name: String::new(),
            keypoints: vec![5000],
            computed_keypoints: 5000,
            seeds: vec![0],
            vary_features: false,
            datasets: Vec::new(),
            methods: Vec::new(),
            quoted: Vec::new(),
        }
    }
}

/// Scenes and how they are judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DataSet {
    /// What it is called.
    pub name: String,
    /// Folder of the scenes, each a folder of scans, under the data root; or one scene.
    pub folder: PathBuf,
    /// Scenes to use; all where none is named.
    pub scenes: Vec<String>,
    /// What is judged.
    pub benchmarks: Vec<BenchmarkSource>,
    /// Folder of features made by another program, one NPZ a scan, under the data root; `{scene}`
    /// stands for the scene's name. Computed where not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub features: Option<String>,
    /// Distance within which points of two scans count as common, metres, where true overlap is
    /// computed from the poses.
    pub overlap_radius_m: f64,
    /// Makes the scenes instead of reading them: one for each of `synthetic_seeds`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub synthetic: Option<SynthConfig>,
    /// Seeds of the scenes that are made.
    pub synthetic_seeds: Vec<u64>,
}

impl Default for DataSet {
    fn default() -> Self {
        Self {
            name: String::new(),
            folder: PathBuf::new(),
            scenes: Vec::new(),
            benchmarks: Vec::new(),
            features: None,
            overlap_radius_m: 0.07,
            synthetic: None,
            synthetic_seeds: vec![0],
        }
    }
}

/// One benchmark of a data set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BenchmarkSource {
    /// What it is called.
    pub name: String,
    /// How it counts.
    pub protocol: Protocol,
    /// Folder with `<scene>/gt.log` and gt.info under the data root; where not given they lie
    /// beside the scans.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
}

/// A method: settings as `register` takes them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Method {
    /// What it is called.
    pub name: String,
    /// Preset it starts from.
    #[serde(default = "default_preset")]
    pub preset: String,
    /// Settings laid over it, each as in `registration.shortlist=5`.
    #[serde(default)]
    pub set: Vec<String>,
    /// Where the predicted overlap comes from.
    #[serde(default)]
    pub similarity: SimilarityChoice,
}

fn default_preset() -> String {
    crate::config::DEFAULT_PRESET.to_owned()
}

/// Where the predicted overlap comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SimilarityChoice {
    /// From the features, as the settings say.
    #[default]
    Predicted,
    /// The true overlap: the best that any prediction could be.
    Oracle,
}

/// Figures that others published, marked as such wherever they appear.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Quoted {
    /// Where they were published.
    pub source: String,
    /// Method and features, as in the source.
    pub method: String,
    /// Benchmark that they are for, by its name here.
    pub benchmark: String,
    /// Scenes that they are the mean of.
    pub scenes: usize,
    /// Numbers of keypoints.
    pub keypoints: Vec<usize>,
    /// Registration recall for each, percent, mean of the scenes.
    pub recall_percent: Vec<f64>,
}

impl Suite {
    /// Reads a suite. An unknown key is an error that names the nearest one.
    ///
    /// # Errors
    /// [`Error::Read`], and [`Error::Setting`] naming file and key.
    pub fn load(path: &Path) -> Result<Self> {
        let mut layers = Layers::new::<Self>();
        layers.add_file(path)?;
        let suite: Self = layers.read()?;
        suite.validate().map(|()| suite)
    }

    /// As a TOML file that gives the same suite back.
    ///
    /// # Errors
    /// [`Error::Setting`] for a value TOML has no spelling for (a path that is not UTF-8).
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).map_err(|e| {
            Error::setting("suite", e.to_string(), "values that TOML can hold", "use plain UTF-8 paths")
        })
    }

    /// Checks names, counts and every method's settings.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the entry.
    pub fn validate(&self) -> Result<()> {
        distinct("datasets", self.datasets.iter().map(|d| d.name.as_str()))?;
        distinct("methods", self.methods.iter().map(|m| m.name.as_str()))?;
        distinct("keypoints", self.keypoints.iter().map(usize::to_string))?;
        distinct("seeds", self.seeds.iter().map(u64::to_string))?;
        if let Some(k) = self.keypoints.iter().find(|k| **k > self.computed_keypoints || **k < 3) {
            return Err(Error::setting(
                "keypoints",
                k.to_string(),
                format!("from 3 to computed_keypoints = {}", self.computed_keypoints),
                "raise computed_keypoints, or leave this count out",
            ));
        }
        for dataset in &self.datasets {
            dataset.validate()?;
        }
        for quoted in &self.quoted {
            if quoted.keypoints.len() != quoted.recall_percent.len() {
                return Err(Error::setting(
                    format!("quoted: {}: recall_percent", quoted.method),
                    format!("{} figures", quoted.recall_percent.len()),
                    format!("one for each of {} keypoint counts", quoted.keypoints.len()),
                    "complete the list",
                ));
            }
        }
        self.methods.iter().try_for_each(|m| m.config(0, self.computed_keypoints).map(drop))
    }
}

impl DataSet {
    fn validate(&self) -> Result<()> {
        let key = |name: &str| format!("datasets: {}: {name}", self.name);
        distinct(&key("benchmarks"), self.benchmarks.iter().map(|b| b.name.as_str()))?;
        if !(self.overlap_radius_m > 0.0 && self.overlap_radius_m.is_finite()) {
            let found = self.overlap_radius_m.to_string();
            return Err(Error::setting(key("overlap_radius_m"), found, "a positive length", "correct it"));
        }
        let Some(synthetic) = &self.synthetic else { return Ok(()) };
        synthetic.validate()?;
        distinct(&key("synthetic_seeds"), self.synthetic_seeds.iter().map(u64::to_string))?;
        if synthetic.unrelated > 0 {
            return Err(Error::setting(
                key("synthetic.unrelated"),
                synthetic.unrelated.to_string(),
                "0: scans of other buildings have no true pose among the rest",
                "leave it out",
            ));
        }
        Ok(())
    }
}

impl Method {
    /// Its effective settings.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the method and the key.
    pub fn config(&self, seed: u64, keypoints: usize) -> Result<Config> {
        let layered = || {
            let mut layers = Layers::new::<Config>();
            layers.add_preset(&self.preset)?;
            for assignment in &self.set {
                layers.add_assignment(assignment)?;
            }
            layers.add_assignment(&format!("seed={seed}"))?;
            layers.add_assignment(&format!("descriptor.keypoints.count={keypoints}"))?;
            Config::from_layers(&layers)
        };
        layered().map_err(|error| match error {
            Error::Setting { key, found, expected, remedy } => {
                Error::Setting { key: format!("methods: {}: {key}", self.name), found, expected, remedy }
            }
            other => other,
        })
    }

    /// As [`Method::config`], for features that are given.
    ///
    /// # Errors
    /// As [`Method::config`].
    pub fn config_for(&self, dataset: &DataSet, seed: u64, keypoints: usize) -> Result<Config> {
        let mut config = self.config(seed, keypoints)?;
        if dataset.features.is_some() {
            config.descriptor.kind = DescriptorKind::Precomputed;
        }
        Ok(config)
    }
}

/// Refuses an empty list, an empty name and a repeated one.
fn distinct<S: AsRef<str>>(key: &str, names: impl Iterator<Item = S>) -> Result<()> {
    let mut seen = BTreeSet::new();
    let mut any = false;
    for name in names {
        any = true;
        let name = name.as_ref();
        if name.is_empty() || !seen.insert(name.to_owned()) {
            let found = if name.is_empty() {
                "an entry without a name".to_owned()
            } else {
                format!("`{name}` twice")
            };
            return Err(Error::setting(key, found, "names that differ", "rename one of them"));
        }
    }
    if any {
        return Ok(());
    }
    Err(Error::setting(key, "an empty list", "at least one entry", "add one"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::{MergeRule, Strategy};

    #[test]
    fn the_suites_that_come_with_the_program_are_valid_and_survive_their_own_text() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/suites");
        let mut names = Vec::new();
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let suite = Suite::load(&path).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(toml::from_str::<Suite>(&suite.to_toml().unwrap()).unwrap(), suite);
            assert!(!suite.name.is_empty());
            names.push(path.file_stem().unwrap().to_string_lossy().into_owned());
        }
        for needed in ["3dmatch", "scannet", "eth", "ablation", "samples", "similarity"] {
            assert!(names.iter().any(|n| n == needed), "{needed}.toml is missing");
        }
    }

    #[test]
    fn a_method_is_its_preset_with_its_settings() {
        let method: Method =
            toml::from_str("name = \"x\"\npreset = \"paper\"\nset = [\"registration.strategy.merge=mean\"]")
                .unwrap();
        let config = method.config(7, 300).unwrap();
        let mut expected = Config::preset("paper").unwrap();
        expected.seed = 7;
        expected.descriptor.keypoints.count = 300;
        let Strategy::Incremental(strategy) = &mut expected.registration.strategy else {
            panic!("the paper grows one meta-shape");
        };
        strategy.merge = MergeRule::Mean;
        assert_eq!(config, expected);
        let given = DataSet { features: Some("f/{scene}".to_owned()), ..DataSet::default() };
        let kind = method.config_for(&given, 7, 300).unwrap().descriptor.kind;
        assert_eq!(kind, DescriptorKind::Precomputed);
    }
}
