//! Weights of LITS (Yew & Lee 2021), as its authors published them.

use crate::synchronization::LitsWeights;
use crate::{Error, Result};
use burn::store::pytorch_reader::{DType, PytorchReader};
use std::collections::BTreeMap;
use std::path::Path;

/// What published names start with.
const PUBLISHED: &str = "meta_op.";

/// Reads the PyTorch checkpoint that the authors published.
///
/// # Errors
/// When the file cannot be read, is no PyTorch checkpoint, or its layers are other ones.
pub fn lits(path: &Path) -> Result<LitsWeights> {
    // The reader's own message for a missing file hides the reason.
    std::fs::File::open(path).map_err(|e| Error::read(path, e))?;
    let remedy = "pass the .pth file of LITS as its authors published it";
    let wrong = |found: String| {
        Error::file(path, found, "a PyTorch checkpoint of the LITS network for SE(3)", remedy)
    };
    let reader = PytorchReader::new(path).map_err(|e| wrong(format!("something else ({e})")))?;
    let mut stored = BTreeMap::new();
    for (name, tensor) in reader.tensors().iter().collect::<BTreeMap<_, _>>() {
        let Some((_, name)) = name.split_once(PUBLISHED).filter(|_| !name.starts_with("optimizer")) else {
            continue;
        };
        if tensor.dtype() != DType::F32 {
            return Err(wrong(format!("{name} of type {:?}", tensor.dtype())));
        }
        let bytes = tensor.read().map_err(|e| wrong(format!("an unreadable {name} ({e})")))?;
        stored.insert(
            name.to_owned(),
            (
                tensor.shape().to_vec(),
                bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
            ),
        );
    }
    LitsWeights::from_tensors(stored).map_err(wrong)
}
