//! Named arrays of numbers with their metadata, in one safetensors file.
//!
//! The metadata is JSON under the key `scanweave`; checksums over all arrays and over the metadata notice a
//! flipped bit. The same content gives the same bytes.

use crate::atomic;
use crate::error::{Error, Result};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;

const META_KEY: &str = "scanweave";

/// A row-major array of single-precision numbers.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Array {
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its values.
    pub values: Vec<f32>,
}

impl Array {
    /// An array of the given shape, whose product is the number of values.
    pub fn new(shape: &[usize], values: Vec<f32>) -> Self {
        debug_assert_eq!(shape.iter().product::<usize>(), values.len());
        Self { shape: shape.to_vec(), values }
    }

    fn bytes(&self) -> Vec<u8> {
        self.values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }
}

/// Arrays by name.
pub type Arrays = BTreeMap<String, Array>;

// No other field: one whose name has a flipped bit must not be passed over.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Envelope<M> {
    meta: M,
    /// BLAKE3 of all arrays in name order.
    tensors_blake3: String,
}

/// BLAKE3 of names, shapes and values, as a hex digest.
pub fn digest_of_arrays(arrays: &Arrays) -> String {
    let mut hasher = blake3::Hasher::new();
    for (name, array) in arrays {
        hasher.update(name.as_bytes());
        array.shape.iter().for_each(|n| {
            hasher.update(&(*n as u64).to_le_bytes());
        });
        hasher.update(&array.bytes());
    }
    hasher.finalize().to_hex().to_string()
}

/// What stands before the checksum of metadata, their last field.
const SEAL: &str = ",\"metadata_blake3\":\"";

/// Metadata, a JSON object with fields, with the BLAKE3 of its text as a further field.
pub(crate) fn sealed(json: &str) -> String {
    let open = json.strip_suffix('}').unwrap_or(json);
    format!("{open}{SEAL}{}\"}}", blake3::hash(json.as_bytes()).to_hex())
}

/// Metadata without their checksum; as they are where there is none, as older versions wrote them.
///
/// # Errors
/// What is there in their place, when they do not match it.
pub(crate) fn unsealed(text: &str) -> std::result::Result<Cow<'_, str>, String> {
    // In a string these quotes would be escaped.
    let Some((open, digest)) = text.rsplit_once(SEAL) else { return Ok(Cow::Borrowed(text)) };
    let json = format!("{open}}}");
    match digest.strip_suffix("\"}") {
        Some(digest) if digest == blake3::hash(json.as_bytes()).to_hex().as_str() => Ok(Cow::Owned(json)),
        _ => Err("metadata that do not match their checksum".to_owned()),
    }
}

/// Writes the file under a temporary name beside it and renames it over `path`, so that `path`
/// holds either the old or the new content whole.
///
/// # Errors
/// When the folder cannot be written.
pub fn save_arrays<M: Serialize>(path: &Path, meta: &M, arrays: &Arrays) -> Result<()> {
    let fail = |e: String| Error::write(path, std::io::Error::other(e));
    let envelope = Envelope { meta, tensors_blake3: digest_of_arrays(arrays) };
    let json = serde_json::to_string(&envelope).map_err(|e| fail(e.to_string()))?;
    let bytes: Vec<(&String, &Array, Vec<u8>)> = arrays.iter().map(|(n, a)| (n, a, a.bytes())).collect();
    let views: Vec<(&String, TensorView<'_>)> = bytes
        .iter()
        .map(|(name, array, bytes)| Ok((*name, TensorView::new(Dtype::F32, array.shape.clone(), bytes)?)))
        .collect::<std::result::Result<_, safetensors::SafeTensorError>>()
        .map_err(|e| fail(e.to_string()))?;
    // One key only: the order of several would differ between runs.
    let info = HashMap::from([(META_KEY.to_owned(), sealed(&json))]);
    let content = safetensors::serialize(views, Some(info)).map_err(|e| fail(e.to_string()))?;
    atomic::write(path, |out| out.write_all(&content))
}

/// Metadata and arrays of a file's content; `path` is for messages only.
///
/// # Errors
/// When it is not one of ours, is cut short or altered, holds a value that is not finite, or its
/// metadata is not of the kind that is `expected`.
pub fn parse_arrays<M: DeserializeOwned>(path: &Path, bytes: &[u8], expected: &str) -> Result<(M, Arrays)> {
    let broken = |found: String| {
        let remedy = "use a file written by `scanweave train` or `scanweave import-weights`";
        Error::file(path, found, expected, remedy)
    };
    let foreign = |e: safetensors::SafeTensorError| {
        broken(format!("{} bytes that are not a whole safetensors file ({e})", bytes.len()))
    };
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(foreign)?;
    let file = SafeTensors::deserialize(bytes).map_err(foreign)?;
    let json = header
        .metadata()
        .as_ref()
        .and_then(|m| m.get(META_KEY))
        .ok_or_else(|| broken("a safetensors file of another program".into()))?;
    let json = unsealed(json).map_err(broken)?;
    let envelope: Envelope<M> =
        serde_json::from_str(&json).map_err(|e| broken(format!("metadata of another kind ({e})")))?;
    let mut arrays = Arrays::new();
    for (name, view) in file.tensors() {
        if view.dtype() != Dtype::F32 {
            return Err(broken(format!("tensor {name} of type {:?}", view.dtype())));
        }
        let values: Vec<f32> =
            view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        if values.iter().any(|v| !v.is_finite()) {
            return Err(broken(format!("tensor {name} with values that are not finite")));
        }
        arrays.insert(name, Array { shape: view.shape().to_vec(), values });
    }
    if digest_of_arrays(&arrays) != envelope.tensors_blake3 {
        return Err(broken("weights that do not match their checksum".into()));
    }
    Ok((envelope.meta, arrays))
}

/// [`parse_arrays`] of a file.
///
/// # Errors
/// As [`parse_arrays`], and when the file cannot be read.
pub fn load_arrays<M: DeserializeOwned>(path: &Path, expected: &str) -> Result<(M, Arrays)> {
    let bytes = crate::files::read(path)?;
    parse_arrays(path, &bytes, expected)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flipped_bit_is_noticed_wherever_it_is() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("a.safetensors");
        let meta = BTreeMap::from([
            ("name".to_owned(), "with \"quotes\"".to_owned()),
            ("epoch".to_owned(), "12".to_owned()),
        ]);
        let arrays = Arrays::from([("a".to_owned(), Array::new(&[2], vec![1.0, 2.0]))]);
        save_arrays(&path, &meta, &arrays).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let read = |bytes: &[u8]| parse_arrays::<BTreeMap<String, String>>(&path, bytes, "a test");
        assert_eq!(read(&bytes).unwrap(), (meta, arrays));
        for at in 0..bytes.len() {
            for bit in [1, 2, 4, 64] {
                let mut flipped = bytes.clone();
                flipped[at] ^= bit;
                assert!(read(&flipped).is_err(), "bit {bit} of byte {at}");
            }
        }
    }

    #[test]
    fn metadata_without_a_checksum_are_read_as_they_are() {
        assert_eq!(unsealed(r#"{"a":1}"#).unwrap(), r#"{"a":1}"#);
        let text = sealed(r#"{"a":",\"metadata_blake3\":\""}"#);
        assert_eq!(unsealed(&text).unwrap(), r#"{"a":",\"metadata_blake3\":\""}"#);
        assert!(unsealed(&text.replace("{\"a\"", "{\"b\"")).is_err());
    }
}
