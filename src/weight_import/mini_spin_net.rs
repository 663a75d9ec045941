//! Weights published by the authors of BUFFER, in PyTorch's layout.

use crate::descriptor::mini_spin_net::{
    Architecture, Checkpoint, DESCRIPTOR, FORMAT_VERSION, Layer, LayerShape, Meta, Norm, RADII, Weights,
};
use crate::{Error, Result};
use burn::store::pytorch_reader::{DType, PytorchReader, Tensor};
use std::collections::BTreeMap;
use std::path::Path;

/// Names of the layers in the published file, in the order of [`Architecture::shapes`]; the
/// number of a normalisation follows that of its layer.
const LAYERS: [(&str, usize); 11] = [
    ("Desc.pnt_layer", 0),
    ("Desc.conv_net.ops", 0),
    ("Desc.conv_net.ops", 3),
    ("Desc.conv_net.ops", 6),
    ("Desc.conv_net.ops", 9),
    ("Desc.conv_net.ops", 12),
    ("Desc.conv_net.ops", 15),
    ("Desc.conv_net.ops", 18),
    ("Desc.conv_net.ops", 21),
    ("Desc.pool_layer", 0),
    ("Desc.pool_layer", 3),
];

/// Imports MiniSpinNet of BUFFER (Ao et al., CVPR 2023): the tensors `Desc.*` of its checkpoint.
///
/// # Errors
/// When the file is not a PyTorch checkpoint, or lacks one of the tensors.
pub fn buffer(path: &Path) -> Result<Checkpoint> {
    // The reader's own message for a missing file hides the reason.
    std::fs::File::open(path).map_err(|e| Error::read(path, e))?;
    let wrong = |found: String| {
        let expected = "a PyTorch checkpoint with the tensors Desc.* of BUFFER's MiniSpinNet";
        Error::file(path, found, expected, "pass the .pth file of the descriptor as its authors published it")
    };
    let tensors: BTreeMap<String, Tensor> = PytorchReader::new(path)
        .map_err(|e| wrong(format!("something else ({e})")))?
        .into_tensors()
        .into_iter()
        .collect();
    let architecture = Architecture::default();
    let layers =
        architecture.shapes().into_iter().zip(LAYERS).enumerate().map(|(at, (shape, (prefix, number)))| {
            let layer = read_layer(&tensors, &shape, prefix, number)?;
            Ok(if at == 1 { shells_as_channels(layer, &shape, architecture.point_channels) } else { layer })
        });
    let weights = Weights {
        layers: layers.collect::<std::result::Result<_, String>>().map_err(wrong)?,
        architecture: architecture.clone(),
    };
    let file = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Checkpoint {
        meta: Meta {
            format_version: FORMAT_VERSION,
            descriptor: DESCRIPTOR.to_owned(),
            name: "mini-spin-net-buffer".to_owned(),
            architecture,
            source: "BUFFER (Ao, Hu, Wang, Xu, Guo, CVPR 2023), https://github.com/aosheng1996/BUFFER"
                .to_owned(),
            licence: "MIT".to_owned(),
            recipe: serde_json::json!({ "imported_from": "BUFFER", "file": file }),
            metrics: BTreeMap::new(),
            steps: 0,
        },
        weights,
    })
}

fn read_layer(
    tensors: &BTreeMap<String, Tensor>,
    shape: &LayerShape,
    prefix: &str,
    number: usize,
) -> std::result::Result<Layer, String> {
    let LayerShape { inputs, outputs, taps, .. } = shape;
    let weight = take(tensors, &format!("{prefix}.{number}.weight"), inputs * outputs * taps)?;
    let bias = take(tensors, &format!("{prefix}.{number}.bias"), *outputs)?;
    let behind = format!("{prefix}.{}", number + 1);
    let has = |part: &str| tensors.contains_key(&format!("{behind}.{part}"));
    let norm = if has("running_mean") {
        let part = |name: &str| take(tensors, &format!("{behind}.{name}"), *outputs);
        let affine = if has("weight") { Some((part("weight")?, part("bias")?)) } else { None };
        Some(Norm { mean: part("running_mean")?, variance: part("running_var")?, affine })
    } else {
        None
    };
    Ok(Layer { weight, bias, norm })
}

/// The filter `[outputs, channels, radius, 3, 3]` of the first convolution as
/// `[outputs, radius · channels, 3, 3]`.
fn shells_as_channels(layer: Layer, shape: &LayerShape, channels: usize) -> Layer {
    let LayerShape { inputs, taps, .. } = shape;
    let mut weight = vec![0.0; layer.weight.len()];
    for (at, value) in layer.weight.iter().enumerate() {
        let (output, rest) = (at / (inputs * taps), at % (inputs * taps));
        let (channel, radius, tap) = (rest / (RADII * taps), rest / taps % RADII, rest % taps);
        weight[(output * inputs + radius * channels + channel) * taps + tap] = *value;
    }
    Layer { weight, ..layer }
}

fn take(
    tensors: &BTreeMap<String, Tensor>,
    name: &str,
    length: usize,
) -> std::result::Result<Vec<f32>, String> {
    let tensor = tensors.get(name).ok_or_else(|| {
        let names: Vec<&str> = tensors.keys().map(String::as_str).take(8).collect();
        format!("no {name} among the {} tensors [{}, …]", tensors.len(), names.join(", "))
    })?;
    if tensor.dtype() != DType::F32 || tensor.shape().iter().product::<usize>() != length {
        return Err(format!("{name} of type {:?} and shape {:?}", tensor.dtype(), tensor.shape()));
    }
    let bytes = tensor.read().map_err(|e| format!("an unreadable {name} ({e})"))?;
    let values: Vec<f32> =
        bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    if values.iter().any(|v| !v.is_finite()) {
        return Err(format!("{name} with values that are not finite"));
    }
    Ok(values)
}
