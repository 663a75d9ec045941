//! PLY: ASCII and both binary byte orders, extra and list properties, faces ignored.

mod ascii;
mod binary;
pub(super) mod blocks;
mod header;
#[cfg(test)]
mod tests;

use super::colors::bytes_per_unit;
use super::fields::{INTENSITY, NORMAL, Names, RGB, three, whole_number_note};
use super::scalar::{Scalar, counted};
use super::scan_file::{ReadOptions, ScanFile};
use super::vertices::Vertices;
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use header::{Element, Encoding, Header, Kind};
use std::path::Path;

/// Which properties of the vertex element are read.
struct Fields {
    xyz: [usize; 3],
    rgb: Option<[usize; 3]>,
    /// How the colour is written.
    color: Color,
    intensity: Option<usize>,
    normal: Option<[usize; 3]>,
    /// Whether several rows at zero are directions without a return; else rows keep their places.
    drop_zeros: bool,
}

/// How the numbers of a colour are to be taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Color {
    /// Channels of this type.
    Channels(Scalar),
    /// The constant term of spherical harmonics, as the Gaussians of a radiance field have it.
    Harmonics,
}

/// The constant spherical harmonic, 1 / (2 sqrt(pi)).
const HARMONIC_0: f64 = 0.282_094_791_773_878_14;
/// Names of the constant terms of the colour of Gaussians.
const HARMONICS: [Names; 3] = [&["f_dc_0"], &["f_dc_1"], &["f_dc_2"]];

