//! NPY arrays (NumPy), and clouds in them: `[n,3]` or wider, `[h,w,3]`, or structured with fields.

use super::colors::channels_of;
use super::fields::{INTENSITY, NORMAL, Names, RGB, three, whole_number_note};
use super::npy_header::{self, Field, Header};
use super::scalar::{Endian, Scalar};
use super::scan_file::{ReadOptions, ScanFile};
use super::scanner::without_zeros;
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use crate::scan::assemble::{Attributes, assemble_with};
use std::path::Path;

/// A type to which the numbers of an array are converted one by one, so that no wider copy is made.
pub(super) trait Number: Copy {
    fn of(value: f64) -> Self;
}

impl Number for u8 {
    fn of(value: f64) -> Self {
        value as u8
    }
}

impl Number for u32 {
    fn of(value: f64) -> Self {
        value as u32
    }
}

impl Number for f32 {
    fn of(value: f64) -> Self {
        value as f32
    }
}

impl Number for f64 {
    fn of(value: f64) -> Self {
        value
    }
}

/// A dense array of numbers, row-major.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Array<T = f64> {
    pub shape: Vec<usize>,
    pub values: Vec<T>,
}

impl<T: Number> Array<T> {
    /// `[rows, columns]` of a two-dimensional array.
    pub(super) fn matrix(&self) -> Option<(usize, usize)> {
        match self.shape[..] {
            [rows, columns] => Some((rows, columns)),
            _ => None,
        }
    }

    /// The first three columns of `[n, >=3]`.
    pub(super) fn points(&self) -> Option<Vec<[T; 3]>> {
        let (_, columns) = self.matrix().filter(|&(_, c)| c >= 3)?;
        Some(self.values.chunks_exact(columns).map(|r| [r[0], r[1], r[2]]).collect())
    }
}

/// Reads one array from the bytes of an NPY file; `label` names it in messages (its key in an NPZ).
///
/// # Errors
/// [`Error::File`] for another number type than integers and floats, or fewer bytes than the shape needs.
pub(super) fn read_array<T: Number>(path: &Path, label: &str, bytes: &[u8]) -> Result<Array<T>> {
    let view = View::new(path, label, bytes)?;
    let bad = |found: String, expected: &str| Error::file(path, format!("{label}{found}"), expected, REMEDY);
    let (scalar, endian) = view.header.plain().ok_or_else(|| view.bad_type(path, label))?;
    let shape = view.header.shape.clone();
    let number = |at: usize| view.data.get(at * scalar.size()..).map_or(f64::NAN, |b| scalar.read(b, endian));
    let value = |at: usize| T::of(number(at));
    let count = view.data.len() / scalar.size();
    let values = match shape[..] {
        [rows, columns] if view.header.column_major && count > 0 => {
            (0..rows).flat_map(|r| (0..columns).map(move |c| c * rows + r)).map(value).collect()
        }
        _ if view.header.column_major && shape.len() > 2 => {
            let found = format!("column-major data of shape {shape:?}");
            return Err(bad(found, "at most two dimensions in column-major order"));
        }
        _ => (0..count).map(value).collect(),
    };
    Ok(Array { shape, values })
}

const REMEDY: &str = "save it again with numpy.save or numpy.savez";

/// An array where it lies.
pub(super) struct View<'a> {
    header: Header,
    /// As many bytes as the shape needs.
    data: &'a [u8],
}

impl<'a> View<'a> {
    pub(super) fn new(path: &Path, label: &str, bytes: &'a [u8]) -> Result<Self> {
        let (header, data) = npy_header::parse(bytes).ok_or_else(|| {
            let found = format!("{label}{} bytes that are no NPY array", bytes.len());
            Error::file(path, found, "an NPY header and data", REMEDY)
        })?;
        let needed = header.data_bytes();
        let Some(data) = needed.and_then(|n| data.get(..n)) else {
            return Err(too_short(path, label, &header, data.len()));
        };
        Ok(Self { header, data })
    }

