//! Weights published by others, in PyTorch's layout.

pub(crate) mod lits;
pub(crate) mod mini_spin_net;
pub(crate) mod overlap_head;

use crate::{Result, files};
use burn::store::pytorch_reader::{DType, PytorchReader, Tensor};
use std::cell::Cell;
use std::path::Path;

/// A PyTorch checkpoint whose values are read on demand.
struct Published {
    reader: PytorchReader,
    file_bytes: u64,
    /// Bytes of the file that no value was read from yet.
    left: Cell<u64>,
}

impl Published {
    /// Opens a file. What is wrong with it is the inner error, which the caller puts into words.
    ///
    /// # Errors
    /// When the file cannot be opened.
    fn open(path: &Path) -> Result<std::result::Result<Self, String>> {
        // The reader's own message for a missing file hides the reason.
        let file = files::open(path)?;
        let file_bytes = file.metadata().map_err(|e| crate::Error::read(path, e))?.len();
        let reader = PytorchReader::new(path).map_err(|e| format!("something else ({e})"));
        Ok(reader.map(|reader| Self { reader, file_bytes, left: Cell::new(file_bytes) }))
    }

    /// The values of a tensor of 32-bit floats.
    fn values(&self, name: &str, tensor: &Tensor) -> std::result::Result<Vec<f32>, String> {
        let (shape, dtype) = (tensor.shape(), tensor.dtype());
        if dtype != DType::F32 {
            return Err(format!("{name} of type {dtype:?}"));
        }
        // Values of a saved network stand in the file as they are. A view may repeat one number at no
        // cost, and the archive may be packed: both can ask for any amount of memory.
        let needed = shape.iter().try_fold(4u64, |bytes, &n| bytes.checked_mul(n as u64));
        let Some(left) = needed.and_then(|needed| self.left.get().checked_sub(needed)) else {
            return Err(format!("{name} of shape {shape:?} in a file of {} bytes", self.file_bytes));
        };
        self.left.set(left);
        let bytes = tensor.read().map_err(|e| format!("an unreadable {name} ({e})"))?;
        Ok(bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
    }
}

#[cfg(test)]
mod tests;

pub use lits::lits;
pub use mini_spin_net::buffer;
pub use overlap_head::{Publisher, import, imvr, sghr};
