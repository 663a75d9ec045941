//! Data set layouts: a scene with its true poses, and a benchmark's pairs.

use super::discover::scan_files;
use super::poses::{self, Repaired};
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::geometry::rigid::motion_from_matrix;
use crate::scan::{PairTruth, ScanId};
use nalgebra::Matrix4;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A folder of scans, with true poses where it has them.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Name of the folder.
    pub name: String,
    /// Scan files, naturally sorted.
    pub scans: Vec<PathBuf>,
    /// True `world_from_scan` of each scan, with the repair its rotations needed; `None` where the folder has no truth.
    pub world_from_scan: Option<Repaired<Vec<RigidMotion>>>,
}

impl Scene {
    /// True `world_from_scan` of each scan of the scene, which was read from `folder`.
    ///
    /// # Errors
    /// [`Error::File`] naming the folder where it has none.
    pub fn true_poses(&self, folder: &Path) -> Result<&Repaired<Vec<RigidMotion>>> {
        self.world_from_scan.as_ref().ok_or_else(|| {
            Error::file(
                folder,
                "scans without true poses",
                "truth.json, a pose file beside each scan, poses/, poses.txt or one .conf",
                "add the poses or leave the folder out",
            )
        })
    }

    /// The number at the end of each scan's stem (`cloud_bin_12` → 12), by which `gt.log` calls it.
    pub fn numbers(&self) -> Vec<Option<usize>> {
        self.scans.iter().map(|p| number_of(p)).collect()
    }
}

fn number_of(path: &Path) -> Option<usize> {
    let stem = stem(path);
    let digits = stem.bytes().rev().take_while(u8::is_ascii_digit).count();
    stem[stem.len() - digits..].parse().ok()
}

/// File name up to its first extension that follows the number: `frame-000010.depth.png` → `frame-000010`.
fn stem(path: &Path) -> String {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let name = path.extension().map_or(name.as_str(), |e| &name[..name.len() - e.len() - 1]).to_owned();
    name.strip_suffix(".depth").map_or(name.clone(), str::to_owned)
}

/// Reads a scene folder: its scans as [`scan_files`] finds them, or those of `scans/` beside a
/// `truth.json`, and true poses from, in this order,
/// - `truth.json`, from the file name of every scan to its 4×4 `world_from_scan`, row by row,
/// - `<stem>.info.txt` beside each scan (3DMatch), `<stem>.pose.txt` (7-Scenes),
/// - one `.conf` with `bmesh` lines (Stanford),
/// - `poses/pose<number>.txt` (facade), or `poses.txt` with one matrix for each scan in order.
///
/// # Errors
/// Those of [`scan_files`]; [`Error::File`] when some scans have a pose and others have not,
/// or a pose is no rigid motion.
pub fn read_scene(dir: impl AsRef<Path>) -> Result<Scene> {
    let dir = dir.as_ref();
    let inside = dir.join("scans");
    let in_one_file = dir.join("truth.json").is_file();
    let scans = scan_files(if in_one_file && inside.is_dir() { &inside } else { dir })?;
    let truth = if in_one_file { Some(from_json(&dir.join("truth.json"), &scans)?) } else { None };
    let truth = match truth {
        Some(truth) => Some(truth),
        None => beside(&scans, "info.txt")?,
    };
    let truth = match truth {
        Some(truth) => Some(truth),
        None => beside(&scans, "pose.txt")?,
    };
    let truth = match truth {
        Some(truth) => Some(truth),
        None => from_conf(dir, &scans)?,
    };
    let world_from_scan = match truth {
        Some(truth) => Some(truth),
        None => from_pose_files(dir, &scans)?,
    };
    let absolute = std::fs::canonicalize(dir).map_err(|e| Error::read(dir, e))?;
    let name = absolute.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Scene { name, scans, world_from_scan })
}

/// A pose file for each scan; `None` when no scan has one.
fn each(scans: &[PathBuf], file_of: impl Fn(&Path) -> PathBuf) -> Result<Option<Repaired<Vec<RigidMotion>>>> {
    let files: Vec<PathBuf> = scans.iter().map(|p| file_of(p)).collect();
    let present = files.iter().filter(|f| f.is_file()).count();
    if present == 0 {
        return Ok(None);
    }
    if let Some(missing) = files.iter().find(|f| !f.is_file()) {
        let found = format!("no such file, though {present} of {} scans have one", scans.len());
        return Err(Error::file(
            missing,
            found,
            "a pose for every scan",
            "add it, or remove the scan from the folder",
        ));
    }
    let mut result = Repaired { value: Vec::with_capacity(scans.len()), deviation: 0.0f64 };
    for file in files {
        let pose = poses::read_matrix(file)?;
        result.deviation = result.deviation.max(pose.deviation);
        result.value.push(pose.value);
    }
    Ok(Some(result))
}

