//! Weights of the network as a file.

use super::network::{GLOBAL, HIDDEN, NODE};
use crate::error::{Error, Result};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

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
        match header.metadata().as_ref().and_then(|m| m.get(META_KEY)) {
            Some(version) if version == FORMAT_VERSION => {}
            Some(version) => return Err(wrong(format!("format {version}"))),
            None => return Err(wrong("a safetensors file of another kind".to_owned())),
        }
        let file = SafeTensors::deserialize(&bytes).map_err(foreign)?;
        let mut stored = BTreeMap::new();
        for (name, view) in file.tensors() {
            if view.dtype() != Dtype::F32 {
                return Err(wrong(format!("{name} of type {:?}", view.dtype())));
            }
            stored.insert(name, (view.shape().to_vec(), floats(view.data())));
        }
        Self::from_tensors(stored).map_err(wrong)
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
        let meta = HashMap::from([(META_KEY.to_owned(), FORMAT_VERSION.to_owned())]);
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
