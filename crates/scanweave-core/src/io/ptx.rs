//! PTX (Leica): text, one grid of returns after the other.
//!
//! A scan is its number of columns, its number of rows, the scanner's place (one line), its axes (three
//! lines), a 4×4 matrix (four lines) and columns · rows lines `x y z intensity [r g b]`. Points are row
//! vectors: world = [x y z 1]·M, hence the translation is the last row. `0 0 0` is a direction without a return.

use super::poses::ORTHONORMAL_TOLERANCE;
use super::scalar::{counted, parse_between_blanks};
use super::scan_file::{Note, ReadOptions, ScanFile, StoredScan};
use super::scanner::{drop_implausible_viewpoint, drop_poses_that_say_nothing};
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::geometry::rigid::motion_from_matrix;
use crate::printable::printable_start;
use crate::scan::PointCloud;
use crate::scan::assemble::{Attributes, assemble_with};
use nalgebra::Matrix4;
use std::path::Path;

/// Numbers of a row that are looked at: `x y z intensity r g b`.
const WIDEST: usize = 7;

/// Whether content begins as a PTX does: two whole numbers on lines of their own, four lines of three
/// numbers, four of four.
pub(super) fn begins(head: &[u8]) -> bool {
    let mut lines = Lines::new(head);
    let mut width = |wanted: usize| {
        lines.next().is_some_and(|(_, line)| Row::new(line).is_some_and(|r| r.width == wanted))
    };
    let mut widths = [1, 1, 3, 3, 3, 3, 4, 4, 4, 4].into_iter();
    widths.all(&mut width)
}

/// Reads every scan relative to its scanner, with the pose that its matrix states.
///
/// # Errors
/// [`Error::File`] for a line that is not as the format says, and for a scan with fewer rows than it states.
pub(super) fn read(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<ScanFile> {
    let mut lines = Lines::new(bytes);
    let mut read = ScanFile::default();
    let (mut strange_pose, mut far) = (false, false);
    while let Some(header) = Header::read(path, read.scans.len() + 1, &mut lines)? {
        let mut cloud = rows(path, read.scans.len() + 1, &header, &mut lines, options)?;
        far |= drop_implausible_viewpoint(&mut cloud);
        strange_pose |= header.pose.is_none();
        read.scans.push(StoredScan { cloud, pose: header.pose });
    }
    if read.scans.is_empty() {
        let expected = "a PTX file: columns, rows, scanner, matrix, rows of x y z intensity";
        return Err(Error::file(path, "no scan", expected, "export the scan again"));
    }
    drop_poses_that_say_nothing(&mut read.scans);
    if strange_pose {
        read.notes.push(Note::warning("a scan states a pose that is no rigid motion; it is not used"));
    }
    if far {
        let text = "the zero of a scan, where its sensor should have stood, is far from its points; \
                    the place of the sensor is taken as unknown";
        read.notes.push(Note::warning(text));
    }
    Ok(read)
}

/// Lines that are not empty, with their numbers, counted from one.
struct Lines<'a> {
    rest: &'a [u8],
    number: usize,
}

impl<'a> Lines<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes), number: 0 }
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = (usize, &'a str);

    fn next(&mut self) -> Option<Self::Item> {
        while !self.rest.is_empty() {
            let end = self.rest.iter().position(|b| *b == b'\n').unwrap_or(self.rest.len());
            let line = &self.rest[..end];
            self.rest = self.rest.get(end + 1..).unwrap_or_default();
            self.number += 1;
            // What is not UTF-8 is no number either.
            let text = std::str::from_utf8(line).unwrap_or("\u{fffd}").trim();
            if !text.is_empty() {
                return Some((self.number, text));
            }
        }
        None
    }
}

/// The numbers of a line.
struct Row {
    values: [f64; WIDEST],
    width: usize,
}

impl Row {
    /// `None` where a word is no number.
    fn new(line: &str) -> Option<Self> {
        let mut row = Self { values: [0.0; WIDEST], width: 0 };
        for word in line.split_ascii_whitespace() {
            let value = parse_between_blanks(word)?;
            if let Some(place) = row.values.get_mut(row.width) {
                *place = value;
            }
            row.width += 1;
        }
        Some(row)
    }
}

/// What stands before the rows of a scan.
struct Header {
    columns: usize,
    rows: usize,
    total: usize,
    pose: Option<RigidMotion>,
    viewpoint_m: [f64; 3],
}

