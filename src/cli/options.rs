//! Flags that several subcommands share.

use super::{Verbosity, outcome};
use anyhow::Context;
use clap::Args;
use scanweave::config::{self, Config, Layers};
use scanweave::files::is_same_place;
use scanweave::io::{self, ReadOptions, TextColumns};
use scanweave::registration::Axis;
use scanweave::scan::Scan;
use scanweave::{Error, Monitor};
use serde::de::DeserializeOwned;
use serde::de::value::{Error as ValueError, StrDeserializer};
use std::path::{Path, PathBuf};

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

/// What depth images do not say themselves.
#[derive(Debug, Default, Args)]
pub struct DepthOptions {
    /// Units of depth images in a metre: 1000 for millimetres, 5000 for TUM RGB-D.
    #[arg(long, value_name = "N")]
    pub depth_scale: Option<f64>,
    /// Intrinsics of depth images, where none lie beside them.
    #[arg(long, value_name = "FILE")]
    pub intrinsics: Option<PathBuf>,
}

impl DepthOptions {
    /// Lays what the flags say over settings.
    pub fn lay_over(&self, options: &mut ReadOptions) {
        options.depth_units_per_m = self.depth_scale.or(options.depth_units_per_m);
        options.intrinsics = self.intrinsics.clone().or_else(|| options.intrinsics.take());
    }
}

/// What files of scans do not say themselves.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Reading scans")]
pub struct FormatOptions {
    /// Columns of text files, counted from 1: x=3,y=4,z=5, and r=, g=, b=, i= (intensity) where wanted.
    #[arg(long, value_name = "LIST")]
    pub columns: Option<TextColumns>,
    /// Unit of the coordinates: mm, cm, m, km, in, ft, us-ft, or the number of metres. Default: metres,
    /// or what the file says.
    #[arg(long, value_name = "UNIT", value_parser = unit_m)]
    pub unit: Option<f64>,
    #[command(flatten)]
    pub depth: DepthOptions,
    /// Most MiB that a packed file or image may unpack to. Default: 64 MiB and 100 times the size of the
    /// file up to 4 GiB, or 20 times its size where that is more.
    #[arg(long, value_name = "MIB")]
    pub unpack_limit: Option<u64>,
}

impl FormatOptions {
    /// Lays what the flags say over settings.
    pub fn apply(&self, options: &mut ReadOptions) -> scanweave::Result<()> {
        options.columns = self.columns.or(options.columns);
        options.unit_m = self.unit.or(options.unit_m);
        self.depth.lay_over(options);
        options.unpack_limit_mib = self.unpack_limit.or(options.unpack_limit_mib);
        options.validate()
    }
}

/// How scan files are found and read.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Reading scans")]
pub struct ReadingOptions {
    #[command(flatten)]
    pub format: FormatOptions,
    /// Look into the folders in a folder, too.
    #[arg(long)]
    pub recursive: bool,
    /// Go on without files that cannot be read, and list them.
    #[arg(long)]
    pub skip_unreadable: bool,
}

impl ReadingOptions {
    /// Finds and reads the scans, and says what a user should know of it. Files that are found in folders
    /// and are output of this run (`is_own`) are left out.
    pub fn read(
        &self,
        inputs: &[String],
        options: &ReadOptions,
        monitor: &dyn Monitor,
        verbosity: &Verbosity,
        is_own: impl Fn(&Path) -> bool,
    ) -> scanweave::Result<Vec<Scan>> {
        let mut found = io::discover_with(inputs, self.recursive)?;
        found.leave_out(is_own);
        let read = io::read_inputs(&found, options, self.skip_unreadable, monitor)?;
        outcome::tell_about(&read, verbosity);
        Ok(read.scans)
    }
}

