//! Flags that several subcommands share.

use anyhow::Context;
use clap::Args;
use scanweave::config::{self, Config, Layers};
use serde::de::DeserializeOwned;
use serde::de::value::{Error as ValueError, StrDeserializer};
use std::path::PathBuf;

/// Where settings come from; later ones win: preset, file, `--set`, flags.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Settings")]
pub struct SettingOptions {
    /// Settings to start from: `default` (the best known) or `paper` (as published).
    #[arg(long, value_name = "NAME", default_value = config::DEFAULT_PRESET)]
    pub preset: String,
    /// TOML file laid over the preset; an unknown key is an error.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// One setting laid over both, as in scale.voxel_m=0.05; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub assignments: Vec<String>,
    /// Seed of all randomness.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
}

impl SettingOptions {
    /// The effective settings, checked.
    pub fn config(&self) -> scanweave::Result<Config> {
        self.config_with(&[])
    }

    /// The effective settings with those of other flags, as key=value, laid on top.
    pub fn config_with(&self, flags: &[String]) -> scanweave::Result<Config> {
        let mut layers = Layers::new::<Config>();
        layers.add_preset(&self.preset)?;
        if let Some(path) = &self.config {
            layers.add_file(path)?;
        }
        for assignment in self.assignments.iter().chain(flags) {
            layers.add_assignment(assignment)?;
        }
        if let Some(seed) = self.seed {
            layers.add_assignment(&format!("seed={seed}"))?;
        }
        Config::from_layers(&layers)
    }
}

/// A flag's value that is one of the words of a setting.
pub fn word<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    // Serde's own message lists the words.
    T::deserialize(StrDeserializer::<ValueError>::new(text)).map_err(|e| e.to_string())
}

/// How many threads work.
#[derive(Debug, Default, Args)]
pub struct ThreadOption {
    /// Threads to use; the result is the same for every number. Default: one a core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
}

impl ThreadOption {
    /// Sets up the thread pool.
    pub fn start(&self) -> anyhow::Result<()> {
        let threads = self.threads.map_or(0, usize::from);
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().context("cannot start threads")
    }
}
