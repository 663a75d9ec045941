//! Pose and pair files: Redwood `.log` and `.info`, 4×4 matrices, KITTI, TUM, Stanford `.conf`.
//!
//! Matrices in files are rounded, so their rotations are orthonormal only
//! roughly (the 3DMatch kitchen: to 6e-4). They are repaired to the nearest rotation, and how
//! far they were off is returned with them as [`Repaired`].

use super::scalar::parse_number;
use crate::atomic;
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::RigidMotion;
use crate::geometry::rigid::motion_from_matrix;
use crate::scan::ScanId;
use nalgebra::{Matrix4, Matrix6, Quaternion, Translation3, UnitQuaternion, Vector3};
use std::io::{self, Write};
use std::path::Path;

/// Largest entry of `RᵀR − I` that still passes for a rounded rotation.
pub const ORTHONORMAL_TOLERANCE: f64 = 5e-3;

/// What was read, and the largest entry of `RᵀR − I` among the matrices it was made from.
#[derive(Debug, Clone, PartialEq)]
pub struct Repaired<T> {
    /// The content, with proper rotations.
    pub value: T,
    /// How far the worst matrix was from orthonormal before the repair.
    pub deviation: f64,
}

impl<T> Repaired<T> {
    /// The same deviation with changed content.
    pub(super) fn map<U>(self, f: impl FnOnce(T) -> U) -> Repaired<U> {
        Repaired { value: f(self.value), deviation: self.deviation }
    }
}

/// One entry of a Redwood `.log`: a header `i j n` and a 4×4 matrix.
///
/// In a `gt.log` (pairs) the matrix takes coordinates of `j` to coordinates of `i`, and `n` is the
/// number of scans. In a trajectory `i = j` is the scan, and the matrix is `world_from_scan`.
#[derive(Debug, Clone, PartialEq)]
pub struct LogEntry {
    /// First number of the header.
    pub i: usize,
    /// Second number of the header.
    pub j: usize,
    /// Third number of the header.
    pub n: usize,
    /// `i_from_j`, or `world_from_scan` in a trajectory.
    pub pose: RigidMotion,
}

/// One entry of a `gt.info`: a header `i j n` and the 6×6 information matrix over `[t; q_xyz]`.
/// An all-zero matrix is legal: a pair without information.
#[derive(Debug, Clone, PartialEq)]
pub struct InfoEntry {
    /// Target scan.
    pub i: usize,
    /// Source scan.
    pub j: usize,
    /// Number of scans.
    pub n: usize,
    /// The information matrix.
    pub information: Matrix6<f64>,
}

/// Lines that hold something, with their numbers from 1.
pub(super) fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let numbered = text.lines().enumerate().map(|(i, l)| (i + 1, l.trim()));
    numbered.filter(|(_, l)| !l.is_empty() && !l.starts_with('#'))
}

pub(super) fn read_text(path: &Path) -> Result<String> {
    let bytes = files::read(path)?;
    Ok(String::from_utf8_lossy(&bytes).trim_start_matches('\u{feff}').to_owned())
}

pub(super) fn numbers(line: &str) -> Option<Vec<f64>> {
    line.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty()).map(parse_number).collect()
}

pub(super) fn bad_line(path: &Path, (number, line): (usize, &str), expected: impl Into<String>) -> Error {
    let found = format!("line {number} '{}'", line.chars().take(80).collect::<String>());
    Error::file(path, found, expected, "correct that line or write the file again")
}

pub(super) fn repaired(path: &Path, what: &str, rows: &[f64]) -> Result<(RigidMotion, f64)> {
    let matrix =
        Matrix4::from_fn(|r, c| rows.get(4 * r + c).copied().unwrap_or(if c == 3 { 1.0 } else { 0.0 }));
    motion_from_matrix(&matrix, ORTHONORMAL_TOLERANCE).ok_or_else(|| {
        let found = format!("{what} {:?}", rows);
        let expected =
            format!("a rigid motion: a rotation to within {ORTHONORMAL_TOLERANCE}, last row 0 0 0 1");
        Error::file(path, found, expected, "write the poses without scale, shear or reflection")
    })
}

