//! Networks as files.

use super::inference::Network;
use super::weights::{Architecture, Weights};
use crate::error::{Error, Result};
use crate::tensor_file;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Version of the file's layout that this code writes and reads.
pub const FORMAT_VERSION: u32 = 1;
const EXPECTED: &str = "a MiniSpinNet checkpoint";

/// Everything about a network but its numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Meta {
    /// Layout of the file.
    pub format_version: u32,
    /// What the file holds: always `mini-spin-net`.
    pub descriptor: String,
    /// Short name for messages.
    pub name: String,
    /// Numbers of channels.
    pub architecture: Architecture,
    /// Where the weights come from.
    pub source: String,
    /// Under which licence.
    pub licence: String,
    /// The training settings, or the file that was imported.
    pub recipe: serde_json::Value,
    /// Scores at the time of writing, by name.
    pub metrics: BTreeMap<String, f64>,
    /// Steps trained here; 0 for an imported network.
    pub steps: usize,
}

/// Value of [`Meta::descriptor`].
pub const DESCRIPTOR: &str = "mini-spin-net";

/// A network with its metadata.
#[derive(Debug, Clone, PartialEq)]
pub struct Checkpoint {
    /// What it is.
    pub meta: Meta,
    /// Its parameters.
    pub weights: Weights,
}

impl Checkpoint {
    /// Writes the file whole or not at all.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        tensor_file::save_arrays(path, &self.meta, &self.weights.to_arrays())
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// When the file cannot be read, is no network of ours, is cut short or altered.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = crate::files::read(path)?;
        Self::from_bytes(path, &bytes)
    }

    /// [`load`](Self::load) from the content of a file; `path` is for messages only.
    ///
    /// # Errors
    /// As [`load`](Self::load), but for reading.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self> {
        let (meta, arrays): (Meta, _) = tensor_file::parse_arrays(path, bytes, EXPECTED)?;
        let broken = |found: String| {
            Error::file(path, found, EXPECTED, "use a file of `scanweave train descriptor` or import-weights")
        };
        if meta.format_version != FORMAT_VERSION || meta.descriptor != DESCRIPTOR {
            let found = format!("format {} of descriptor `{}`", meta.format_version, meta.descriptor);
            return Err(broken(format!(
                "{found}, where this program knows {FORMAT_VERSION} of `{DESCRIPTOR}`"
            )));
        }
        let weights = Weights::from_arrays(&meta.architecture, &arrays).map_err(broken)?;
        Ok(Self { meta, weights })
    }
}

/// The network that comes with the program, of the repository's `checkpoints/`.
const SHIPPED: (&str, &[u8]) =
    ("minispinnet.safetensors", include_bytes!("../../../../../checkpoints/minispinnet.safetensors"));

/// The built-in network.
///
/// # Errors
/// None for a program that was built whole.
pub fn shipped() -> Result<LoadedNetwork> {
    let (file, bytes) = SHIPPED;
    Ok(LoadedNetwork::new(&Checkpoint::from_bytes(Path::new(file), bytes)?.weights))
}

/// A network ready to run, and a digest of its numbers. Cheap to clone.
#[derive(Debug, Clone)]
pub struct LoadedNetwork {
    network: Arc<Network>,
    digest: Arc<str>,
}

impl LoadedNetwork {
    /// Folds the weights.
    pub fn new(weights: &Weights) -> Self {
        let digest = tensor_file::digest_of_arrays(&weights.to_arrays());
        Self { network: Arc::new(Network::new(weights)), digest: digest.into() }
    }

    /// The network.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// BLAKE3 of its parameters, hex.
    pub fn digest(&self) -> &str {
        &self.digest
    }
}
