//! Precomputed local features: one NPZ a scan, or the folders of SGHR and IMVR.

use super::npy::{self, Array, Number};
use super::npz::{self, Archive};
use super::poses::read_text;
use super::read_cloud;
use super::scalar::parse_number;
use super::scan_file::ReadOptions;
use super::unpack_limit::UnpackLimit;
use crate::atomic;
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::{Direction, Point};
use crate::scan::{Descriptors, Features, PointCloud};
use nalgebra::Vector3;
use ndarray::{Array1, Array2};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Reads `keypoints` `[n,3]` metres, `descriptors` `[n,D]` and, where it is there, `normals` `[n,3]` from an NPZ.
///
/// Descriptors are scaled to unit length. Keypoints are in the scan's own frame,
/// without the `origin_m` of a georeferenced cloud.
///
/// # Errors
/// [`Error::Read`]; [`Error::File`] for a missing array, a wrong shape, lengths that disagree
/// or a number that is not finite.
pub fn read_features(path: impl AsRef<Path>) -> Result<Features> {
    read_features_with(path, &ReadOptions::default())
}

/// [`read_features`] of an archive that may unpack to as much as the options say.
///
/// # Errors
/// As [`read_features`].
pub fn read_features_with(path: impl AsRef<Path>, options: &ReadOptions) -> Result<Features> {
    let path = path.as_ref();
    let bytes = files::read(path)?;
    let limit = UnpackLimit::of_scan(options, bytes.len() as u64);
    read_archive(path, Archive::with_limit(path, &bytes, limit)?, None)
}

/// What an entry of a cache belongs to: a digest of everything that its features depend on.
pub(crate) type CacheKey = [u8; 32];
const CACHE_KEY: &str = "key";

/// [`read_features`] of an entry of a cache, which holds the `key` that it was written with.
///
/// # Errors
/// As [`read_features`], and [`Error::File`] for the features of another scan or of other settings.
pub(crate) fn read_cached(path: &Path, key: &CacheKey) -> Result<Features> {
    let bytes = files::read(path)?;
    read_archive(path, Archive::open(path, &bytes)?, Some(key))
}

/// Writes what [`read_cached`] reads.
///
/// # Errors
/// [`Error::Write`].
pub(crate) fn write_cached(path: &Path, features: &Features, key: &CacheKey) -> Result<()> {
    write_archive(path, features, Some(key))
}

/// Features as they are once they were written and read, which may change last bits: what is kept
/// and what is not must be the same.
pub(crate) fn as_read(features: Features) -> Features {
    let normals = features.normals.map(|normals| normals.iter().map(unit).collect());
    Features { normals, descriptors: features.descriptors.normalized(), ..features }
}

fn unit(normal: &Direction) -> Direction {
    normal.try_normalize(0.0).unwrap_or_default()
}

fn read_archive(path: &Path, mut archive: Archive<'_>, cache_key: Option<&CacheKey>) -> Result<Features> {
    let keys = archive.keys();
    if let Some(key) = cache_key {
        let stored = archive.array::<f32>(CACHE_KEY)?.map(|a| a.values).unwrap_or_default();
        if !stored.iter().copied().eq(key.iter().copied().map(f32::from)) {
            let found = "features of another scan, or with other settings";
            let remedy = "leave the cache to the program; it is made again";
            return Err(Error::file(path, found, "those that it is named for", remedy));
        }
    }
    let mut need = |key: &str| {
        archive.array::<f32>(key)?.ok_or_else(|| {
            let found = format!("arrays [{}]", keys.join(", "));
            let remedy = "save with numpy.savez(path, keypoints=…, descriptors=…)";
            Error::file(path, found, format!("an array '{key}'"), remedy)
        })
    };
    let keypoints = points(path, "keypoints", &need("keypoints")?)?;
    let descriptors = descriptors(path, "descriptors", need("descriptors")?)?;
    let normals = archive.array("normals")?.map(|a| points(path, "normals", &a)).transpose()?;
    if let Some(normals) = &normals {
        same_length((path, "normals", normals.len()), (path, "keypoints", keypoints.len()))?;
    }
    same_length((path, "keypoints", keypoints.len()), (path, "descriptors", descriptors.len()))?;
    let normals = normals.map(|v| v.iter().map(|p| unit(&p.coords)).collect());
    join(path, keypoints, normals, descriptors)
}

/// Whether an NPZ has keypoints and descriptors, and is not a cloud.
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] for a file that is no archive of arrays.
pub fn holds_features(path: impl AsRef<Path>) -> Result<bool> {
    let path = path.as_ref();
    let bytes = files::read(path)?;
    let keys = Archive::open(path, &bytes)?.keys();
    Ok(["keypoints", "descriptors"].iter().all(|wanted| keys.iter().any(|key| key == wanted)))
}