/// Blocks of a header `i j n` and `R` rows of `C` numbers.
fn read_blocks<const R: usize, const C: usize>(path: &Path) -> Result<Vec<([usize; 3], Vec<f64>)>> {
    let text = read_text(path)?;
    let mut lines = lines(&text);
    let mut blocks = Vec::new();
    while let Some(line) = lines.next() {
        let header: Option<Vec<usize>> = line.1.split_whitespace().map(|w| w.parse().ok()).collect();
        let header = header.and_then(|h| <[usize; 3]>::try_from(h).ok());
        let header = header.ok_or_else(|| bad_line(path, line, "a header of three whole numbers 'i j n'"))?;
        let mut values = Vec::with_capacity(R * C);
        for row in 0..R {
            let Some(line) = lines.next() else {
                let found =
                    format!("{row} rows after the last header '{} {} {}'", header[0], header[1], header[2]);
                return Err(Error::file(
                    path,
                    found,
                    format!("{R} rows"),
                    "copy the file again: it is cut short",
                ));
            };
            let row = numbers(line.1).filter(|v| v.len() == C);
            values.extend(row.ok_or_else(|| bad_line(path, line, format!("{C} numbers")))?);
        }
        blocks.push((header, values));
    }
    if blocks.is_empty() {
        let expected = format!("headers 'i j n', each with {R} rows of {C} numbers");
        return Err(Error::file(path, "no entry", expected, "name a log that is not empty"));
    }
    Ok(blocks)
}

/// Reads a Redwood `.log`, of pairs or of a trajectory.
///
/// # Errors
/// [`Error::Read`]; [`Error::File`] for a line that does not fit, a missing row, or a matrix that is no rigid motion.
pub fn read_log(path: impl AsRef<Path>) -> Result<Repaired<Vec<LogEntry>>> {
    let path = path.as_ref();
    let mut deviation = 0.0f64;
    let mut value = Vec::new();
    for ([i, j, n], rows) in read_blocks::<4, 4>(path)? {
        let (pose, off) = repaired(path, &format!("at entry '{i} {j}' the matrix"), &rows)?;
        deviation = deviation.max(off);
        value.push(LogEntry { i, j, n, pose });
    }
    Ok(Repaired { value, deviation })
}

/// Reads a `gt.info`.
///
/// # Errors
/// [`Error::Read`]; [`Error::File`] for a line that does not fit or a number that is not finite.
pub fn read_info(path: impl AsRef<Path>) -> Result<Vec<InfoEntry>> {
    let path = path.as_ref();
    let entry = |([i, j, n], rows): ([usize; 3], Vec<f64>)| {
        if let Some(v) = rows.iter().find(|v| !v.is_finite()) {
            let found = format!("{v} in the matrix of '{i} {j}'");
            return Err(Error::file(path, found, "finite numbers", "compute that information matrix again"));
        }
        Ok(InfoEntry { i, j, n, information: Matrix6::from_row_slice(&rows) })
    };
    read_blocks::<6, 6>(path)?.into_iter().map(entry).collect()
}

/// Writes a Redwood `.log`. Numbers are written so that reading gives back the same bits.
///
/// # Errors
/// [`Error::Write`].
pub fn write_log(path: impl AsRef<Path>, entries: &[LogEntry]) -> Result<()> {
    atomic::write(path.as_ref(), |w| {
        for e in entries {
            writeln!(w, "{}\t{}\t{}", e.i, e.j, e.n)?;
            write_matrix(w, &e.pose, 4, "\n")?;
        }
        Ok(())
    })
}

/// Writes placed scans as a Redwood trajectory: header `i i i+1`, then `world_from_scan`.
///
/// # Errors
/// [`Error::Write`].
pub fn write_log_trajectory(path: impl AsRef<Path>, world_from_scan: &[(ScanId, RigidMotion)]) -> Result<()> {
    let entry = |&(ScanId(i), pose): &(ScanId, RigidMotion)| LogEntry { i, j: i, n: i + 1, pose };
    write_log(path, &world_from_scan.iter().map(entry).collect::<Vec<_>>())
}

