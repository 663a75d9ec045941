//! Writing data sets in the layouts that [`dataset`](super::dataset) reads.

use super::poses::{self, InfoEntry, LogEntry};
use super::write_ply::{PlyCloud, write_ply};
use crate::atomic;
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::scan::{PairTruth, ScanId, SimilarityMatrix};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Folder of the scans in the 3DMatch layout.
const CLOUDS: &str = "PointCloud";
/// What the names of its files begin with.
const PREFIX: &str = "cloud_bin_";

/// A set of scans with poses in the 3DMatch layout, on its way to `<folder>/PointCloud`.
///
/// It is written beside its place and moved there by [`finish`](Self::finish): a set that is not
/// whole never stands where one is looked for.
#[derive(Debug)]
pub struct SceneWriter {
    folder: PathBuf,
    beside: tempfile::TempDir,
    place: PathBuf,
}

impl SceneWriter {
    /// Begins a set in `folder`, which is made where it does not exist.
    ///
    /// # Errors
    /// [`Error::OutputExists`] when the folder holds a set and `replace` is not given,
    /// [`Error::File`] when that set holds other files too, [`Error::Write`].
    pub fn begin(folder: &Path, replace: bool) -> Result<Self> {
        let place = folder.join(CLOUDS);
        if place.exists() {
            if !replace {
                return Err(Error::OutputExists { path: folder.to_path_buf() });
            }
            refuse_foreign(&place)?;
        }
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        let beside = tempfile::Builder::new()
            .prefix(&atomic::temporary_prefix())
            .tempdir_in(folder)
            .map_err(|e| Error::write(folder, e))?;
        let made = beside.path().join(CLOUDS);
        std::fs::create_dir(&made).map_err(|e| Error::write(&made, e))?;
        Ok(Self { folder: folder.to_path_buf(), beside, place })
    }

    /// Writes `cloud_bin_<number>.ply`, and `cloud_bin_<number>.info.txt` with a header line of
    /// `origin` (where the scan comes from) and `world_from_scan`.
    ///
    /// # Errors
    /// [`Error::Input`] when the lengths of the cloud's parts differ, [`Error::Write`].
    pub fn add(
        &self,
        number: usize,
        cloud: &PlyCloud<'_>,
        world_from_scan: &RigidMotion,
        origin: &str,
    ) -> Result<()> {
        let stem = self.beside.path().join(CLOUDS).join(format!("{PREFIX}{number}"));
        write_ply(stem.with_extension("ply"), cloud)?;
        atomic::write(&stem.with_extension("info.txt"), |out| {
            // The header is one line of anything; line breaks in a name would end it early.
            writeln!(out, "{}", origin.replace(['\n', '\r'], " "))?;
            let matrix = world_from_scan.to_homogeneous();
            (0..4).try_for_each(|r| {
                let row: Vec<String> = (0..4).map(|c| format!("{:.17e}", matrix[(r, c)])).collect();
                writeln!(out, "{}", row.join("\t"))
            })
        })
    }

    /// Moves the whole set to its place; an old one goes.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn finish(self) -> Result<()> {
        let failed = |e| Error::write(&self.folder, e);
        if self.place.exists() {
            std::fs::rename(&self.place, self.beside.path().join("old")).map_err(failed)?;
        }
        std::fs::rename(self.beside.path().join(CLOUDS), &self.place).map_err(failed)
    }
}

fn refuse_foreign(place: &Path) -> Result<()> {
    for entry in std::fs::read_dir(place).map_err(|e| Error::read(place, e))? {
        let path = entry.map_err(|e| Error::read(place, e))?.path();
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        if !name.starts_with(PREFIX) {
            let expected = format!("only {PREFIX}<i> files in a folder to be replaced");
            return Err(Error::file(path, "a file of something else", expected, "choose another folder"));
        }
    }
    Ok(())
}

/// Writes `gt_overlap.log`: a line `i,j,overlap` for every pair `i < j` of `overlap` that `keep`
/// picks, called by `numbers`.
///
/// # Errors
/// [`Error::Write`].
pub fn write_overlaps(
    path: &Path,
    overlap: &SimilarityMatrix,
    numbers: &[usize],
    keep: impl Fn(usize, usize) -> bool,
) -> Result<()> {
    atomic::write(path, |out| {
        for (i, a) in numbers.iter().enumerate() {
            for (j, b) in numbers.iter().enumerate().skip(i + 1).filter(|&(j, _)| keep(i, j)) {
                writeln!(out, "{a},{b},{:.4}", overlap.get(i, j))?;
            }
        }
        Ok(())
    })
}

/// Writes `gt.info` (of the pairs that have an information matrix), then `gt.log`, which marks a
/// whole benchmark. Scan `k` is called `numbers[k]`; headers state the number of scans, or, where
/// numbers go beyond it, one more than the largest.
///
/// # Errors
/// [`Error::Write`].
pub fn write_benchmark(dir: &Path, pairs: &[PairTruth], numbers: &[usize]) -> Result<()> {
    let n = numbers.iter().map(|&k| k + 1).max().unwrap_or(0).max(numbers.len());
    let number = |ScanId(k): ScanId| numbers.get(k).copied().unwrap_or(k);
    let header = |p: &PairTruth| (number(p.i), number(p.j));
    let info: Vec<InfoEntry> = pairs
        .iter()
        .filter_map(|p| {
            let (i, j) = header(p);
            Some(InfoEntry { i, j, n, information: p.information? })
        })
        .collect();
    let log: Vec<LogEntry> = pairs
        .iter()
        .map(|p| {
            let (i, j) = header(p);
            LogEntry { i, j, n, pose: p.i_from_j }
        })
        .collect();
    poses::write_info(dir.join("gt.info"), &info)?;
    poses::write_log(dir.join("gt.log"), &log)
}