/// Writes what [`read_features`] reads, as 32-bit floats.
///
/// # Errors
/// [`Error::Write`].
pub fn write_features(path: impl AsRef<Path>, features: &Features) -> Result<()> {
    write_archive(path.as_ref(), features, None)
}

/// Whether a file holds what [`write_features`] writes for these features, to the last byte.
pub fn holds_these_features(path: impl AsRef<Path>, features: &Features) -> bool {
    let written = files::read(path.as_ref()).ok();
    written.is_some_and(|bytes| archive(features, None).is_ok_and(|expected| bytes == expected))
}

fn write_archive(path: &Path, features: &Features, cache_key: Option<&CacheKey>) -> Result<()> {
    atomic::write(path, |sink| sink.write_all(&archive(features, cache_key)?))
}

fn archive(features: &Features, cache_key: Option<&CacheKey>) -> io::Result<Vec<u8>> {
    let triples = |rows: &mut dyn Iterator<Item = Vector3<f32>>| {
        let flat: Vec<f32> = rows.flat_map(|v| [v.x, v.y, v.z]).collect();
        Array2::from_shape_vec((flat.len() / 3, 3), flat).map_err(io::Error::other)
    };
    let shape = (features.len(), features.descriptors.dim());
    let values = features.descriptors.values().to_vec();
    let descriptors = Array2::from_shape_vec(shape, values).map_err(io::Error::other)?;
    let keypoints = triples(&mut features.keypoints.iter().map(|p| p.coords))?;
    let normals = features.normals.as_ref().map(|n| triples(&mut n.iter().copied())).transpose()?;
    npz::archive(|npz| {
        npz.add_array("keypoints", &keypoints)?;
        npz.add_array("descriptors", &descriptors)?;
        normals.iter().try_for_each(|normals| npz.add_array("normals", normals))?;
        cache_key.iter().try_for_each(|key| npz.add_array(CACHE_KEY, &Array1::from_iter(key.iter().copied())))
    })
}

/// Reads the features of scan number `index` from a data set laid out as SGHR and IMVR publish it:
/// `Keypoints/cloud_bin_<i>Keypoints.txt` (one row index of the cloud a line, or points) or `.npy`, and
/// `<desc_name>_desc/<i>.npy` `[n,D]`.
///
/// `index` is the number in the file names; `cloud` is that scan, as read from `PointCloud/cloud_bin_<i>.ply`.
///
/// # Errors
/// [`Error::Read`]; [`Error::File`] for an index beyond the cloud, or keypoints and descriptors whose
/// lengths disagree, naming both files and both lengths.
pub fn read_sghr_features(
    dataset_dir: impl AsRef<Path>,
    desc_name: &str,
    index: usize,
    cloud: &PointCloud,
) -> Result<Features> {
    let dir = dataset_dir.as_ref();
    let keypoint_file = find_keypoints(dir, index)?;
    let keypoints = sghr_keypoints(&keypoint_file, cloud)?;
    let descriptor_file = dir.join(format!("{desc_name}_desc")).join(format!("{index}.npy"));
    let array = read_npy(&descriptor_file)?;
    let descriptors = descriptors(&descriptor_file, "an array", array)?;
    same_length(
        (&keypoint_file, "keypoints", keypoints.len()),
        (&descriptor_file, "descriptors", descriptors.len()),
    )?;
    join(&descriptor_file, keypoints, None, descriptors)
}

/// [`read_sghr_features`] with the cloud read from the data set's `PointCloud/cloud_bin_<index>.ply`.
///
/// # Errors
/// Those of [`read_cloud`] and [`read_sghr_features`].
pub fn read_sghr_scan(dataset_dir: impl AsRef<Path>, desc_name: &str, index: usize) -> Result<Features> {
    let dir = dataset_dir.as_ref();
    let cloud = read_cloud(dir.join("PointCloud").join(format!("cloud_bin_{index}.ply")))?;
    read_sghr_features(dir, desc_name, index, &cloud)
}

fn find_keypoints(dir: &Path, index: usize) -> Result<PathBuf> {
    let named = format!("cloud_bin_{index}Keypoints");
    let candidates = [
        dir.join("Keypoints").join(format!("{named}.txt")),
        dir.join("Keypoints").join(format!("{named}.npy")),
        dir.join("Keypoints_PC").join(format!("{named}.npy")),
        dir.join("Keypoints").join(format!("{index}.txt")),
        dir.join("Keypoints").join(format!("{index}.npy")),
    ];
    candidates.into_iter().find(|p| p.is_file()).ok_or_else(|| {
        let expected = format!("Keypoints/{named}.txt or .npy");
        Error::file(
            dir,
            format!("no keypoints of scan {index}"),
            expected,
            "add the keypoints, or compute features anew",
        )
    })
}

