//! Trained heads as files.
//!
//! One safetensors file holds the weights and, as JSON under the metadata key `scanweave`,
//! everything needed to know what they are: see [`CheckpointMeta`]. A file that the trainer can
//! continue from holds the optimiser's moments as further tensors.

use super::gem::Gem;
use super::head::HeadWeights;
use super::netvlad::NetVlad;
use crate::atomic;
use crate::error::{Error, Result};
use crate::tensor_file;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;

/// Version of the file's layout that this code writes and reads.
pub const FORMAT_VERSION: u32 = 1;
const META_KEY: &str = "scanweave";
const REMEDY: &str = "use a checkpoint written by `scanweave train` or `scanweave import-weights`";

/// The local descriptor a head was trained on.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DescriptorTag {
    /// Name of the descriptor (`fpfh`, `yoho`, …).
    pub name: String,
    /// Dimension D.
    pub dim: usize,
    /// Hash of the descriptor's settings; empty where they are not known (imported heads).
    pub settings_hash: String,
}

/// The layer's kind and sizes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "head", rename_all = "kebab-case")]
pub enum Architecture {
    /// NetVLAD.
    Netvlad {
        /// Clusters K.
        clusters: usize,
    },
    /// Generalised mean.
    Gem {
        /// Added to the values before the power.
        shift: f32,
        /// Floor of the shifted values.
        floor: f32,
    },
}

/// What the head was trained on, for people.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct DataSummary {
    /// Names of the training scenes.
    pub train_scenes: Vec<String>,
    /// Names of the validation scenes.
    pub valid_scenes: Vec<String>,
    /// Scans in the training scenes.
    pub train_scans: usize,
    /// Scans in the validation scenes.
    pub valid_scans: usize,
    /// BLAKE3 of all features and poses, so that a run is only continued on the same data.
    pub hash: String,
}

/// Everything about a checkpoint but its numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CheckpointMeta {
    /// Layout of the file.
    pub format_version: u32,
    /// Short name for messages.
    pub name: String,
    /// Kind and sizes of the layer.
    pub architecture: Architecture,
    /// The descriptor it belongs to.
    pub descriptor: DescriptorTag,
    /// The training settings, or where an imported head comes from.
    pub recipe: serde_json::Value,
    /// What it was trained on.
    pub data: DataSummary,
    /// Validation scores at the time of writing, by name.
    pub metrics: BTreeMap<String, f64>,
    /// Epochs done.
    pub epoch: usize,
}

/// State of the optimiser, for continuing a training run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OptimizerState {
    /// Steps taken.
    pub steps: usize,
    /// First and second moment of every parameter, in the order the head declares them.
    pub moments: Vec<(Vec<f32>, Vec<f32>)>,
}

/// A head with its metadata.
#[derive(Debug, Clone, PartialEq)]
pub struct Checkpoint {
    /// What it is.
    pub meta: CheckpointMeta,
    /// Its parameters.
    pub weights: HeadWeights,
    /// Present in files that training can continue from.
    pub optimizer: Option<OptimizerState>,
}

/// The JSON beside the tensors. No other field: one whose name has a flipped bit must not be passed over.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Envelope {
    meta: CheckpointMeta,
    /// BLAKE3 of all tensors in name order, so that a flipped bit is noticed.
    tensors_blake3: String,
    optimizer_steps: Option<usize>,
}

impl Checkpoint {
    /// Architecture that goes with `weights`.
    pub fn architecture_of(weights: &HeadWeights) -> Architecture {
        match weights {
            HeadWeights::NetVlad(w) => Architecture::Netvlad { clusters: w.clusters() },
            HeadWeights::Gem { layer, .. } => Architecture::Gem { shift: layer.shift, floor: layer.floor },
        }
    }