/// Writes a `gt.info`.
///
/// # Errors
/// [`Error::Write`].
pub fn write_info(path: impl AsRef<Path>, entries: &[InfoEntry]) -> Result<()> {
    atomic::write(path.as_ref(), |w| {
        for e in entries {
            writeln!(w, "{}\t{}\t{}", e.i, e.j, e.n)?;
            for r in 0..6 {
                let row: Vec<String> = (0..6).map(|c| format!("{:e}", e.information[(r, c)])).collect();
                writeln!(w, "{}", row.join("\t"))?;
            }
        }
        Ok(())
    })
}

fn write_matrix(w: &mut impl Write, pose: &RigidMotion, rows: usize, row_end: &str) -> io::Result<()> {
    let m = pose.to_homogeneous();
    for r in 0..rows {
        let row: Vec<String> = (0..4).map(|c| format!("{:e}", m[(r, c)])).collect();
        let end = if r + 1 == rows { "\n" } else { row_end };
        write!(w, "{}{end}", row.join(" "))?;
    }
    Ok(())
}

/// Reads one 4×4 (or 3×4) matrix, `world_from_scan` by the conventions of the sets that use it:
/// `pose0.txt`, `frame-000000.pose.txt`, and `cloud_bin_0.info.txt` with its header line.
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] when it is not a rigid motion.
pub fn read_matrix(path: impl AsRef<Path>) -> Result<Repaired<RigidMotion>> {
    let path = path.as_ref();
    let text = read_text(path)?;
    let mut rows: Vec<(usize, &str)> = lines(&text).collect();
    // A header may be numbers too, so it is told by the number of lines, or by not being numbers.
    if rows.len() == 5 || rows.first().is_some_and(|l| numbers(l.1).is_none()) {
        rows.remove(0);
    }
    if rows.len() != 3 && rows.len() != 4 {
        let expected = "3 or 4 rows of 4 numbers, after at most one header line";
        return Err(Error::file(path, format!("{} rows", rows.len()), expected, "write one pose a file"));
    }
    let mut values = Vec::new();
    for line in rows {
        let row = numbers(line.1).filter(|v| v.len() == 4);
        values.extend(row.ok_or_else(|| bad_line(path, line, "4 numbers"))?);
    }
    let (value, deviation) = repaired(path, "the matrix", &values)?;
    Ok(Repaired { value, deviation })
}

/// Reads one matrix a line, row-major: 12 numbers (KITTI) or 16 (`poses.txt`).
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] for a line that is not a rigid motion.
pub fn read_kitti(path: impl AsRef<Path>) -> Result<Repaired<Vec<RigidMotion>>> {
    let path = path.as_ref();
    let text = read_text(path)?;
    let mut result = Repaired { value: Vec::new(), deviation: 0.0f64 };
    for line in lines(&text) {
        let values = numbers(line.1).filter(|v| v.len() == 12 || v.len() == 16);
        let values = values
            .ok_or_else(|| bad_line(path, line, "12 or 16 numbers: a 3x4 or 4x4 matrix, row by row"))?;
        let (pose, off) = repaired(path, &format!("in line {} the matrix", line.0), &values)?;
        result.value.push(pose);
        result.deviation = result.deviation.max(off);
    }
    Ok(result)
}

/// Writes one 3×4 matrix a line (KITTI).
///
/// # Errors
/// [`Error::Write`].
pub fn write_kitti(path: impl AsRef<Path>, world_from_scan: &[RigidMotion]) -> Result<()> {
    atomic::write(path.as_ref(), |w| {
        world_from_scan.iter().try_for_each(|pose| write_matrix(w, pose, 3, " "))
    })
}