fn sghr_keypoints(path: &Path, cloud: &PointCloud) -> Result<Vec<Point>> {
    let array =
        if path.extension().is_some_and(|e| e == "npy") { read_npy(path)? } else { read_table(path)? };
    match array.shape[..] {
        [_] | [_, 1] => {
            array.values.iter().enumerate().map(|(row, &v)| by_index(path, cloud, row, v)).collect()
        }
        // In the file's coordinates, as the cloud was before its origin was taken off.
        _ => {
            let rows = array.points().ok_or_else(|| {
                bad_shape(path, "an array", &array.shape, "[n] row indices or [n, 3] points")
            })?;
            Ok(rows
                .into_iter()
                .map(|p| Point::from((Vector3::from(p) - cloud.origin_m).cast::<f32>()))
                .collect())
        }
    }
}

fn by_index(path: &Path, cloud: &PointCloud, row: usize, value: f64) -> Result<Point> {
    let bad = |found: String, expected: String, remedy: &str| Err(Error::file(path, found, expected, remedy));
    let left_out = cloud.dropped_rows + cloud.stray_points;
    if left_out > 0 {
        let found = format!("row indices into a cloud of which {left_out} rows are left out");
        let remedy = "give keypoints as points [n,3], or remove those rows and index again";
        return bad(found, "a cloud whose rows are all finite".into(), remedy);
    }
    let n = cloud.len();
    if !(value >= 0.0 && value.fract() == 0.0 && value < n as f64) {
        let found = format!("index {value} in row {}", row + 1);
        return bad(
            found,
            format!("whole numbers below {n}, the cloud's size"),
            "use the keypoints of this very cloud",
        );
    }
    Ok(cloud.points[value as usize])
}

/// Numbers of a text file, one row a line.
fn read_table(path: &Path) -> Result<Array> {
    let text = read_text(path)?;
    let mut values = Vec::new();
    let mut columns = None;
    let mut rows = 0;
    for (index, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty() && !l.starts_with('#'))
    {
        let words = line.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty());
        let row: Option<Vec<f64>> = words.map(parse_number).collect();
        let row = row.filter(|r| *columns.get_or_insert(r.len()) == r.len()).ok_or_else(|| {
            let found = format!("line {} '{}'", index + 1, line.trim().chars().take(80).collect::<String>());
            Error::file(path, found, "the same number of numbers in every line", "write the keypoints again")
        })?;
        values.extend(row);
        rows += 1;
    }
    Ok(Array { shape: vec![rows, columns.unwrap_or(1)], values })
}

fn read_npy<T: Number>(path: &Path) -> Result<Array<T>> {
    npy::read_array(path, "", &files::read(path)?)
}

fn bad_shape(path: &Path, what: &str, shape: &[usize], expected: &str) -> Error {
    Error::file(path, format!("{what} of shape {shape:?}"), expected, "save it again in that shape")
}

fn points(path: &Path, what: &str, array: &Array<f32>) -> Result<Vec<Point>> {
    if array.matrix().is_none_or(|(_, c)| c != 3) {
        return Err(bad_shape(path, what, &array.shape, "shape [n, 3]"));
    }
    let (rows, _) = array.values.as_chunks::<3>();
    Ok(rows.iter().map(|r| Point::from(*r)).collect())
}

fn descriptors(path: &Path, what: &str, array: Array<f32>) -> Result<Descriptors> {
    let (_, dim) = array
        .matrix()
        .filter(|&(_, d)| d > 0)
        .ok_or_else(|| bad_shape(path, what, &array.shape, "shape [n, D]"))?;
    Ok(Descriptors::new(dim, array.values).map_err(|e| of_file(path, e))?.normalized())
}

fn join(
    path: &Path,
    keypoints: Vec<Point>,
    normals: Option<Vec<Direction>>,
    descriptors: Descriptors,
) -> Result<Features> {
    Features::new(keypoints, normals, descriptors).map_err(|e| of_file(path, e))
}

/// An error about values, made one about the file they came from.
fn of_file(path: &Path, error: Error) -> Error {
    match error {
        Error::Input { subject, found, expected, remedy } => {
            Error::file(path, format!("{subject} with {found}"), expected, remedy)
        }
        other => other,
    }
}

type Counted<'a> = (&'a Path, &'a str, usize);

fn same_length((path, what, n): Counted<'_>, (other_path, other, m): Counted<'_>) -> Result<()> {
    if n == m {
        return Ok(());
    }
    let place = if path == other_path { String::new() } else { format!(" as in {}", other_path.display()) };
    Err(Error::file(
        path,
        format!("{n} {what}"),
        format!("{m}, one for each of the {m} {other}{place}"),
        "write both from the same run",
    ))
}
