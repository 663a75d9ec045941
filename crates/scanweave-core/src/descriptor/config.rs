//! Which descriptor, and the one call that computes it.

use super::mini_spin_net::{self, LoadedNetwork};
use super::{KeypointConfig, fpfh, keypoints};
use crate::error::{Error, Result};
use crate::geometry::Point;
use crate::scan::{Descriptors, Features, Scan, Surface, WorkingScale};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The descriptors there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum DescriptorKind {
    /// Fast point feature histograms, computed here (33 values).
    Fpfh,
    /// MiniSpinNet, a learned descriptor computed here (32 values with the built-in weights).
    MiniSpinNet,
    /// MiniSpinNet and FPFH side by side (65 values with the built-in weights): what either cannot tell
    /// apart the other often can.
    #[default]
    MiniSpinNetFpfh,
    /// Keypoints and descriptors read from files.
    Precomputed,
}

impl DescriptorKind {
    /// Whether it has weights.
    fn is_learned(self) -> bool {
        matches!(self, Self::MiniSpinNet | Self::MiniSpinNetFpfh)
    }
}

/// Length of the histograms beside a learned descriptor of length 1. It makes up for histograms being
/// alike: at this length two unrelated keypoints are as far apart in either part, root mean square
/// (`matching_quality` prints these distances: 1.4 and 0.6 on five scenes of 3DMatch).
const FPFH_LENGTH: f32 = 2.3;

/// Which points the patches of a learned descriptor are made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PatchPoints {
    /// The scan thinned to the working voxel.
    #[default]
    Surface,
    /// All points of the scan.
    Cloud,
}

/// Settings of the local features.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct DescriptorConfig {
    /// Which descriptor.
    pub kind: DescriptorKind,
    /// Weights of a learned descriptor: a file of `train descriptor` or `import-weights`. The built-in ones
    /// where none is named.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub checkpoint: Option<PathBuf>,
    /// Which points the patches of a learned descriptor are made of.
    pub patch_points: PatchPoints,
    /// Where it is computed.
    pub keypoints: KeypointConfig,
}

impl DescriptorConfig {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`Error::Setting`] for an unusable value.
    pub fn validate(&self) -> Result<()> {
        match (&self.checkpoint, self.kind) {
            (Some(path), DescriptorKind::Fpfh) => Err(Error::setting(
                "descriptor.checkpoint",
                format!("{}, with a descriptor that has no weights", path.display()),
                "none for fpfh",
                "leave it out, or leave descriptor.kind out",
            )),
            _ => self.keypoints.validate(),
        }
    }

    /// Name of the descriptor, as in a config file.
    pub fn descriptor_name(&self) -> &'static str {
        match self.kind {
            DescriptorKind::Fpfh => "fpfh",
            DescriptorKind::MiniSpinNet => "mini-spin-net",
            DescriptorKind::MiniSpinNetFpfh => "mini-spin-net-fpfh",
            DescriptorKind::Precomputed => "precomputed",
        }
    }
}

/// A descriptor ready to be computed: settings, checked, and weights, read.
#[derive(Debug, Clone)]
pub struct Describer {
    config: DescriptorConfig,
    network: Option<LoadedNetwork>,
}

impl Describer {
    /// Checks the settings and reads the weights they name, or else the built-in ones.
    ///
    /// # Errors
    /// [`Error::Setting`] for an unusable value; an unreadable checkpoint.
    pub fn new(config: &DescriptorConfig) -> Result<Self> {
        config.validate()?;
        let network = match &config.checkpoint {
            _ if !config.kind.is_learned() => None,
            Some(path) => Some(LoadedNetwork::new(&mini_spin_net::Checkpoint::load(path)?.weights)),
            None => Some(mini_spin_net::shipped()?),
        };
        Ok(Self { config: config.clone(), network })
    }

    /// The settings.
    pub fn config(&self) -> &DescriptorConfig {
        &self.config
    }

    /// What a descriptor vector means, as a hex digest: its name, the version of its
    /// formula, its weights, and its radii in voxels. Two runs of the same digest have comparable
    /// descriptors, at whatever absolute scale and number of keypoints, so that weights
    /// trained on one hold for the other.
    pub fn settings_hash(&self, scale: &WorkingScale) -> String {
        blake3::hash(self.settings_text(scale).as_bytes()).to_hex().to_string()
    }

    /// What decides the features of a given cloud, as a hex digest: [`Self::settings_hash`]
    /// with the absolute lengths, the number of keypoints and the seed.
    pub fn features_hash(&self, scale: &WorkingScale, seed: u64) -> String {
        let text = format!(
            "{};voxel={:?};normals={:?};features={:?};keypoints={};seed={seed}",
            self.settings_text(scale),
            scale.voxel_m,
            scale.normal_radius_m,
            scale.feature_radius_m,
            self.config.keypoints.count,
        );
        blake3::hash(text.as_bytes()).to_hex().to_string()
    }