    fn bad_type(&self, path: &Path, label: &str) -> Error {
        let found = format!("{label}elements of type '{}'", self.header.descr);
        Error::file(path, found, "integers or 16, 32 or 64-bit floats", REMEDY)
    }

    fn column(&self, scalar: Scalar, endian: Endian, first: usize, step: usize) -> Column<'a> {
        Column { data: self.data, scalar, endian, first, step }
    }

    /// Columns `0..N` of a plain `[n, >=N]` or `[h, w, N]`, and its rows.
    pub(super) fn columns<const N: usize>(&self) -> Option<([Column<'a>; N], usize)> {
        let (scalar, endian) = self.header.plain()?;
        let size = scalar.size();
        let (rows, width) = match self.header.shape[..] {
            [rows] if N == 1 => (rows, 1),
            [rows, columns] if columns >= N => (rows, columns),
            [height, width, columns] if columns == N && !self.header.column_major => {
                (height.checked_mul(width)?, columns)
            }
            _ => return None,
        };
        // Below, nothing overflows: there are bytes for all that the shape says, or it has no row.
        let rows = if self.data.is_empty() { 0 } else { rows };
        Some((
            std::array::from_fn(|k| match self.header.column_major {
                true => self.column(scalar, endian, k * rows * size, size),
                false => self.column(scalar, endian, k * size, width.saturating_mul(size)),
            }),
            rows,
        ))
    }

    /// The numbers of the first of these fields that has `N` of them in an element.
    fn field<const N: usize>(&self, names: Names) -> Option<[Column<'a>; N]> {
        let named = |n: &str| self.header.fields.iter().find(|f| f.name.eq_ignore_ascii_case(n));
        let fits = |f: &&Field| f.count == N || (N == 3 && f.count == 4);
        let field = names.iter().filter_map(|n| named(n)).find(fits)?;
        let scalar = field.scalar?;
        Some(std::array::from_fn(|k| {
            let first = field.offset + k * scalar.size();
            self.column(scalar, field.endian, first, self.header.element_bytes)
        }))
    }

    /// Three numbers in fields of their own, or in one.
    fn three(&self, apart: [Names; 3], together: Names) -> Option<[Column<'a>; 3]> {
        three(apart, |names| self.field::<1>(names).map(|[c]| c)).or_else(|| self.field::<3>(together))
    }

    /// Where the points are, and what belongs to them; `None` for what holds no points.
    pub(super) fn points(&self) -> Option<Columns<'a>> {
        if let Some((xyz, rows)) = self.columns::<3>() {
            return Some(Columns { rows, xyz, color: None, intensity: None, normal: None });
        }
        if self.header.element_bytes == 0 {
            return None;
        }
        let xyz = self.three(XYZ, &["xyz", "points", "point", "position", "positions", "pos", "coord"])?;
        let packed = self.field::<1>(&["rgb", "rgba"]).map(|[c]| c).filter(|c| c.scalar.size() == 4);
        let channels = || self.three(RGB, &["rgb", "rgba", "color", "colors", "colour"]).map(Color::Channels);
        Some(Columns {
            rows: self.header.elements()?,
            xyz,
            color: packed.map(Color::Packed).or_else(channels),
            intensity: self.field::<1>(INTENSITY).map(|[c]| c),
            normal: self.three(NORMAL, &["normal", "normals"]),
        })
    }
}

/// Fewer bytes than the shape needs.
pub(super) fn too_short(path: &Path, label: &str, header: &Header, found: usize) -> Error {
    let needed = header.data_bytes().map_or_else(|| "more".to_owned(), |n| n.to_string());
    let expected = format!("{needed} bytes for shape {:?} as its header says", header.shape);
    let remedy = "copy or save the file again: it is cut short";
    Error::file(path, format!("{label}{found} bytes of data"), expected, remedy)
}

/// Coordinates in fields or arrays of their own.
pub(super) const XYZ: [Names; 3] = [&["x"], &["y"], &["z"]];

/// One number of every row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Column<'a> {
    data: &'a [u8],
    scalar: Scalar,
    endian: Endian,
    first: usize,
    step: usize,
}