    /// Writes the file: first under a temporary name beside it, then renamed over `path`, so that
    /// `path` holds either the old or the new checkpoint whole, whenever the process ends.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let bytes = self.to_bytes(path)?;
        atomic::write(path, |out| out.write_all(&bytes))
    }

    fn to_bytes(&self, path: &Path) -> Result<Vec<u8>> {
        let tensors = self.tensors();
        let envelope = Envelope {
            meta: self.meta.clone(),
            tensors_blake3: digest(&tensors),
            optimizer_steps: self.optimizer.as_ref().map(|o| o.steps),
        };
        let fail = |e: String| Error::write(path, std::io::Error::other(e));
        let json = serde_json::to_string(&envelope).map_err(|e| fail(e.to_string()))?;
        let views: Vec<(&String, TensorView<'_>)> = tensors
            .iter()
            .map(|(name, t)| Ok((name, TensorView::new(Dtype::F32, t.shape.clone(), &t.bytes)?)))
            .collect::<std::result::Result<_, safetensors::SafeTensorError>>()
            .map_err(|e| fail(e.to_string()))?;
        // One key only: the order of several would differ between runs.
        let info = HashMap::from([(META_KEY.to_owned(), tensor_file::sealed(&json))]);
        safetensors::serialize(views, Some(info)).map_err(|e| fail(e.to_string()))
    }

    fn tensors(&self) -> BTreeMap<String, Stored> {
        let mut all = BTreeMap::new();
        for (name, shape, values) in parameters(&self.weights) {
            all.insert(format!("head.{name}"), Stored::new(shape, values));
        }
        for (i, (first, second)) in self.optimizer.iter().flat_map(|o| &o.moments).enumerate() {
            all.insert(format!("optimizer.{i}.first"), Stored::new(vec![first.len()], first));
            all.insert(format!("optimizer.{i}.second"), Stored::new(vec![second.len()], second));
        }
        all
    }

    /// Reads a checkpoint of any descriptor.
    ///
    /// # Errors
    /// When the file cannot be read, is not one of ours, is cut short or altered, or has another
    /// format version.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = crate::files::read(path)?;
        Self::from_bytes(path, &bytes)
    }

    /// [`load`](Self::load) from the content of a file; `path` is for messages only.
    ///
    /// # Errors
    /// As [`load`](Self::load), but for reading.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self> {
        let broken = |found: String| {
            Error::file(path, found, format!("a complete head checkpoint of format {FORMAT_VERSION}"), REMEDY)
        };
        let foreign = |e: safetensors::SafeTensorError| {
            broken(format!("{} bytes that are not a whole safetensors file ({e})", bytes.len()))
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(foreign)?;
        let file = SafeTensors::deserialize(bytes).map_err(foreign)?;
        let json = header
            .metadata()
            .as_ref()
            .and_then(|m| m.get(META_KEY))
            .ok_or_else(|| broken("a safetensors file of another program".into()))?;
        check_version(json).map_err(broken)?;
        let json = tensor_file::unsealed(json).map_err(broken)?;
        let envelope: Envelope =
            serde_json::from_str(&json).map_err(|e| broken(format!("unreadable metadata ({e})")))?;
        let mut stored = BTreeMap::new();
        for (name, view) in file.tensors() {
            if view.dtype() != Dtype::F32 {
                return Err(broken(format!("tensor {name} of type {:?}", view.dtype())));
            }
            stored.insert(name, Stored { shape: view.shape().to_vec(), bytes: view.data().to_vec() });
        }
        if digest(&stored) != envelope.tensors_blake3 {
            return Err(broken("weights that do not match their checksum".into()));
        }
        let weights = read_weights(&envelope.meta, &stored).map_err(broken)?;
        let optimizer = envelope.optimizer_steps.map(|steps| read_optimizer(steps, &stored));
        Ok(Self { meta: envelope.meta, weights, optimizer })
    }

    /// [`load`](Self::load) for the descriptor at hand.
    ///
    /// # Errors
    /// As [`load`](Self::load), and when the head belongs to another descriptor, dimension or
    /// descriptor settings. An empty settings hash on either side fits any.
    pub fn load_for(path: &Path, descriptor: &DescriptorTag) -> Result<Self> {
        let checkpoint = Self::load(path)?;
        let own = &checkpoint.meta.descriptor;
        let remedy = "use a head trained on this descriptor, train one, or leave the checkpoint out";
        if own.name != descriptor.name || own.dim != descriptor.dim {
            let tell = |t: &DescriptorTag| format!("`{}` with {} dimensions", t.name, t.dim);
            return Err(Error::file(
                path,
                format!("a head for the descriptor {}", tell(own)),
                tell(descriptor),
                remedy,
            ));
        }
        let (a, b) = (&own.settings_hash, &descriptor.settings_hash);
        if !a.is_empty() && !b.is_empty() && a != b {
            return Err(Error::file(
                path,
                format!("a head for `{}` with settings {a}", own.name),
                format!("settings {b}"),
                remedy,
            ));
        }
        Ok(checkpoint)
    }
}

