//! Heads published by others, in PyTorch's layout.

use super::Published;
use crate::retrieval::HeadWeights;
use crate::retrieval::NetVlad;
use crate::retrieval::{Checkpoint, CheckpointMeta, DataSummary, DescriptorTag, FORMAT_VERSION};
use crate::{Error, Result};
use burn::store::pytorch_reader::Tensor;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Whose layout a weight file has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Publisher {
    /// SGHR (Wang et al., CVPR 2023): `network_state_dict`, then `vlador.pool.*`.
    Sghr,
    /// IMVR (Li et al., Pattern Recognition 2025), which builds on SGHR's training code.
    Imvr,
}

/// Imports SGHR's NetVLAD head: `conv.weight` `[K,D,1,1]`, `conv.bias` `[K]`, `centroids` `[K,D]`.
///
/// # Errors
/// When the file is not a PyTorch checkpoint or lacks one of the tensors.
pub fn sghr(path: &Path, descriptor: &str) -> Result<Checkpoint> {
    import(path, Publisher::Sghr, descriptor)
}

/// Imports IMVR's NetVLAD head, stored as SGHR's.
///
/// # Errors
/// As [`sghr`].
pub fn imvr(path: &Path, descriptor: &str) -> Result<Checkpoint> {
    import(path, Publisher::Imvr, descriptor)
}

/// Imports a published NetVLAD head for the descriptor named `descriptor`.
///
/// The tensors are looked up by the end of their name, with or without the wrapping dictionaries,
/// because published files differ in those only.
///
/// # Errors
/// As [`sghr`].
pub fn import(path: &Path, from: Publisher, descriptor: &str) -> Result<Checkpoint> {
    let wrong = |found: String| {
        Error::file(
            path,
            found,
            "a PyTorch checkpoint with conv.weight [K,D,1,1], conv.bias [K] and centroids [K,D]",
            "pass the .pth file of the NetVLAD head as its authors published it",
        )
    };
    let file = Published::open(path)?.map_err(wrong)?;
    let centroids = take(&file, "centroids").map_err(wrong)?;
    let bias = take(&file, "conv.bias").map_err(wrong)?;
    let weight = take(&file, "conv.weight").map_err(wrong)?;
    let [clusters, dim] = centroids.0[..] else {
        return Err(wrong(format!("centroids of shape {:?}", centroids.0)));
    };
    if bias.0 != [clusters] || weight.1.len() != clusters * dim || !weight.0.starts_with(&[clusters, dim]) {
        return Err(wrong(format!(
            "centroids of shape {:?}, conv.weight of {:?}, conv.bias of {:?}",
            centroids.0, weight.0, bias.0
        )));
    }
    let weights =
        HeadWeights::NetVlad(NetVlad { dim, weight: weight.1, bias: bias.1, centroids: centroids.1 });
    let publisher = match from {
        Publisher::Sghr => "SGHR",
        Publisher::Imvr => "IMVR",
    };
    let file = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Checkpoint {
        meta: CheckpointMeta {
            format_version: FORMAT_VERSION,
            name: format!("netvlad-{descriptor}-{}", publisher.to_lowercase()),
            architecture: Checkpoint::architecture_of(&weights),
            descriptor: DescriptorTag { name: descriptor.to_owned(), dim, settings_hash: String::new() },
            recipe: serde_json::json!({ "imported_from": publisher, "file": file }),
            data: DataSummary::default(),
            metrics: BTreeMap::new(),
            epoch: 0,
        },
        weights,
        optimizer: None,
    })
}

type Values = (Vec<usize>, Vec<f32>);

/// Shape and values of the one tensor whose name ends in `ending`.
fn take(file: &Published, ending: &str) -> std::result::Result<Values, String> {
    let tensors: BTreeMap<&str, &Tensor> =
        file.reader.tensors().iter().map(|(name, tensor)| (name.as_str(), tensor)).collect();
    let fits = |name: &str| name == ending || name.ends_with(&format!(".{ending}"));
    let mut hits = tensors.iter().filter(|(name, _)| fits(name));
    let (name, tensor) = hits.next().ok_or_else(|| {
        let names: Vec<&str> = tensors.keys().copied().collect();
        format!("no {ending} among the tensors [{}]", names.join(", "))
    })?;
    if let Some((second, _)) = hits.find(|(other, _)| !other.starts_with("optimizer")) {
        return Err(format!("both {name} and {second}"));
    }
    let values = file.values(name, tensor)?;
    if values.iter().any(|v| !v.is_finite()) {
        return Err(format!("{name} with values that are not finite"));
    }
    Ok((tensor.shape().to_vec(), values))
}
