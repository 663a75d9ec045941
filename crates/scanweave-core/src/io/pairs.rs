//! Pairwise registrations kept for the next run: one NPZ.
//!
//! `settings` bytes: what names the settings; `pairs` `[P,32]` bytes: content of target and source; `values` `[P,13]`: translation (3,
//! metres), rotation as x y z w, matches, inliers, residual (m), overlap, median distance (m),
//! its share of the seconds that all took which were registered with it.

use super::npy::{Array, Number};
use super::npz::{self, Archive};
use crate::atomic;
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::scan::{PairKey, PairRegistration};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use ndarray::{Array1, Array2};
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

const SETTINGS: &str = "settings";
const KEY: usize = 32;
const VALUES: usize = 13;

/// Registrations and the seconds of each.
pub type Pairs = BTreeMap<PairKey, (PairRegistration, f64)>;

/// Reads what [`write_pairs()`] writes, to the last bit.
///
/// # Errors
/// [`Error::Read`]; [`Error::File`] for missing arrays or wrong shapes, and for pairs that were registered
/// with other settings: a file that was renamed is not taken for another.
pub fn read_pairs(path: &Path, settings: &str) -> Result<Pairs> {
    let bytes = crate::files::read(path)?;
    let mut archive = Archive::open(path, &bytes)?;
    let stored = archive.array::<f32>(SETTINGS)?.map(|a| a.values).unwrap_or_default();
    if !stored.iter().copied().eq(settings.bytes().map(f32::from)) {
        let expected = "those that it is named for";
        return Err(Error::file(path, "pairs of other settings", expected, "delete it; it is made again"));
    }
    let keys = numbers_of::<u8>(path, "pairs", KEY, archive.array("pairs")?)?;
    let values = numbers_of::<f64>(path, "values", VALUES, archive.array("values")?)?;
    let (keys, values) = (keys.as_chunks::<KEY>().0, values.as_chunks::<VALUES>().0);
    if keys.len() != values.len() {
        let found = format!("{} pairs and {} values", keys.len(), values.len());
        return Err(Error::file(path, found, "as many of both", "delete it; it is made again"));
    }
    Ok(keys.iter().map(key).zip(values.iter().map(|row| (registration(row), row[VALUES - 1]))).collect())
}

/// The numbers of an array of so many columns.
fn numbers_of<T: Number>(path: &Path, name: &str, columns: usize, array: Option<Array<T>>) -> Result<Vec<T>> {
    match array {
        Some(array) if array.matrix().is_some_and(|(_, c)| c == columns) => Ok(array.values),
        other => {
            let found = other.map_or("nothing".to_owned(), |a| format!("shape {:?}", a.shape));
            let expected = format!("an array '{name}' of {columns} columns");
            Err(Error::file(path, found, expected, "delete it; it is made again"))
        }
    }
}

/// Writes pairwise registrations.
///
/// # Errors
/// [`Error::Write`].
pub fn write_pairs(path: &Path, settings: &str, pairs: &Pairs) -> Result<()> {
    let keys: Vec<u8> = pairs.keys().flat_map(|k| k.target.into_iter().chain(k.source)).collect();
    let values: Vec<f64> = pairs.values().flat_map(numbers).collect();
    atomic::write(path, |sink| {
        let settings = Array1::from_iter(settings.bytes());
        let keys = Array2::from_shape_vec((pairs.len(), KEY), keys).map_err(io::Error::other)?;
        let values = Array2::from_shape_vec((pairs.len(), VALUES), values).map_err(io::Error::other)?;
        let archive = npz::archive(|npz| {
            npz.add_array(SETTINGS, &settings)?;
            npz.add_array("pairs", &keys)?;
            npz.add_array("values", &values)
        })?;
        sink.write_all(&archive)
    })
}

fn key(row: &[u8; KEY]) -> PairKey {
    let half = |from: usize| std::array::from_fn(|k| row[from + k]);
    PairKey { target: half(0), source: half(KEY / 2) }
}

fn numbers((pair, seconds): &(PairRegistration, f64)) -> [f64; VALUES] {
    let (t, q) = (pair.target_from_source.translation.vector, pair.target_from_source.rotation.coords);
    let (matches, inliers) = (pair.matches as f64, pair.inliers as f64);
    let (residual, overlap, distance) = (pair.residual_m, pair.overlap, pair.median_distance_m);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w, matches, inliers, residual, overlap, distance, *seconds]
}

fn registration(row: &[f64; VALUES]) -> PairRegistration {
    let q = Quaternion::new(row[6], row[3], row[4], row[5]);
    PairRegistration {
        // Not normalised again: the numbers must come back as they were.
        target_from_source: RigidMotion::from_parts(
            Translation3::new(row[0], row[1], row[2]),
            UnitQuaternion::new_unchecked(q),
        ),
        matches: row[7] as usize,
        inliers: row[8] as usize,
        residual_m: row[9],
        overlap: row[10],
        median_distance_m: row[11],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn registrations_come_back_to_the_last_bit() {
        let motion = RigidMotion::new(Vector3::new(0.1, -2.0, 1.0 / 3.0), Vector3::new(0.3, 1.0, -0.7));
        let found = PairRegistration {
            target_from_source: motion,
            matches: 412,
            inliers: 37,
            residual_m: 0.031,
            overlap: 0.4,
            median_distance_m: 0.01,
        };
        let key = |a: u8, b: u8| PairKey { target: [a; 16], source: [b; 16] };
        let pairs =
            BTreeMap::from([(key(3, 255), (found, 0.021)), (key(0, 1), (PairRegistration::default(), 0.0))]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pairs.npz");
        write_pairs(&path, "ab12", &pairs).unwrap();
        assert_eq!(read_pairs(&path, "ab12").unwrap(), pairs);
        for other in ["ab13", "ab1", "ab123", ""] {
            assert!(matches!(read_pairs(&path, other), Err(Error::File { .. })), "{other}");
        }
        // In the archive's list of arrays, in the settings and in the numbers.
        let bytes = std::fs::read(&path).unwrap();
        for at in [
            bytes.windows(8).rposition(|w| w == b"settings"),
            bytes.windows(4).position(|w| w == b"ab12"),
            Some(bytes.len() / 2),
        ] {
            let mut flipped = bytes.clone();
            flipped[at.unwrap()] ^= 1;
            std::fs::write(&path, flipped).unwrap();
            assert!(matches!(read_pairs(&path, "ab12"), Err(Error::File { .. })), "{at:?}");
        }
        write_pairs(&path, "ab12", &Pairs::new()).unwrap();
        assert!(read_pairs(&path, "ab12").unwrap().is_empty());
        std::fs::write(&path, b"no archive").unwrap();
        assert!(matches!(read_pairs(&path, "ab12"), Err(Error::File { .. })));
    }
}