struct Stored {
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Stored {
    fn new(shape: Vec<usize>, values: &[f32]) -> Self {
        Self { shape, bytes: values.iter().flat_map(|v| v.to_le_bytes()).collect() }
    }

    fn values(&self) -> Vec<f32> {
        self.bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
    }
}

fn digest(tensors: &BTreeMap<String, Stored>) -> String {
    let mut hasher = blake3::Hasher::new();
    for (name, t) in tensors {
        hasher.update(name.as_bytes()).update(format!("{:?}", t.shape).as_bytes()).update(&t.bytes);
    }
    hasher.finalize().to_hex().to_string()
}

/// The version is looked at before anything else, so that a newer layout is named as such.
fn check_version(json: &str) -> std::result::Result<(), String> {
    let value: serde_json::Value =
        serde_json::from_str(json).map_err(|e| format!("unreadable metadata ({e})"))?;
    match value.pointer("/meta/format_version").and_then(serde_json::Value::as_u64) {
        Some(v) if v == u64::from(FORMAT_VERSION) => Ok(()),
        Some(v) => Err(format!("format version {v}")),
        None => Err("metadata without a format version".into()),
    }
}

/// Name, shape and values of every parameter, in declaration order.
fn parameters(weights: &HeadWeights) -> Vec<(&'static str, Vec<usize>, &[f32])> {
    match weights {
        HeadWeights::NetVlad(w) => vec![
            ("weight", vec![w.clusters(), w.dim], &w.weight),
            ("bias", vec![w.clusters()], &w.bias),
            ("centroids", vec![w.clusters(), w.dim], &w.centroids),
        ],
        HeadWeights::Gem { layer, .. } => vec![("power", vec![1], std::slice::from_ref(&layer.power))],
    }
}

fn read_weights(
    meta: &CheckpointMeta,
    stored: &BTreeMap<String, Stored>,
) -> std::result::Result<HeadWeights, String> {
    let dim = meta.descriptor.dim;
    let take = |name: &str, shape: &[usize]| {
        let t = stored.get(&format!("head.{name}")).ok_or_else(|| format!("no tensor head.{name}"))?;
        if t.shape != shape {
            return Err(format!("head.{name} of shape {:?} where {shape:?} belongs", t.shape));
        }
        let values = t.values();
        match values.iter().position(|v| !v.is_finite()) {
            Some(at) => Err(format!("{} at {at} of head.{name}", values[at])),
            None => Ok(values),
        }
    };
    Ok(match meta.architecture {
        Architecture::Netvlad { clusters } => HeadWeights::NetVlad(NetVlad {
            dim,
            weight: take("weight", &[clusters, dim])?,
            bias: take("bias", &[clusters])?,
            centroids: take("centroids", &[clusters, dim])?,
        }),
        Architecture::Gem { shift, floor } => {
            let power = take("power", &[1])?[0];
            HeadWeights::Gem { layer: Gem { power, shift, floor }, dim }
        }
    })
}

fn read_optimizer(steps: usize, stored: &BTreeMap<String, Stored>) -> OptimizerState {
    let moments = (0..)
        .map_while(|i| {
            let first = stored.get(&format!("optimizer.{i}.first"))?.values();
            Some((first, stored.get(&format!("optimizer.{i}.second"))?.values()))
        })
        .collect();
    OptimizerState { steps, moments }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Checkpoint {
        let weights = HeadWeights::NetVlad(NetVlad {
            dim: 3,
            weight: (0..6).map(|v| v as f32 * 0.1).collect(),
            bias: vec![-1.0, f32::MIN_POSITIVE],
            centroids: (0..6).map(|v| 1.0 / (v as f32 + 3.0)).collect(),
        });
        Checkpoint {
            meta: CheckpointMeta {
                format_version: FORMAT_VERSION,
                name: "sample".into(),
                architecture: Checkpoint::architecture_of(&weights),
                descriptor: DescriptorTag { name: "fpfh".into(), dim: 3, settings_hash: "ab".into() },
                recipe: serde_json::json!({"epochs": 3}),
                data: DataSummary::default(),
                metrics: BTreeMap::from([("mae".to_owned(), 0.1)]),
                epoch: 3,
            },
            weights,
            optimizer: Some(OptimizerState { steps: 9, moments: vec![(vec![0.5; 6], vec![0.25; 6])] }),
        }
    }

    fn saved() -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("head.safetensors");
        sample().save(&path).unwrap();
        (folder, path)
    }

