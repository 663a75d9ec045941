//! Weights of LITS (Yew & Lee 2021), as its authors published them.

use super::Published;
use crate::synchronization::LitsWeights;
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// What published names start with.
const PUBLISHED: &str = "meta_op.";

/// Reads the PyTorch checkpoint that the authors published.
///
/// # Errors
/// When the file cannot be read, is no PyTorch checkpoint, or its layers are other ones.
pub fn lits(path: &Path) -> Result<LitsWeights> {
    let remedy = "pass the .pth file of LITS as its authors published it";
    let wrong = |found: String| {
        Error::file(path, found, "a PyTorch checkpoint of the LITS network for SE(3)", remedy)
    };
    let file = Published::open(path)?.map_err(wrong)?;
    let mut stored = BTreeMap::new();
    for (name, tensor) in file.reader.tensors().iter().collect::<BTreeMap<_, _>>() {
        let Some((_, name)) = name.split_once(PUBLISHED).filter(|_| !name.starts_with("optimizer")) else {
            continue;
        };
        let values = file.values(name, tensor).map_err(wrong)?;
        stored.insert(name.to_owned(), (tensor.shape().to_vec(), values));
    }
    LitsWeights::from_tensors(stored).map_err(wrong)
}