    fn settings_text(&self, scale: &WorkingScale) -> String {
        // A hundredth of a voxel changes no descriptor to speak of, and absorbs rounding.
        let voxels = |radius_m: f64| format!("{:.2}", radius_m / scale.voxel_m);
        let fpfh = || {
            let (normals, features) = (voxels(scale.normal_radius_m), voxels(scale.feature_radius_m));
            format!("fpfh/1;normals={normals};features={features}")
        };
        let learned = |network: &LoadedNetwork| {
            let (points, features) = (self.config.patch_points, voxels(scale.feature_radius_m));
            format!("mini-spin-net/1;weights={};points={points:?};features={features}", network.digest())
        };
        match (self.config.kind, &self.network) {
            (DescriptorKind::MiniSpinNet, Some(network)) => learned(network),
            (DescriptorKind::MiniSpinNetFpfh, Some(network)) => {
                format!("{};beside={FPFH_LENGTH:?}*{}", learned(network), fpfh())
            }
            (DescriptorKind::Precomputed, _) => "precomputed/1".to_owned(),
            _ => fpfh(),
        }
    }

    /// Keypoints, normals and descriptors of a scan from its thinned `surface`.
    ///
    /// A scan with few points gives few features, or none; nothing about its shape is an error.
    /// The same surface, settings and seed give the same bytes.
    ///
    /// # Errors
    /// [`Error::Setting`] when the descriptor is one that is read from files and not computed.
    pub fn describe(
        &self,
        scan: &Scan,
        surface: &Surface,
        scale: &WorkingScale,
        seed: u64,
    ) -> Result<Features> {
        if self.config.kind == DescriptorKind::Precomputed {
            return Err(Error::setting(
                "descriptor.kind",
                format!("precomputed, but no features for the scan {}", scan.name),
                "a feature file for every scan",
                "name the folder that holds them, or set descriptor.kind to \"fpfh\"",
            ));
        }
        let radius_m = scale.feature_radius_m as f32;
        let rows = keypoints::choose(surface, self.config.keypoints.count, seed);
        let keypoints: Vec<Point> = rows.iter().map(|&i| surface.points[i]).collect();
        let histograms = || fpfh::descriptors(surface, &rows, radius_m);
        let (dim, values) = match &self.network {
            None => (fpfh::DIMENSION, histograms()),
            Some(network) => {
                let points = match self.config.patch_points {
                    PatchPoints::Surface => &surface.points,
                    PatchPoints::Cloud => &scan.cloud.points,
                };
                let (network, viewpoint) = (network.network(), &surface.viewpoint);
                let values =
                    mini_spin_net::descriptors(network, points, viewpoint, &keypoints, radius_m, seed);
                match self.config.kind {
                    DescriptorKind::MiniSpinNetFpfh => {
                        let dim = network.dim();
                        (dim + fpfh::DIMENSION, side_by_side(&values, dim, &histograms()))
                    }
                    _ => (network.dim(), values),
                }
            }
        };
        // A lone point has a descriptor of nothing, which would match anything.
        let described = |at: usize| values[at * dim..][..dim].iter().any(|v| *v != 0.0);
        let kept: Vec<usize> = (0..rows.len()).filter(|&at| described(at)).collect();
        let normals = rows.iter().map(|&i| surface.normals[i]).collect();
        let features = Features::new(keypoints, Some(normals), Descriptors::new(dim, values)?)?;
        Ok(if kept.len() == rows.len() { features } else { features.select(&kept) })
    }
}

/// Rows of unit length `[n·(dim + 33)]`: learned descriptors `[n·dim]` and histograms `[n·33]`, both of unit
/// length or zero, the latter [`FPFH_LENGTH`] times as long. A row that either says nothing of is zero.
fn side_by_side(learned: &[f32], dim: usize, histograms: &[f32]) -> Vec<f32> {
    let unit = (1.0 + FPFH_LENGTH * FPFH_LENGTH).sqrt().recip();
    let zero = |row: &[f32]| row.iter().all(|v| *v == 0.0);
    let rows = learned.chunks_exact(dim).zip(histograms.chunks_exact(fpfh::DIMENSION));
    let joined = rows.flat_map(|(l, h)| {
        let unit = if zero(l) || zero(h) { 0.0 } else { unit };
        l.iter().map(move |v| unit * v).chain(h.iter().map(move |v| unit * FPFH_LENGTH * v))
    });
    joined.collect()
}

