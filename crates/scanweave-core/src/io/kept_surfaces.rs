//! A thinned scan kept for other stages: one NPZ.
//!
//! `surface` `[n,6]`: points (metres) and normals in the scan's own frame; `intensities` `[n]`, or none; `study`:
//! what the shape says of where it was seen from; `key` 32 bytes: what it belongs to.

use super::features::CacheKey;
use super::npz::{self, Archive};
use crate::atomic;
use crate::error::{Error, Result};
use ndarray::{Array1, Array2};
use std::io::{self, Write};
use std::path::Path;

/// A thinned scan as numbers.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct KeptSurface {
    /// Points and normals.
    pub rows: Vec<[f32; 6]>,
    /// As many, or none.
    pub intensities: Vec<f32>,
    /// What the shape says of where it was seen from.
    pub study: Vec<f32>,
}

/// Reads what [`write_surface`] writes, to the last bit.
///
/// # Errors
/// [`Error::Read`]; [`Error::File`] for a damaged file and for the surface of another scan.
pub(crate) fn read_surface(path: &Path, key: &CacheKey) -> Result<KeptSurface> {
    let broken = |found: &str| {
        let remedy = "leave the cache to the program; it is made again";
        Error::file(path, found, "the surface that it is named for", remedy)
    };
    let bytes = crate::files::read(path)?;
    let mut archive = Archive::open(path, &bytes)?;
    let stored = archive.array::<u8>("key")?.ok_or_else(|| broken("no key"))?;
    if stored.values != key {
        return Err(broken("the surface of another scan, or at another scale"));
    }
    let mut need = |name: &str| archive.array::<f32>(name)?.ok_or_else(|| broken("too few arrays"));
    let (surface, intensities, study) = (need("surface")?, need("intensities")?, need("study")?);
    let rows = match surface.matrix() {
        Some((_, 6)) => surface.values.as_chunks::<6>().0.to_vec(),
        _ => return Err(broken("an array of another shape")),
    };
    match intensities.values.len() {
        n if n == 0 || n == rows.len() => {
            Ok(KeptSurface { rows, intensities: intensities.values, study: study.values })
        }
        _ => Err(broken("arrays of different lengths")),
    }
}

/// Writes a thinned scan.
///
/// # Errors
/// [`Error::Write`].
pub(crate) fn write_surface(path: &Path, surface: &KeptSurface, key: &CacheKey) -> Result<()> {
    atomic::write(path, |sink| {
        let flat = surface.rows.concat();
        let rows = Array2::from_shape_vec((surface.rows.len(), 6), flat).map_err(io::Error::other)?;
        let [intensities, study] =
            [&surface.intensities, &surface.study].map(|v| Array1::from_vec(v.clone()));
        let archive = npz::archive(|npz| {
            npz.add_array("surface", &rows)?;
            npz.add_array("intensities", &intensities)?;
            npz.add_array("study", &study)?;
            npz.add_array("key", &Array1::from_iter(key.iter().copied()))
        })?;
        sink.write_all(&archive)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surface_comes_back_to_the_last_bit_and_only_under_its_key() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npz");
        let rows =
            vec![[1.0 / 3.0, -2e-7, 3e8, 0.1, 0.2, -0.9], [f32::MIN_POSITIVE, 0.0, -0.0, 0.0, 0.0, 0.0]];
        let coloured = KeptSurface { rows, intensities: vec![0.1, 0.7], study: vec![0.3; 19] };
        for surface in [coloured.clone(), KeptSurface { intensities: Vec::new(), ..coloured }] {
            write_surface(&path, &surface, &[7; 32]).unwrap();
            assert_eq!(read_surface(&path, &[7; 32]).unwrap(), surface);
            assert!(matches!(read_surface(&path, &[8; 32]), Err(Error::File { .. })));
        }
        let bytes = std::fs::read(&path).unwrap();
        for cut in [0, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..cut]).unwrap();
            assert!(matches!(read_surface(&path, &[7; 32]), Err(Error::File { .. })), "{cut}");
        }
    }
}