    #[test]
    fn a_checkpoint_comes_back_bit_for_bit() {
        let (folder, path) = saved();
        assert_eq!(Checkpoint::load(&path).unwrap(), sample());
        let first = std::fs::read(&path).unwrap();
        sample().save(&path).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), first);
        // Nothing but the checkpoint is left in the folder.
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        let gem = HeadWeights::Gem { layer: Gem { power: 2.5, shift: 1.0, floor: 1e-6 }, dim: 3 };
        let mut checkpoint = sample();
        checkpoint.meta.architecture = Checkpoint::architecture_of(&gem);
        checkpoint.weights = gem;
        checkpoint.optimizer = None;
        checkpoint.save(&path).unwrap();
        assert_eq!(Checkpoint::load(&path).unwrap(), checkpoint);
    }

    #[test]
    fn every_cut_and_a_flipped_bit_are_one_clear_error() {
        let (_folder, path) = saved();
        let bytes = std::fs::read(&path).unwrap();
        for cut in [0, 1, 7, 8, 9, 100, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..cut]).unwrap();
            let message = Checkpoint::load(&path).unwrap_err().to_string();
            assert!(message.contains("not a whole safetensors file"), "{cut}: {message}");
        }
        let mut flipped = bytes.clone();
        *flipped.last_mut().unwrap() ^= 1;
        std::fs::write(&path, &flipped).unwrap();
        assert!(Checkpoint::load(&path).unwrap_err().to_string().contains("checksum"));
        // Metadata too: what a head was trained on, its settings, the steps of the optimiser.
        for at in 0..bytes.len() {
            let mut flipped = bytes.clone();
            flipped[at] ^= 1;
            assert!(Checkpoint::from_bytes(&path, &flipped).is_err(), "byte {at}");
        }
        std::fs::write(&path, b"ply\nformat ascii 1.0\n").unwrap();
        assert!(Checkpoint::load(&path).unwrap_err().to_string().contains("not a whole safetensors file"));
        let other: Vec<(String, TensorView<'_>)> = Vec::new();
        std::fs::write(&path, safetensors::serialize(other, None).unwrap()).unwrap();
        assert!(Checkpoint::load(&path).unwrap_err().to_string().contains("another program"));
    }

    #[test]
    fn the_wrong_descriptor_dimension_settings_or_version_is_refused_with_the_reason() {
        let (_folder, path) = saved();
        let tag = |name: &str, dim, hash: &str| DescriptorTag {
            name: name.into(),
            dim,
            settings_hash: hash.into(),
        };
        assert!(Checkpoint::load_for(&path, &tag("fpfh", 3, "ab")).is_ok());
        assert!(Checkpoint::load_for(&path, &tag("fpfh", 3, "")).is_ok());
        let refused = |t: DescriptorTag| Checkpoint::load_for(&path, &t).unwrap_err().to_string();
        let name = refused(tag("yoho", 3, "ab"));
        assert!(name.contains("`fpfh`") && name.contains("`yoho`"), "{name}");
        let dim = refused(tag("fpfh", 33, "ab"));
        assert!(dim.contains("3 dimensions") && dim.contains("33 dimensions"), "{dim}");
        let settings = refused(tag("fpfh", 3, "cd"));
        assert!(settings.contains("settings ab") && settings.contains("settings cd"), "{settings}");
        let mut newer = sample();
        newer.meta.format_version = FORMAT_VERSION + 1;
        newer.save(&path).unwrap();
        let version = Checkpoint::load(&path).unwrap_err().to_string();
        assert!(version.contains("found format version 2") && version.contains("format 1"), "{version}");
        assert!(matches!(Checkpoint::load(Path::new("nowhere")).unwrap_err(), Error::Read { .. }));
    }

    #[test]
    fn a_failed_write_keeps_the_old_file() {
        let (folder, path) = saved();
        // The temporary file cannot be made in a folder that is not there.
        assert!(sample().save(&folder.path().join("missing/head.safetensors")).is_err());
        assert_eq!(Checkpoint::load(&path).unwrap(), sample());
    }
}