/// Reads a TUM trajectory: `timestamp tx ty tz qx qy qz qw` a line.
/// The deviation is that of the quaternions' lengths from one.
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] for a line that does not fit or a quaternion that is not of unit length.
pub fn read_tum(path: impl AsRef<Path>) -> Result<Repaired<Vec<(f64, RigidMotion)>>> {
    let path = path.as_ref();
    let text = read_text(path)?;
    let mut result = Repaired { value: Vec::new(), deviation: 0.0f64 };
    for line in lines(&text) {
        let v = numbers(line.1).filter(|v| v.len() == 8);
        let v = v.ok_or_else(|| bad_line(path, line, "8 numbers: timestamp tx ty tz qx qy qz qw"))?;
        let (pose, off) = motion_from_quaternion(&v[1..4], &v[4..8])
            .ok_or_else(|| bad_line(path, line, "finite numbers and a quaternion of unit length"))?;
        result.value.push((v[0], pose));
        result.deviation = result.deviation.max(off);
    }
    Ok(result)
}

/// From `[tx ty tz]` and `[qx qy qz qw]`, with how far the quaternion's length was from one.
pub(super) fn motion_from_quaternion(t: &[f64], q: &[f64]) -> Option<(RigidMotion, f64)> {
    let q = Quaternion::new(*q.get(3)?, q[0], q[1], q[2]);
    let off = (q.norm() - 1.0).abs();
    if off.is_nan() || off > ORTHONORMAL_TOLERANCE || t.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let rotation = UnitQuaternion::from_quaternion(q);
    Some((RigidMotion::from_parts(Translation3::from(Vector3::from_column_slice(t)), rotation), off))
}

/// Writes a TUM trajectory with scan numbers as timestamps; quaternions have qw ≥ 0.
///
/// # Errors
/// [`Error::Write`].
pub fn write_tum(path: impl AsRef<Path>, world_from_scan: &[(ScanId, RigidMotion)]) -> Result<()> {
    atomic::write(path.as_ref(), |w| {
        writeln!(w, "# scan tx ty tz qx qy qz qw")?;
        for (id, pose) in world_from_scan {
            let (t, q) = (pose.translation.vector, pose.rotation.into_inner());
            let q = if q.w < 0.0 { -q } else { q };
            writeln!(w, "{id} {:e} {:e} {:e} {:e} {:e} {:e} {:e}", t.x, t.y, t.z, q.i, q.j, q.k, q.w)?;
        }
        Ok(())
    })
}

/// Reads the `bmesh` lines of a Stanford `.conf` as `(file, world_from_scan)`.
///
/// A line `bmesh FILE tx ty tz qx qy qz qw` means p_world = R(q)ᵀ p + t (checked by the scans' overlap:
/// the transposed reading of the quaternion is the one that fits).
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] for a line that does not fit or when there is none.
pub fn read_conf(path: impl AsRef<Path>) -> Result<Repaired<Vec<(String, RigidMotion)>>> {
    let path = path.as_ref();
    let text = read_text(path)?;
    let mut result = Repaired { value: Vec::new(), deviation: 0.0f64 };
    for line in lines(&text) {
        let Some(rest) = line.1.strip_prefix("bmesh") else { continue };
        let parsed = rest.trim().split_once(char::is_whitespace).and_then(|(file, rest)| {
            let v = numbers(rest).filter(|v| v.len() == 7)?;
            let (pose, off) = motion_from_quaternion(&v[..3], &v[3..])?;
            Some((file, RigidMotion::from_parts(pose.translation, pose.rotation.inverse()), off))
        });
        let (file, pose, off) = parsed.ok_or_else(|| {
            bad_line(path, line, "'bmesh FILE tx ty tz qx qy qz qw' with a unit quaternion")
        })?;
        result.value.push((file.to_owned(), pose));
        result.deviation = result.deviation.max(off);
    }
    if result.value.is_empty() {
        return Err(Error::file(
            path,
            "no bmesh line",
            "a line 'bmesh FILE tx ty tz qx qy qz qw' for every scan",
            "name the scans' .conf file",
        ));
    }
    Ok(result)
}