/// One file of all poses by the file names of their scans.
fn from_json(path: &Path, scans: &[PathBuf]) -> Result<Repaired<Vec<RigidMotion>>> {
    /// How far a rotation may be from orthonormal, as in other pose files.
    const TOLERANCE: f64 = poses::ORTHONORMAL_TOLERANCE;
    let text = crate::files::read_text(path)?;
    let expected = "a table from file names to 4×4 matrices, row by row";
    let poses: BTreeMap<String, [[f64; 4]; 4]> = serde_json::from_str(&text)
        .map_err(|e| Error::file(path, format!("text that does not fit ({e})"), expected, "correct it"))?;
    let mut result = Repaired { value: Vec::with_capacity(scans.len()), deviation: 0.0f64 };
    for scan in scans {
        let name = scan.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let Some(rows) = poses.get(&name) else {
            let remedy = "add it, or remove the scan from the folder";
            return Err(Error::file(path, format!("no pose of {name}"), "a pose for every scan", remedy));
        };
        let matrix = Matrix4::from_fn(|r, c| rows[r][c]);
        let Some((pose, deviation)) = motion_from_matrix(&matrix, TOLERANCE) else {
            let found = format!("a matrix of {name} that is no rigid motion");
            return Err(Error::file(path, found, "a rotation and a translation", "correct it"));
        };
        result.deviation = result.deviation.max(deviation);
        result.value.push(pose);
    }
    Ok(result)
}

fn beside(scans: &[PathBuf], suffix: &str) -> Result<Option<Repaired<Vec<RigidMotion>>>> {
    each(scans, |scan| scan.with_file_name(format!("{}.{suffix}", stem(scan))))
}

fn from_conf(dir: &Path, scans: &[PathBuf]) -> Result<Option<Repaired<Vec<RigidMotion>>>> {
    let entries = std::fs::read_dir(dir).map_err(|e| Error::read(dir, e))?;
    let mut confs: Vec<PathBuf> = entries
        .filter_map(|e| e.ok().map(|e| e.path()))
        .filter(|p| p.extension().is_some_and(|e| e == "conf"))
        .collect();
    confs.sort();
    let [conf] = &confs[..] else { return Ok(None) };
    let read = poses::read_conf(conf)?;
    let mut motions = Vec::with_capacity(scans.len());
    for scan in scans {
        let name = scan.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let Some((_, pose)) = read.value.iter().find(|(file, _)| *file == name) else {
            let found = format!("no bmesh line for {name}");
            return Err(Error::file(
                conf,
                found,
                "a pose for every scan",
                "add it, or remove the scan from the folder",
            ));
        };
        motions.push(*pose);
    }
    Ok(Some(read.map(|_| motions)))
}

fn from_pose_files(dir: &Path, scans: &[PathBuf]) -> Result<Option<Repaired<Vec<RigidMotion>>>> {
    let folder = dir.join("poses");
    let numbered = |scan: &Path| match number_of(scan) {
        Some(n) => folder.join(format!("pose{n}.txt")),
        None => folder.join(format!("{}.txt", stem(scan))),
    };
    if let Some(truth) = each(scans, numbered)? {
        return Ok(Some(truth));
    }
    let file = dir.join("poses.txt");
    if !file.is_file() {
        return Ok(None);
    }
    let read = poses::read_kitti(&file)?;
    if read.value.len() != scans.len() {
        let found = format!("{} poses", read.value.len());
        let expected = format!("{}, one for each scan in sorted order", scans.len());
        return Err(Error::file(&file, found, expected, "add the missing poses or scans"));
    }
    Ok(Some(read))
}

/// Pairs of a benchmark scene: `gt.log` joined with `gt.info`.
#[derive(Debug, Clone)]
pub struct Benchmark {
    /// Number of scans in the scene, from the headers.
    pub scans: usize,
    /// The pairs in file order; ids are the numbers in the headers.
    pub pairs: Vec<PairTruth>,
    /// How far the rotations of `gt.log` were from orthonormal before the repair.
    pub deviation: f64,
}

/// Reads `gt.log` and, where it is there, `gt.info` of one benchmark scene.
///
/// # Errors
/// [`Error::Read`]; [`Error::File`] when the two disagree in number or order of pairs, or a header
/// names a scan that the number of scans rules out.
pub fn read_benchmark(dir: impl AsRef<Path>) -> Result<Benchmark> {
    let dir = dir.as_ref();
    let (log_path, info_path) = (dir.join("gt.log"), dir.join("gt.info"));
    let log = poses::read_log(&log_path)?;
    let info = if info_path.is_file() { Some(poses::read_info(&info_path)?) } else { None };
    let remedy = "use gt.log and gt.info of the same benchmark";
    if let Some(info) = &info {
        if info.len() != log.value.len() {
            let expected = format!("{} as in gt.log", log.value.len());
            return Err(Error::file(&info_path, format!("{} pairs", info.len()), expected, remedy));
        }
        let differing = info.iter().zip(&log.value).position(|(a, b)| (a.i, a.j) != (b.i, b.j));
        if let Some(k) = differing {
            let found = format!("pair {} {} in place {}", info[k].i, info[k].j, k + 1);
            let expected = format!("{} {} as in gt.log", log.value[k].i, log.value[k].j);
            return Err(Error::file(&info_path, found, expected, remedy));
        }
    }
    let scans = log.value.first().map_or(0, |e| e.n);
    if let Some(e) = log.value.iter().find(|e| e.n != scans || e.i >= scans || e.j >= scans || e.i == e.j) {
        let found = format!("a header '{} {} {}'", e.i, e.j, e.n);
        let expected = format!("two different scans below {scans}, the number of scans of the first header");
        return Err(Error::file(&log_path, found, expected, "correct that header"));
    }
    let information = |k: usize| info.as_ref().map(|v| v[k].information);
    let pair = |(k, e): (usize, poses::LogEntry)| PairTruth {
        i: ScanId(e.i),
        j: ScanId(e.j),
        i_from_j: e.pose,
        information: information(k),
    };
    Ok(Benchmark {
        scans,
        pairs: log.value.into_iter().enumerate().map(pair).collect(),
        deviation: log.deviation,
    })
}