/// [`Describer::describe`] for a single scan.
///
/// # Errors
/// Those of [`Describer::new`] and [`Describer::describe`].
pub fn describe(
    scan: &Scan,
    surface: &Surface,
    scale: &WorkingScale,
    config: &DescriptorConfig,
    seed: u64,
) -> Result<Features> {
    Describer::new(config)?.describe(scan, surface, scale, seed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::preprocessing::surface;
    use crate::scan::PointCloud;
    use rand::{RngExt, SeedableRng};

    fn scan(points: Vec<Point>) -> Scan {
        Scan { name: "a".into(), cloud: PointCloud::from_points(points), ..Scan::default() }
    }

    /// Random points on the faces of a box corner, 1 m wide.
    fn corner(n: usize) -> Scan {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut point = |i: usize| {
            let mut c = [rng.random_range(0.0f32..1.0), rng.random_range(0.0f32..1.0), 0.0];
            c.rotate_left(i % 3);
            Point::from(c) + nalgebra::Vector3::new(0.5, 0.5, 1.0)
        };
        scan((0..n).map(&mut point).collect())
    }

    fn features_of(scan: &Scan, scale: &WorkingScale, seed: u64) -> Features {
        let surface = surface::thin(&scan.cloud, scale);
        let config = DescriptorConfig { keypoints: KeypointConfig { count: 700 }, ..Default::default() };
        describe(scan, &surface, scale, &config, seed).unwrap()
    }

    #[test]
    fn a_scan_gives_unit_descriptors_at_its_keypoints() {
        let (scan, scale) = (corner(30_000), WorkingScale::from_voxel(0.02));
        let features = features_of(&scan, &scale, 1);
        // The network may make nothing of a few.
        assert!(features.len() >= 690 && features.descriptors.dim() == 65, "{}", features.len());
        for i in 0..features.len() {
            let norm: f32 = features.descriptors.row(i).iter().map(|v| v * v).sum();
            assert!((norm - 1.0).abs() < 1e-5);
        }
        assert!(features.normals.as_ref().is_some_and(|n| n.iter().all(|v| (v.norm() - 1.0).abs() < 1e-5)));
    }

    #[test]
    fn threads_do_not_change_a_byte() {
        let (scan, scale) = (corner(30_000), WorkingScale::from_voxel(0.02));
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| features_of(&scan, &scale, 1))
        };
        let (one, three) = (with(1), with(3));
        let bits = |f: &Features| f.descriptors.values().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&one), bits(&three));
        assert_eq!(one, three);
        assert_ne!(one.keypoints, features_of(&scan, &scale, 2).keypoints);
    }

    #[test]
    fn poor_scans_give_few_features_and_no_failure() {
        let scale = WorkingScale::from_voxel(0.1);
        let lone = [[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 5.0, 1.0]].map(Point::from).to_vec();
        let line = (0..300).map(|i| Point::new(i as f32 * 0.05, 0.0, 1.0)).collect();
        let same = vec![Point::new(1.0, 1.0, 1.0); 100];
        for points in [vec![], lone, line, same] {
            assert!(features_of(&scan(points), &scale, 1).is_empty());
        }
        // A plane is described like any other scan; that it fixes no pose shows later.
        let plane = (0..2500).map(|i| Point::new((i % 50) as f32 * 0.1, (i / 50) as f32 * 0.1, 1.0));
        assert!(features_of(&scan(plane.collect()), &scale, 1).len() >= 690);
    }

    #[test]
    fn hashes_tell_settings_apart_but_not_absolute_scale() {
        let ready = |config: &DescriptorConfig| Describer::new(config).unwrap();
        let plain = DescriptorConfig::default();
        let config = ready(&plain);
        let (near, far) = (WorkingScale::from_voxel(0.025), WorkingScale::from_voxel(0.3));
        assert_eq!(config.settings_hash(&near), config.settings_hash(&far));
        assert_ne!(config.features_hash(&near, 1), config.features_hash(&far, 1));
        assert_ne!(config.features_hash(&near, 1), config.features_hash(&near, 2));
        let wider = WorkingScale { feature_radius_m: 2.0 * near.feature_radius_m, ..near };
        assert_ne!(config.settings_hash(&near), config.settings_hash(&wider));
        let fewer = ready(&DescriptorConfig { keypoints: KeypointConfig { count: 250 }, ..plain.clone() });
        assert_eq!(config.settings_hash(&near), fewer.settings_hash(&near));
        assert_ne!(config.features_hash(&near, 1), fewer.features_hash(&near, 1));
        let read = ready(&DescriptorConfig { kind: DescriptorKind::Precomputed, ..plain.clone() });
        assert_ne!(config.settings_hash(&near), read.settings_hash(&near));
    }

    #[test]
    fn a_config_file_names_the_kind_and_unknown_keys_are_refused() {
        let text = "kind = \"precomputed\"\n[keypoints]\ncount = 1000\n";
        let config: DescriptorConfig = toml::from_str(text).unwrap();
        assert_eq!(config.descriptor_name(), "precomputed");
        assert_eq!(config.keypoints.count, 1000);
        assert!(toml::from_str::<DescriptorConfig>("kinds = \"fpfh\"").is_err());
        let error = describe(&scan(vec![]), &Surface::default(), &WorkingScale::from_voxel(1.0), &config, 0)
            .unwrap_err();
        assert!(error.to_string().starts_with("descriptor.kind: found precomputed"), "{error}");
        let few = DescriptorConfig { keypoints: KeypointConfig { count: 2 }, ..Default::default() };
        assert!(few.validate().is_err());
        let text = "kind = \"fpfh\"\ncheckpoint = \"w.safetensors\"\n";
        let weightless = toml::from_str::<DescriptorConfig>(text).unwrap().validate().unwrap_err();
        assert!(weightless.to_string().contains("a descriptor that has no weights"), "{weightless}");
    }
}
