//! Checkpoints: any safetensors file, our own with their metadata and checksum.

use crate::retrieval::Checkpoint;
use crate::{Error, Result, files};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Metadata key under which our own files keep their metadata.
const OURS: &str = "scanweave";

/// What a checkpoint is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckpointContent {
    /// Whether this program wrote it; its checksum is then right, or it would not be read.
    pub ours: bool,
    /// Its metadata; of a foreign file, its metadata as it is.
    pub metadata: Value,
    /// Numbers in all tensors.
    pub parameters: usize,
    /// Tensors by name.
    pub tensors: Vec<TensorContent>,
}

/// One tensor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TensorContent {
    /// Its name.
    pub name: String,
    /// Type of its numbers.
    pub dtype: String,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Least and greatest finite number; null for types other than 32-bit floats.
    pub range: Option<[f32; 2]>,
    /// Mean of the finite numbers, likewise.
    pub mean: Option<f64>,
    /// Numbers that are not finite.
    pub not_finite: usize,
}

pub(super) fn checkpoint(path: &Path) -> Result<CheckpointContent> {
    let bytes = files::read(path)?;
    let foreign = |e: safetensors::SafeTensorError| {
        let found = format!("{} bytes that are not a whole safetensors file ({e})", bytes.len());
        Error::file(path, found, "a safetensors file", "copy or export it again")
    };
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(foreign)?;
    let file = SafeTensors::deserialize(&bytes).map_err(foreign)?;
    let metadata: BTreeMap<String, String> =
        header.metadata().clone().unwrap_or_default().into_iter().collect();
    let ours = metadata.get(OURS).and_then(|text| serde_json::from_str::<Value>(text).ok());
    if let Some(papers) = &ours {
        check(path, &bytes, papers)?;
    }
    let mut tensors: Vec<TensorContent> =
        file.tensors().iter().map(|(name, view)| tensor(name, view)).collect();
    tensors.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(CheckpointContent {
        ours: ours.is_some(),
        metadata: match ours {
            Some(papers) => papers.get("meta").cloned().unwrap_or(papers),
            None => serde_json::json!(metadata),
        },
        parameters: tensors.iter().map(|t| t.shape.iter().product::<usize>()).sum(),
        tensors,
    })
}

/// Reads one of our own files as whoever uses it would: an altered one is an error.
fn check(path: &Path, bytes: &[u8], papers: &Value) -> Result<()> {
    if papers.pointer("/meta/architecture/head").is_some() {
        return Checkpoint::from_bytes(path, bytes).map(|_| ());
    }
    files::parse_arrays::<Value>(path, bytes, "a whole checkpoint").map(|_| ())
}

fn tensor(name: &str, view: &TensorView<'_>) -> TensorContent {
    let values: Vec<f32> = match view.dtype() {
        Dtype::F32 => {
            view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
        }
        _ => Vec::new(),
    };
    let finite: Vec<f32> = values.iter().copied().filter(|v| v.is_finite()).collect();
    TensorContent {
        name: name.to_owned(),
        dtype: format!("{:?}", view.dtype()),
        shape: view.shape().to_vec(),
        range: super::content::range(&finite),
        mean: (!finite.is_empty())
            .then(|| finite.iter().map(|&v| f64::from(v)).sum::<f64>() / finite.len() as f64),
        not_finite: values.len() - finite.len(),
    }
}