impl Header {
    /// `None` at the end of the file.
    fn read(path: &Path, scan: usize, lines: &mut Lines<'_>) -> Result<Option<Self>> {
        let Some(first) = lines.next() else { return Ok(None) };
        if scan > 1 && Row::new(first.1).is_some_and(|row| row.width >= 3) {
            let found = format!("a further row in line {} after all of scan {}", first.0, scan - 1);
            let remedy = "correct the numbers of columns and rows of that scan, or export the file again";
            return Err(Error::file(path, found, "the next scan or the end of the file", remedy));
        }
        let columns = whole(path, scan, "its number of columns", Some(first))?;
        let rows = whole(path, scan, "its number of rows", lines.next())?;
        let total = columns.checked_mul(rows).ok_or_else(|| {
            bad_line(path, scan, &format!("a grid of fewer than {columns} x {rows}"), Some(first))
        })?;
        let position = numbers::<3>(path, scan, "the scanner's place", lines.next())?;
        for _ in 0..3 {
            numbers::<3>(path, scan, "an axis of the scanner", lines.next())?;
        }
        let mut matrix = Matrix4::zeros();
        for i in 0..4 {
            // A row of the file is a column of the matrix for column vectors.
            matrix.set_column(i, &numbers::<4>(path, scan, "a row of its matrix", lines.next())?.into());
        }
        let pose = motion_from_matrix(&matrix, ORTHONORMAL_TOLERANCE).map(|(pose, _)| pose);
        // Where the matrix moves nothing, the points may be in the coordinates of the scanner's place.
        let viewpoint_m = if pose == Some(RigidMotion::identity()) { position } else { [0.0; 3] };
        Ok(Some(Self { columns, rows, total, pose, viewpoint_m }))
    }
}

fn bad_line(path: &Path, scan: usize, what: &str, line: Option<(usize, &str)>) -> Error {
    let found = match line {
        Some((number, text)) => {
            format!("line {number} '{}' in scan {scan}", printable_start(text, 80))
        }
        None => format!("the end of the file in scan {scan}"),
    };
    let remedy = "copy or export the file again if it is cut short, or correct that line";
    Error::file(path, found, what, remedy)
}

fn numbers<const N: usize>(
    path: &Path,
    scan: usize,
    what: &str,
    line: Option<(usize, &str)>,
) -> Result<[f64; N]> {
    let row = line.and_then(|(_, text)| Row::new(text)).filter(|row| row.width == N);
    row.and_then(|row| row.values.first_chunk::<N>().copied())
        .ok_or_else(|| bad_line(path, scan, &format!("{what}: {}", counted(N, "number")), line))
}

fn whole(path: &Path, scan: usize, what: &str, line: Option<(usize, &str)>) -> Result<usize> {
    let count = line.and_then(|(_, text)| text.parse().ok());
    count.ok_or_else(|| bad_line(path, scan, &format!("{what}: one whole number"), line))
}

/// The rows of a scan. Nothing is reserved by the size of the grid, which is only stated.
fn rows(
    path: &Path,
    scan: usize,
    header: &Header,
    lines: &mut Lines<'_>,
    options: &ReadOptions,
) -> Result<PointCloud> {
    let mut xyz: Vec<[f64; 3]> = Vec::new();
    let mut colors: Vec<[u8; 3]> = Vec::new();
    let mut intensities: Vec<f32> = Vec::new();
    let mut widest = 0;
    for read in 0..header.total {
        let line = lines.next();
        let row = line.map(|(_, text)| Row::new(text));
        // One number alone is the first line of the next scan.
        let ended = matches!(&row, None | Some(Some(Row { width: 1, .. })));
        if ended {
            let found = format!("{} in scan {scan}", counted(read, "row"));
            let Header { columns, rows, total, .. } = header;
            let expected = format!("{total} ({columns} x {rows}) as its first lines say");
            return Err(Error::file(path, found, expected, "copy or export the file again: it is cut short"));
        }
        let row = row.flatten().filter(|row| row.width >= 3);
        let row = row.ok_or_else(|| bad_line(path, scan, "a row x y z intensity [r g b]", line))?;
        let [x, y, z, intensity, r, g, b] = row.values;
        if [x, y, z] == [0.0; 3] {
            continue;
        }
        widest = widest.max(row.width);
        xyz.push([x, y, z]);
        // `as u8` saturates.
        colors.push([r, g, b].map(|v| v.round() as u8));
        if options.attributes {
            intensities.push(intensity as f32);
        }
    }
    let rgb = |i: usize| colors[i];
    let intensity = |i: usize| intensities[i];
    let attributes = Attributes {
        rgb: (widest >= 7).then_some(&rgb as &dyn Fn(usize) -> [u8; 3]),
        intensity: (options.attributes && widest >= 4).then_some(&intensity as &dyn Fn(usize) -> f32),
        ..Attributes::default()
    };
    let mut cloud = assemble_with(xyz.len(), |i| xyz[i], &attributes, Some(header.viewpoint_m));
    cloud.dropped_rows += header.total - xyz.len();
    Ok(cloud)
}

#[cfg(test)]
mod tests;
