//! What the stages of a registration are told alike: scans, features, what is known of poses, settings.

use super::Verbosity;
use super::options::{PriorOptions, ReadingOptions, SettingOptions, ThreadOption, word};
use super::progress::Progress;
use clap::Args;
use scanweave::config::{Config, Method};
use scanweave::descriptor::DescriptorKind;
use scanweave::pipeline::{self, FeatureSource};
use scanweave::result_folder::kept_features;
use scanweave::scan::{Features, Scan};
use scanweave::{Error, Result};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub struct RegistrationOptions {
    /// Scan files, folders of them, globs, or @list.txt with one of these a line.
    #[arg(required = true, value_name = "SCANS")]
    inputs: Vec<String>,
    /// Folder of features made by another program: one NPZ a scan, named like the scan, or a
    /// folder NAME_desc beside Keypoints/ as SGHR and IMVR publish them.
    #[arg(long, value_name = "DIR")]
    features: Option<PathBuf>,
    /// Folder that `scanweave describe` wrote for these scans with these settings: features are
    /// taken from there and not computed. The result is the same.
    #[arg(long, value_name = "DIR", conflicts_with = "features")]
    described: Option<PathBuf>,
    /// Trained overlap head; the same as retrieval.checkpoint.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// How scans are registered: agglomerative or incremental, or all pairs first and then all poses
    /// at once (eigse3, l1-irls, rotavg, lits, hara, sghr, pose-graph).
    #[arg(long, value_name = "NAME", value_parser = method)]
    method: Option<MethodChoice>,
    #[command(flatten)]
    prior: PriorOptions,
    #[command(flatten)]
    reading: ReadingOptions,
    #[command(flatten)]
    pub threads: ThreadOption,
    #[command(flatten)]
    settings: SettingOptions,
}

/// Where features come from.
pub enum Source {
    Given(Vec<Features>),
    Kept(PathBuf),
    Cached(PathBuf),
    Computed,
}

impl Source {
    pub fn features(&self) -> FeatureSource<'_> {
        match self {
            Source::Given(features) => FeatureSource::Given(features),
            Source::Kept(folder) => FeatureSource::Kept(folder),
            Source::Cached(folder) => FeatureSource::Cached(folder),
            Source::Computed => FeatureSource::Computed,
        }
    }
}

impl RegistrationOptions {
    /// The effective settings, with those of further flags, as key=value.
    pub fn config(&self, flags: impl IntoIterator<Item = String>) -> Result<Config> {
        let flags: Vec<String> = self.method.iter().flat_map(|m| m.0.clone()).chain(flags).collect();
        let mut config = self.settings.config_with(&flags)?;
        self.reading.format.apply(&mut config.input)?;
        self.prior.apply(&mut config)?;
        if let Some(checkpoint) = &self.checkpoint {
            config.retrieval.checkpoint = Some(checkpoint.clone());
        }
        match (&self.features, config.descriptor.kind) {
            (Some(_), _) => config.descriptor.kind = DescriptorKind::Precomputed,
            (None, DescriptorKind::Precomputed) => {
                return Err(Error::setting(
                    "descriptor.kind",
                    "precomputed, without a folder to read from",
                    "--features DIR with it",
                    "pass --features, or set another kind",
                ));
            }
            (None, _) => {}
        }
        Ok(config)
    }

    /// Finds and reads the scans; files of folders that are output of this run (`is_own`) are left out.
    pub fn read(
        &self,
        config: &Config,
        progress: &Progress,
        verbosity: &Verbosity,
        is_own: impl Fn(&Path) -> bool,
    ) -> Result<Vec<Scan>> {
        self.reading.read(&self.inputs, &config.input, progress, verbosity, is_own)
    }

    /// Gives the scans their rough poses.
    pub fn give_poses(&self, scans: &mut [Scan]) -> Result<()> {
        self.prior.give(scans)
    }

    /// Where features come from; computed ones are kept in `cache`.
    pub fn source(
        &self,
        scans: &[Scan],
        config: &Config,
        cache: &Path,
        progress: &Progress,
    ) -> Result<Source> {
        Ok(match (&self.features, &self.described) {
            (Some(place), _) => {
                Source::Given(pipeline::read_features(place, scans, &config.input, progress)?)
            }
            (None, Some(described)) => Source::Kept(kept_features(described)),
            (None, None) if config.output.feature_cache => Source::Cached(cache.to_path_buf()),
            (None, None) => Source::Computed,
        })
    }
}

/// A method as the settings that choose it, key=value.
#[derive(Debug, Clone)]
struct MethodChoice(Vec<String>);

fn method(name: &str) -> Result<MethodChoice, String> {
    const NAMES: &str =
        "expected agglomerative, incremental, eigse3, l1-irls, rotavg, lits, hara, sghr or pose-graph";
    let settings = match name {
        "agglomerative" | "incremental" => {
            vec!["method=multiview".to_owned(), format!("registration.strategy.kind={name}")]
        }
        _ => vec![format!("method={}", word::<Method>(name).map_err(|_| NAMES.to_owned())?)],
    };
    Ok(MethodChoice(settings))
}
