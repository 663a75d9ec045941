//! Weights published by the authors of BUFFER, in PyTorch's layout.

use super::Published;
use crate::descriptor::mini_spin_net::{
    Architecture, Checkpoint, DESCRIPTOR, FORMAT_VERSION, Layer, LayerShape, Meta, Norm, RADII, Weights,
};
use crate::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
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
    let wrong = |found: String| {
        let expected = "a PyTorch checkpoint with the tensors Desc.* of BUFFER's MiniSpinNet";
        Error::file(path, found, expected, "pass the .pth file of the descriptor as its authors published it")
    };
    let file = Published::open(path)?.map_err(wrong)?;
    let architecture = Architecture::default();
    let layers =
        architecture.shapes().into_iter().zip(LAYERS).enumerate().map(|(at, (shape, (prefix, number)))| {
            let layer = read_layer(&file, &shape, prefix, number)?;
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
    file: &Published,
    shape: &LayerShape,
    prefix: &str,
    number: usize,
) -> std::result::Result<Layer, String> {
    let LayerShape { inputs, outputs, taps, .. } = shape;
    let weight = take(file, &format!("{prefix}.{number}.weight"), inputs * outputs * taps)?;
    let bias = take(file, &format!("{prefix}.{number}.bias"), *outputs)?;
    let behind = format!("{prefix}.{}", number + 1);
    let has = |part: &str| file.reader.get(&format!("{behind}.{part}")).is_some();
    let norm = if has("running_mean") {
        let part = |name: &str| take(file, &format!("{behind}.{name}"), *outputs);
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

fn take(file: &Published, name: &str, length: usize) -> std::result::Result<Vec<f32>, String> {
    let tensor = file.reader.get(name).ok_or_else(|| {
        let tensors = file.reader.tensors();
        let names: BTreeSet<&str> = tensors.keys().map(String::as_str).collect();
        let names: Vec<&str> = names.into_iter().take(8).collect();
        format!("no {name} among the {} tensors [{}, …]", tensors.len(), names.join(", "))
    })?;
    let values = file.values(name, tensor)?;
    if values.len() != length {
        return Err(format!("{name} of shape {:?}", tensor.shape()));
    }
    if values.iter().any(|v| !v.is_finite()) {
        return Err(format!("{name} with values that are not finite"));
    }
    Ok(values)
}