/// Reads the points (and colours, where there are any) of a PLY file's `bytes`.
///
/// # Errors
/// [`Error::File`] when the header cannot be used, or the data hold fewer or more rows than it says.
pub(super) fn read(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<ScanFile> {
    let (header, vertex) = parse(path, bytes)?;
    let element = &header.elements[vertex];
    let fields = Fields { drop_zeros: true, ..find_fields(path, element, options.attributes)? };
    let note = whole_number_note(fields.xyz.map(|i| scalar_of(element.properties[i].kind)), options);
    let file: ScanFile = read_fields(path, bytes, &header, vertex, &fields)?.into();
    Ok(match note {
        Some(note) => file.with(note),
        None => file,
    })
}

/// Reads points and colours as they are.
///
/// # Errors
/// As [`read`].
pub(super) fn read_points(path: &Path, bytes: &[u8]) -> Result<PointCloud> {
    let (header, vertex) = parse(path, bytes)?;
    let fields = find_fields(path, &header.elements[vertex], false)?;
    read_fields(path, bytes, &header, vertex, &fields)
}

/// Reads one scalar property of every vertex.
///
/// # Errors
/// As [`read`]; [`Error::File`] where the property is missing or a value is not finite.
pub(super) fn read_property(path: &Path, bytes: &[u8], name: &str) -> Result<Vec<f64>> {
    let (header, vertex) = parse(path, bytes)?;
    let missing = || {
        let found = format!("vertices without a property {name}");
        Error::file(path, found, format!("a scalar property {name}"), "name a file that has it")
    };
    // The value stands for all three coordinates of a cloud, whose first one is then read.
    let xyz = [scalar(&header.elements[vertex], &[name]).ok_or_else(missing)?; 3];
    let color = Color::Channels(Scalar::U8);
    let fields = Fields { xyz, rgb: None, color, intensity: None, normal: None, drop_zeros: false };
    let cloud = read_fields(path, bytes, &header, vertex, &fields)?;
    if cloud.dropped_rows > 0 {
        let found = format!("{} rows whose {name} is no finite number", cloud.dropped_rows);
        return Err(Error::file(path, found, "finite numbers", "write the file again"));
    }
    Ok(cloud.points.iter().map(|p| f64::from(p.x) + cloud.origin_m.x).collect())
}

/// The header, and which of its elements holds the vertices.
fn parse(path: &Path, bytes: &[u8]) -> Result<(Header, usize)> {
    let header = header::parse(path, bytes)?;
    let vertex = header.elements.iter().position(|e| e.name == "vertex").ok_or_else(|| {
        let names: Vec<&str> = header.elements.iter().map(|e| e.name.as_str()).collect();
        let found = format!("elements [{}]", names.join(", "));
        Error::file(path, found, "an element named vertex", "export the scan as a point cloud")
    })?;
    Ok((header, vertex))
}

fn read_fields(
    path: &Path,
    bytes: &[u8],
    header: &Header,
    vertex: usize,
    fields: &Fields,
) -> Result<PointCloud> {
    match header.encoding {
        Encoding::Ascii => ascii::read(path, bytes, header, vertex, fields),
        Encoding::Binary(endian) => binary::read(path, bytes, header, vertex, fields, endian),
    }
}

/// Place of the first of these properties that is one number.
fn scalar(vertex: &Element, names: &[&str]) -> Option<usize> {
    vertex.find(names).filter(|&i| matches!(vertex.properties[i].kind, Kind::Scalar(_)))
}

fn find_fields(path: &Path, vertex: &Element, attributes: bool) -> Result<Fields> {
    let find = |names: &[&str]| scalar(vertex, names);
    let Some(xyz) = three([&["x"], &["y"], &["z"]], find) else {
        let names: Vec<&str> = vertex.properties.iter().map(|p| p.name.as_str()).collect();
        let found = format!("vertex properties [{}]", names.join(", "));
        let remedy = "export the scan with coordinates";
        return Err(Error::file(path, found, "scalar properties x, y and z", remedy));
    };
    let channels = three(RGB, find);
    let harmonics = three(HARMONICS, find);
    let color = match channels {
        None if harmonics.is_some() => Color::Harmonics,
        _ => Color::Channels(channels.map_or(Scalar::U8, |rgb| scalar_of(vertex.properties[rgb[0]].kind))),
    };
    Ok(Fields {
        xyz,
        rgb: channels.or(harmonics),
        color,
        intensity: find(INTENSITY).filter(|_| attributes),
        // Gaussians have the fields of a normal, and zeros in them.
        normal: three(NORMAL, find).filter(|_| attributes && harmonics.is_none()),
        drop_zeros: false,
    })
}

/// Fewer rows in the data than the header promises.
fn too_few(path: &Path, element: &Element, rows: usize, bytes: Option<(usize, Option<usize>)>) -> Error {
    let mut found = format!("{rows} of {} complete {} rows", element.count, element.name);
    let mut expected = format!("{} rows as its header says", element.count);
    if let Some((there, Some(needed))) = bytes {
        found = format!("{there} bytes with {found}");
        expected = format!("{needed} bytes with {expected}");
    }
    Error::file(path, found, expected, "copy or export the file again: it is cut short")
}

fn too_many(path: &Path, found: String, element: &Element) -> Error {
    let expected = format!("the end of the file after {} as its header says", counted(element.count, "row"));
    Error::file(path, found, expected, "correct the counts in the header or export the scan again")
}

fn scalar_of(kind: Kind) -> Scalar {
    match kind {
        Kind::Scalar(s) => s,
        Kind::List { item, .. } => item,
    }
}

/// What takes the numbers of a colour to bytes.
#[derive(Clone, Copy)]
struct ColorRange {
    /// Bytes a unit, and of zero; `None` where the numbers are bytes.
    line: Option<(f64, f64)>,
}

impl ColorRange {
    /// Of channels that are floats, all are looked at for their range.
    fn of(color: Color, all: impl Iterator<Item = [f64; 3]>) -> Self {
        Self {
            line: match color {
                Color::Channels(Scalar::F32 | Scalar::F64) => Some((bytes_per_unit(all), 0.0)),
                Color::Channels(Scalar::U16) => Some((257f64.recip(), 0.0)),
                Color::Channels(_) => None,
                Color::Harmonics => Some((255.0 * HARMONIC_0, 127.5)),
            },
        }
    }

    fn bytes(self, channels: [f64; 3]) -> [u8; 3] {
        // `as u8` saturates and takes NaN to zero.
        channels.map(|v| self.line.map_or(v as u8, |(slope, zero)| (v * slope + zero).round() as u8))
    }
}

/// Columns of a [`Table`]: coordinates, colours, the normal, the intensity.
const COLUMNS: usize = 10;
const RGB_COLUMN: usize = 3;
const NORMAL_COLUMN: usize = 6;
const INTENSITY_COLUMN: usize = 9;

/// What is read of the vertices, gathered value by value.
struct Table {
    /// For each property the columns it goes to.
    columns: Vec<Vec<usize>>,
    row: [f64; COLUMNS],
    xyz: Vec<[f64; 3]>,
    rgb: Option<Vec<[f64; 3]>>,
    normal: Option<Vec<[f32; 3]>>,
    intensity: Option<Vec<f32>>,
}

impl Table {
    /// `data_bytes` bounds what a lying header can make us reserve: every property takes a byte or more.
    fn new(element: &Element, fields: &Fields, data_bytes: usize) -> Self {
        let mut columns = vec![Vec::new(); element.properties.len()];
        let mut wanted: Vec<(usize, usize)> = Vec::with_capacity(COLUMNS);
        let mut want = |first: usize, properties: &[usize]| {
            wanted.extend(properties.iter().enumerate().map(|(k, &p)| (first + k, p)));
        };
        want(0, &fields.xyz);
        fields.rgb.iter().for_each(|rgb| want(RGB_COLUMN, rgb));
        fields.normal.iter().for_each(|normal| want(NORMAL_COLUMN, normal));
        fields.intensity.iter().for_each(|&intensity| want(INTENSITY_COLUMN, &[intensity]));
        for (column, property) in wanted {
            columns[property].push(column);
        }
        let rows = element.count.min(data_bytes / element.properties.len().max(1));
        Self {
            columns,
            row: [0.0; COLUMNS],
            xyz: Vec::with_capacity(rows),
            rgb: fields.rgb.map(|_| Vec::with_capacity(rows)),
            normal: fields.normal.map(|_| Vec::with_capacity(rows)),
            intensity: fields.intensity.map(|_| Vec::with_capacity(rows)),
        }
    }

    #[inline]
    fn is_wanted(&self, property: usize) -> bool {
        !self.columns[property].is_empty()
    }

    #[inline]
    fn set(&mut self, property: usize, value: f64) {
        for &column in &self.columns[property] {
            self.row[column] = value;
        }
    }

    fn end_row(&mut self) {
        let [x, y, z, r, g, b, nx, ny, nz, intensity] = self.row;
        self.xyz.push([x, y, z]);
        self.rgb.iter_mut().for_each(|all| all.push([r, g, b]));
        self.normal.iter_mut().for_each(|all| all.push([nx as f32, ny as f32, nz as f32]));
        self.intensity.iter_mut().for_each(|all| all.push(intensity as f32));
    }

    fn into_cloud(self, fields: &Fields) -> PointCloud {
        let rgb = self.rgb.map(|values| {
            let range = ColorRange::of(fields.color, values.iter().copied());
            values.into_iter().map(|c| range.bytes(c)).collect()
        });
        let vertices = Vertices { xyz: self.xyz, rgb, intensity: self.intensity, normal: self.normal };
        if fields.drop_zeros { vertices.without_zeros().into_cloud() } else { vertices.into_cloud() }
    }
}
