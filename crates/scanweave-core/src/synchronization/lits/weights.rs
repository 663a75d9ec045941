//! Weights of the network as a file.

use super::network::{GLOBAL, HIDDEN, NODE};
use crate::error::{Error, Result};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Its value is the format, a blank, and the digest of the weights, which early files of it lack.
const META_KEY: &str = "scanweave-lits";
const FORMAT_VERSION: &str = "1";

/// Input of a message: two states and an error.
const MESSAGE: usize = 2 * NODE + 12;
/// Layer, inputs, outputs.
const LAYERS: [(&str, usize, usize); 10] = [
    ("global_model.global_mlp.0", GLOBAL + NODE, HIDDEN),
    ("global_model.global_mlp.2", HIDDEN, GLOBAL),
    ("node_model.node_mlp_1.0", MESSAGE, HIDDEN),
    ("node_model.node_mlp_1.2", HIDDEN, HIDDEN),
    ("node_model.node_mlp_2.0", HIDDEN + NODE + GLOBAL, HIDDEN),
    ("node_model.node_mlp_2.2", HIDDEN, NODE + 6),
    ("node_model.weights_mlp_1.0", MESSAGE, HIDDEN),
    ("node_model.weights_mlp_1.2", HIDDEN, HIDDEN / 2),
    ("node_model.weights_mlp_2.0", HIDDEN, HIDDEN),
    ("node_model.weights_mlp_2.2", HIDDEN, 1),
];

/// Weights of the LITS network.
#[derive(Debug, Clone, PartialEq)]
pub struct LitsWeights {
    /// `<layer>.weight` `[out·in]` and `<layer>.bias` `[out]`.
    tensors: BTreeMap<String, Vec<f32>>,
}

impl LitsWeights {
    /// Reads a file of our own.
    ///
    /// # Errors
    /// When the file cannot be read or is not what [`to_bytes`](Self::to_bytes) makes.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = crate::files::read(path)?;
        let wrong = |found: String| {
            let remedy = "make one with `scanweave import-weights --from lits`";
            Error::file(path, found, format!("weights of LITS, format {FORMAT_VERSION}"), remedy)
        };
        let foreign = |e: safetensors::SafeTensorError| wrong(format!("no whole safetensors file ({e})"));
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(foreign)?;
        let Some(stated) = header.metadata().as_ref().and_then(|m| m.get(META_KEY)) else {
            return Err(wrong("a safetensors file of another kind".to_owned()));
        };
        let (version, checksum) = match stated.split_once(' ') {
            Some((version, checksum)) => (version, Some(checksum)),
            None => (stated.as_str(), None),
        };
        if version != FORMAT_VERSION {
            return Err(wrong(format!("format {version}")));
        }
        let file = SafeTensors::deserialize(&bytes).map_err(foreign)?;
        let mut stored = BTreeMap::new();
        for (name, view) in file.tensors() {
            if view.dtype() != Dtype::F32 {
                return Err(wrong(format!("{name} of type {:?}", view.dtype())));
            }
            stored.insert(name, (view.shape().to_vec(), floats(view.data())));
        }
        let weights = Self::from_tensors(stored).map_err(wrong)?;
        match checksum {
            Some(checksum) if checksum != weights.digest() => {
                Err(wrong("weights that do not match their checksum".to_owned()))
            }
            _ => Ok(weights),
        }
    }

    /// BLAKE3 of names and values, as a hex digest; shapes follow from the names.
    fn digest(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        for (name, values) in &self.tensors {
            hasher.update(name.as_bytes());
            values.iter().for_each(|v| {
                hasher.update(&v.to_le_bytes());
            });
        }
        hasher.finalize().to_hex().to_string()
    }

    /// The content of a file that [`load`](Self::load) reads.
    ///
    /// # Errors
    /// None that a network with all its layers could cause.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let bytes: BTreeMap<&String, (Vec<usize>, Vec<u8>)> = self
            .tensors
            .iter()
            .map(|(name, values)| {
                let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
                (name, (shape_of(name).unwrap_or_default(), bytes))
            })
            .collect();
        let wrong = |e: safetensors::SafeTensorError| {
            Error::input("weights of LITS", e.to_string(), "whole layers", "import them again")
        };
        let views: Vec<(&String, TensorView<'_>)> = bytes
            .iter()
            .map(|(name, (shape, data))| Ok((*name, TensorView::new(Dtype::F32, shape.clone(), data)?)))
            .collect::<std::result::Result<_, safetensors::SafeTensorError>>()
            .map_err(wrong)?;
        let meta = HashMap::from([(META_KEY.to_owned(), format!("{FORMAT_VERSION} {}", self.digest()))]);
        safetensors::serialize(views, Some(meta)).map_err(wrong)
    }

    /// Weight `[out·in]`, row by row, and bias `[out]` of a layer; empty for an unknown name.
    pub(super) fn layer(&self, name: &str) -> (&[f32], &[f32]) {
        let get = |part: &str| self.tensors.get(&format!("{name}.{part}")).map_or(&[][..], Vec::as_slice);
        (get("weight"), get("bias"))
    }

    /// Weights from tensors by name, each with its shape: all layers in their shapes, and nothing else.
    ///
    /// # Errors
    /// What is wrong with them, in words.
    pub fn from_tensors(
        stored: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
    ) -> std::result::Result<Self, String> {
        for (layer, _, _) in LAYERS {
            for part in ["weight", "bias"] {
                let name = format!("{layer}.{part}");
                if !stored.contains_key(&name) {
                    return Err(format!("no {name}"));
                }
            }
        }
        let mut tensors = BTreeMap::new();
        for (name, (shape, values)) in stored {
            match shape_of(&name) {
                None => return Err(format!("an unknown tensor {name}")),
                Some(expected) if expected != shape => {
                    return Err(format!("{name} of shape {shape:?} where {expected:?} belongs"));
                }
                Some(_) if values.iter().any(|v| !v.is_finite()) => {
                    return Err(format!("{name} with values that are not finite"));
                }
                Some(_) => {
                    tensors.insert(name, values);
                }
            }
        }
        Ok(Self { tensors })
    }
}