impl Column<'_> {
    fn bytes(&self, row: usize) -> &[u8] {
        self.data.get(self.first + row * self.step..).unwrap_or(&[])
    }

    fn at(&self, row: usize) -> f64 {
        self.scalar.read(self.bytes(row), self.endian)
    }
}

/// How colour is stored.
#[derive(Clone, Copy)]
pub(super) enum Color<'a> {
    /// The bytes 0xAARRGGBB in one number.
    Packed(Column<'a>),
    Channels([Column<'a>; 3]),
}

impl Color<'_> {
    fn bytes(&self, rows: usize) -> Vec<[u8; 3]> {
        match self {
            Color::Packed(column) => {
                let bits = |row| match (column.bytes(row).first_chunk(), column.endian) {
                    (Some(b), Endian::Little) => u32::from_le_bytes(*b),
                    (Some(b), Endian::Big) => u32::from_be_bytes(*b),
                    (None, _) => 0,
                };
                let [r, g, b] = [16, 8, 0];
                (0..rows).map(|row| [r, g, b].map(|shift| (bits(row) >> shift) as u8)).collect()
            }
            Color::Channels(columns) => {
                let values: Vec<[f64; 3]> = (0..rows).map(|row| columns.map(|c| c.at(row))).collect();
                channels_of(&values, columns[0].scalar)
            }
        }
    }
}

/// Where all that is read of a cloud lies.
pub(super) struct Columns<'a> {
    pub rows: usize,
    pub xyz: [Column<'a>; 3],
    pub color: Option<Color<'a>>,
    pub intensity: Option<Column<'a>>,
    pub normal: Option<[Column<'a>; 3]>,
}

impl Columns<'_> {
    pub(super) fn into_file(self, options: &ReadOptions) -> ScanFile {
        let note = whole_number_note(self.xyz.map(|c| c.scalar), options);
        let mut file: ScanFile = self.into_cloud(options.attributes).into();
        file.notes.extend(note);
        file
    }

    fn into_cloud(self, with_attributes: bool) -> PointCloud {
        let colors = self.color.map(|c| c.bytes(self.rows));
        let rgb = colors.as_ref().map(|c| |row: usize| c[row]);
        let intensity = self.intensity.filter(|_| with_attributes);
        let intensity = intensity.map(|c| move |row: usize| c.at(row) as f32);
        let normal = self.normal.filter(|_| with_attributes);
        let normal = normal.map(|n| move |row: usize| n.map(|c| c.at(row) as f32));
        let attributes = Attributes {
            rgb: rgb.as_ref().map(|f| f as &dyn Fn(usize) -> [u8; 3]),
            intensity: intensity.as_ref().map(|f| f as &dyn Fn(usize) -> f32),
            normal: normal.as_ref().map(|f| f as &dyn Fn(usize) -> [f32; 3]),
        };
        let xyz = without_zeros(self.rows, |row| self.xyz.map(|c| c.at(row)));
        assemble_with(self.rows, xyz, &attributes, None)
    }
}

/// Reads a cloud from the bytes of an NPY file.
///
/// # Errors
/// [`Error::File`] for a damaged array, [`Error::NotAScan`] for one that holds no points.
pub(super) fn read(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<ScanFile> {
    let view = View::new(path, "", bytes)?;
    match view.points() {
        Some(columns) => Ok(columns.into_file(options)),
        None => Err(no_points(path, "", &view)),
    }
}

/// An array that holds no points.
pub(super) fn no_points(path: &Path, label: &str, view: &View<'_>) -> Error {
    let names: Vec<&str> = view.header.fields.iter().map(|f| f.name.as_str()).collect();
    if view.header.descr == npy_header::STRUCTURED {
        let found = format!("{label}an array with the fields [{}]", names.join(", "));
        return Error::not_a_scan(path, found, "fields x, y and z, or xyz", "name the coordinates so");
    }
    if view.header.plain().is_none() {
        return view.bad_type(path, label);
    }
    let found = format!("{label}an array of shape {:?}", view.header.shape);
    Error::not_a_scan(path, found, "shape [n, 3] or wider", "save one point a row: x, y, z")
}

#[cfg(test)]
mod tests;