/// What is known of poses before any scan is compared.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "What is known of poses")]
pub struct PriorOptions {
    /// Rough poses: `own`, those that the files state, or the coordinates of the files as they are where
    /// they state none; or a file of poses. A result may contradict them; which ones it does is said.
    #[arg(long, value_name = "own|FILE")]
    pub initial_poses: Option<PathBuf>,
    /// How far rough poses may be off: standard deviations of a position along each axis in metres and of
    /// a rotation about each in degrees. Default: ten inlier radii, 10 degrees.
    #[arg(long, value_name = "M,DEG", requires = "initial_poses", value_parser = deviations)]
    pub pose_deviation: Option<(f64, f64)>,
    /// The axis of every file that points up, within about 10 degrees: x, y, z, -x, -y, -z.
    #[arg(long, value_name = "AXIS", value_parser = word::<Axis>, allow_hyphen_values = true)]
    pub gravity: Option<Axis>,
    /// Every scan was levelled: the axis that points up (z, where --gravity names none) does so within
    /// about one degree.
    #[arg(long)]
    pub level: bool,
}

impl PriorOptions {
    /// Lays what the flags say over settings.
    pub fn apply(&self, config: &mut Config) -> scanweave::Result<()> {
        /// Of a levelled scanner.
        const LEVEL_DEG: f64 = 1.0;
        let prior = &mut config.registration.prior;
        prior.initial_poses |= self.initial_poses.is_some();
        if let Some((position_m, rotation_deg)) = self.pose_deviation {
            prior.position_deviation_m = Some(position_m);
            prior.rotation_deviation_deg = rotation_deg;
        }
        prior.up = self.gravity.or(prior.up);
        if self.level {
            prior.up = prior.up.or(Some(Axis::Z));
            prior.tilt_deviation_deg = LEVEL_DEG;
        }
        config.validate()
    }
}

impl PriorOptions {
    /// Gives the scans their rough poses.
    pub fn give(&self, scans: &mut [Scan]) -> scanweave::Result<()> {
        let Some(source) = &self.initial_poses else { return Ok(()) };
        if source.as_os_str() == "own" {
            scans.iter_mut().for_each(|scan| {
                scan.initial_pose.get_or_insert_default();
            });
            return Ok(());
        }
        let names: Vec<String> = scans.iter().map(|s| s.name.clone()).collect();
        let files: Vec<Option<PathBuf>> = scans.iter().map(|s| s.path.clone()).collect();
        let given = io::read_initial_poses(source, &names, &files)?;
        scans.iter_mut().zip(given).for_each(|(scan, pose)| scan.initial_pose = pose);
        Ok(())
    }
}

fn deviations(text: &str) -> Result<(f64, f64), String> {
    let (position, rotation) = text.split_once(',').ok_or("expected two numbers, as in 0.5,10")?;
    let positive = |word: &str| word.trim().parse::<f64>().ok().filter(|v| *v > 0.0 && v.is_finite());
    let both = positive(position).zip(positive(rotation));
    both.ok_or_else(|| "expected two positive numbers, as in 0.5,10".to_owned())
}

fn unit_m(text: &str) -> Result<f64, String> {
    let number = || text.parse::<f64>().ok().filter(|m| *m > 0.0 && m.is_finite());
    io::unit_m(text)
        .or_else(number)
        .ok_or_else(|| "expected mm, cm, m, km, in, ft, us-ft or a positive number of metres".to_owned())
}

/// A flag's value that is one of the words of a setting.
pub fn word<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    // Serde's own message lists the words.
    T::deserialize(StrDeserializer::<ValueError>::new(text)).map_err(|e| e.to_string())
}

/// Declines to write scans into the folder of the walk that they are made of: they would be taken for
/// images of it, or replace them.
pub fn refuse_walk(walk: &Path, output: &Path) -> scanweave::Result<()> {
    if !is_same_place(walk, output) {
        return Ok(());
    }
    let found = format!("{}, the folder of the walk", output.display());
    Err(Error::setting("--output", found, "a folder of its own", "choose another folder"))
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