/// Shape of a tensor by its name.
fn shape_of(name: &str) -> Option<Vec<usize>> {
    let (layer, part) = name.rsplit_once('.')?;
    let (_, inputs, outputs) = LAYERS.iter().find(|l| l.0 == layer)?;
    match part {
        "weight" => Some(vec![*outputs, *inputs]),
        "bias" => Some(vec![*outputs]),
        _ => None,
    }
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bit_turned_over_is_noticed_and_files_without_a_checksum_are_read() {
        let tensors = LAYERS.iter().flat_map(|(layer, inputs, outputs)| {
            let values = |n: usize| (0..n).map(|k| k as f32 * 0.25).collect::<Vec<f32>>();
            [
                (format!("{layer}.weight"), (vec![*outputs, *inputs], values(inputs * outputs))),
                (format!("{layer}.bias"), (vec![*outputs], values(*outputs))),
            ]
        });
        let weights = LitsWeights::from_tensors(tensors.collect()).unwrap();
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("lits.safetensors");
        let load = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            LitsWeights::load(&path)
        };
        let mut bytes = weights.to_bytes().unwrap();
        assert_eq!(load(&bytes).unwrap(), weights);
        *bytes.last_mut().unwrap() ^= 1;
        let message = load(&bytes).unwrap_err().to_string();
        assert!(message.contains("lits.safetensors") && message.contains("checksum"), "{message}");
        // As files were written before: the format alone, and blanks in the place of the digest.
        let digest = weights.digest();
        let at = bytes.windows(64).position(|w| w == digest.as_bytes()).unwrap();
        bytes[at - 1] = b'"';
        bytes[at..at + 64].fill(b' ');
        bytes[at + 64] = b' ';
        assert!(load(&bytes).is_ok());
    }
}
