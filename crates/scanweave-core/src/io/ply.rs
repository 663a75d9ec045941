//! PLY: ASCII and both binary byte orders, extra and list properties, faces ignored.
//!
//! Binary files whose vertex rows have a fixed length, the usual case, are read
//! in place. Anything else goes row by row.

use super::colors::channels_to_bytes;
use super::ply_header::{self, Element, Encoding, Header, Kind};
use super::scalar::{Endian, Scalar, counted, parse_number};
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use crate::scan::assemble::{NO_COLORS, assemble};
use std::path::Path;

/// Which properties of the vertex element are read.
struct Fields {
    xyz: [usize; 3],
    rgb: Option<[usize; 3]>,
}

/// Reads the points (and colours, where there are any) of a PLY file's `bytes`.
///
/// # Errors
/// [`Error::File`] when the header cannot be used, or the data hold fewer or more rows than it says.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<PointCloud> {
    read_fields(path, bytes, find_fields)
}

/// Reads one scalar property of every vertex.
///
/// # Errors
/// As [`read`]; [`Error::File`] where the property is missing or a value is not finite.
pub(super) fn read_property(path: &Path, bytes: &[u8], name: &str) -> Result<Vec<f64>> {
    // The value stands for all three coordinates of a cloud, whose first one is then read.
    let fields = |path: &Path, vertex: &Element| {
        let remedy = "name a file that has it";
        let found = format!("vertices without a property {name}");
        let missing = || Error::file(path, found, format!("a scalar property {name}"), remedy);
        Ok(Fields { xyz: [scalar(vertex, &[name]).ok_or_else(missing)?; 3], rgb: None })
    };
    let cloud = read_fields(path, bytes, fields)?;
    if cloud.dropped_rows > 0 {
        let found = format!("{} rows whose {name} is no finite number", cloud.dropped_rows);
        return Err(Error::file(path, found, "finite numbers", "write the file again"));
    }
    Ok(cloud.points.iter().map(|p| f64::from(p.x) + cloud.origin_m.x).collect())
}

fn read_fields(
    path: &Path,
    bytes: &[u8],
    find: impl Fn(&Path, &Element) -> Result<Fields>,
) -> Result<PointCloud> {
    let header = ply_header::parse(path, bytes)?;
    let vertex = header.elements.iter().position(|e| e.name == "vertex").ok_or_else(|| {
        let names: Vec<&str> = header.elements.iter().map(|e| e.name.as_str()).collect();
        let found = format!("elements [{}]", names.join(", "));
        Error::file(path, found, "an element named vertex", "export the scan as a point cloud")
    })?;
    let fields = find(path, &header.elements[vertex])?;
    match header.encoding {
        Encoding::Ascii => read_ascii(path, bytes, &header, vertex, &fields),
        Encoding::Binary(endian) => read_binary(path, bytes, &header, vertex, &fields, endian),
    }
}

/// Place of the first of these properties that is one number.
fn scalar(vertex: &Element, names: &[&str]) -> Option<usize> {
    vertex.find(names).filter(|&i| matches!(vertex.properties[i].kind, Kind::Scalar(_)))
}

fn find_fields(path: &Path, vertex: &Element) -> Result<Fields> {
    let scalar = |names: &[&str]| scalar(vertex, names);
    let xyz = match (scalar(&["x"]), scalar(&["y"]), scalar(&["z"])) {
        (Some(x), Some(y), Some(z)) => [x, y, z],
        _ => {
            let names: Vec<&str> = vertex.properties.iter().map(|p| p.name.as_str()).collect();
            let found = format!("vertex properties [{}]", names.join(", "));
            return Err(Error::file(
                path,
                found,
                "scalar properties x, y and z",
                "export the scan with coordinates",
            ));
        }
    };
    let rgb = match (
        scalar(&["red", "r", "diffuse_red"]),
        scalar(&["green", "g", "diffuse_green"]),
        scalar(&["blue", "b", "diffuse_blue"]),
    ) {
        (Some(r), Some(g), Some(b)) => Some([r, g, b]),
        _ => None,
    };
    Ok(Fields { xyz, rgb })
}

/// Fewer rows in the data than the header promises.
fn too_few(
    path: &Path,
    element: &Element,
    rows: usize,
    bytes_found: usize,
    bytes_needed: Option<usize>,
) -> Error {
    let mut found = format!("{rows} of {} complete {} rows", element.count, element.name);
    let mut expected = format!("{} rows as its header says", element.count);
    if let Some(needed) = bytes_needed {
        found = format!("{bytes_found} bytes with {found}");
        expected = format!("{needed} bytes with {expected}");
    }
    Error::file(path, found, expected, "copy or export the file again: it is cut short")
}

fn too_many(path: &Path, found: String, element: &Element) -> Error {
    let expected = format!("the end of the file after {} as its header says", counted(element.count, "row"));
    Error::file(path, found, expected, "correct the counts in the header or export the scan again")
}

fn read_binary(
    path: &Path,
    bytes: &[u8],
    header: &Header,
    vertex: usize,
    fields: &Fields,
    endian: Endian,
) -> Result<PointCloud> {
    let mut data = &bytes[header.data_start..];
    for element in &header.elements[..vertex] {
        data = skip_binary(path, data, element, endian, |_, _| {})?;
    }
    let element = &header.elements[vertex];
    let (cloud, rest) = match element.stride() {
        Some(stride) => {
            let needed = stride.checked_mul(element.count);
            let Some(rows) = needed.and_then(|n| data.get(..n)) else {
                let whole = data.len().checked_div(stride).unwrap_or(0);
                return Err(too_few(path, element, whole, data.len(), needed));
            };
            (read_fixed_rows(rows, element, stride, fields, endian), &data[rows.len()..])
        }
        None => read_list_rows(path, data, element, fields, endian)?,
    };
    // Some writers pad with zeros; anything else after the last element means that a count is wrong.
    if vertex + 1 == header.elements.len() && rest.len() > 16 && rest.iter().any(|&b| b != 0) {
        return Err(too_many(path, format!("{} bytes after the vertex rows", rest.len()), element));
    }
    Ok(cloud)
}

/// Vertex rows of equal length, decoded where they lie.
fn read_fixed_rows(
    rows: &[u8],
    element: &Element,
    stride: usize,
    fields: &Fields,
    endian: Endian,
) -> PointCloud {
    let place = |index: usize| {
        let offset: usize = element.properties[..index].iter().map(|p| scalar_of(p.kind).size()).sum();
        (scalar_of(element.properties[index].kind), offset)
    };
    let n = element.count;
    let xyz = fields.xyz.map(place);
    let rgb = fields.rgb.map(|f| f.map(place));
    let number = move |i: usize, (scalar, offset): (Scalar, usize)| {
        rows.get(i * stride + offset..).map_or(f64::NAN, |b| scalar.read(b, endian))
    };
    let colors = rgb.map(|rgb| {
        let values: Vec<[f64; 3]> = (0..n).map(|i| rgb.map(|p| number(i, p))).collect();
        colors_of(&values, rgb[0].0)
    });
    let color = colors.as_ref().map(|c| |i: usize| c[i]);
    let packed = xyz[1].1 == xyz[0].1 + 4 && xyz[2].1 == xyz[0].1 + 8;
    if endian == Endian::Little && packed && xyz.iter().all(|(s, _)| *s == Scalar::F32) {
        // The one layout worth its own loop: x y z floats side by side.
        let first = xyz[0].1;
        let at = |i: usize| {
            let row = &rows[i * stride + first..i * stride + first + 12];
            let float =
                |k: usize| f64::from(f32::from_le_bytes([row[k], row[k + 1], row[k + 2], row[k + 3]]));
            [float(0), float(4), float(8)]
        };
        return assemble(n, at, color, None);
    }
    assemble(n, |i| xyz.map(|p| number(i, p)), color, None)
}

fn scalar_of(kind: Kind) -> Scalar {
    match kind {
        Kind::Scalar(s) => s,
        Kind::List { item, .. } => item,
    }
}

fn colors_of(values: &[[f64; 3]], scalar: Scalar) -> Vec<[u8; 3]> {
    match scalar {
        Scalar::F32 | Scalar::F64 => channels_to_bytes(values),
        Scalar::U16 => values.iter().map(|c| c.map(|v| (v / 257.0).round() as u8)).collect(),
        _ => values.iter().map(|c| c.map(|v| v as u8)).collect(),
    }
}

/// Vertex rows whose length varies.
fn read_list_rows<'a>(
    path: &Path,
    data: &'a [u8],
    element: &Element,
    fields: &Fields,
    endian: Endian,
) -> Result<(PointCloud, &'a [u8])> {
    let mut table = Table::new(element, fields, data.len());
    let rest = skip_binary(path, data, element, endian, |property, value| table.set(property, value))?;
    Ok((table.into_cloud(element, fields), rest))
}

/// Walks over an element's rows, showing every scalar to `visit(property, value)`; returns what follows.
fn skip_binary<'a>(
    path: &Path,
    data: &'a [u8],
    element: &Element,
    endian: Endian,
    mut visit: impl FnMut(usize, f64),
) -> Result<&'a [u8]> {
    let mut at = 0usize;
    for row in 0..element.count {
        let short = || too_few(path, element, row, data.len(), None);
        for (index, property) in element.properties.iter().enumerate() {
            match property.kind {
                Kind::Scalar(s) => {
                    let bytes = data.get(at..at + s.size()).ok_or_else(short)?;
                    visit(index, s.read(bytes, endian));
                    at += s.size();
                }
                Kind::List { count, item } => {
                    let bytes = data.get(at..at + count.size()).ok_or_else(short)?;
                    let length = count.read(bytes, endian);
                    at += count.size();
                    // Compared as a number first: a negative or enormous length must not wrap around.
                    if !(length >= 0.0 && length * item.size() as f64 <= (data.len() - at) as f64) {
                        return Err(short());
                    }
                    at += length as usize * item.size();
                }
            }
        }
        if element.properties.is_empty() {
            break;
        }
    }
    Ok(&data[at..])
}

/// Coordinates and colours gathered value by value.
struct Table {
    /// For each property the column it goes to: 0..3 coordinates, 3..6 colours.
    columns: Vec<Vec<usize>>,
    row: [f64; 6],
    last: usize,
    xyz: Vec<[f64; 3]>,
    rgb: Vec<[f64; 3]>,
}

impl Table {
    /// `limit` bounds what a lying header can make us reserve.
    fn new(element: &Element, fields: &Fields, limit: usize) -> Self {
        let mut columns = vec![Vec::new(); element.properties.len()];
        let wanted: Vec<usize> = fields.xyz.into_iter().chain(fields.rgb.into_iter().flatten()).collect();
        for (column, &property) in wanted.iter().enumerate() {
            columns[property].push(column);
        }
        let last = wanted.iter().copied().max().unwrap_or(0);
        Self {
            columns,
            row: [0.0; 6],
            last,
            xyz: Vec::with_capacity(element.count.min(limit)),
            rgb: Vec::new(),
        }
    }

    fn set(&mut self, property: usize, value: f64) {
        for &column in &self.columns[property] {
            self.row[column] = value;
        }
        if property == self.last {
            let [x, y, z, r, g, b] = self.row;
            self.xyz.push([x, y, z]);
            self.rgb.push([r, g, b]);
        }
    }

    fn into_cloud(self, element: &Element, fields: &Fields) -> PointCloud {
        let xyz = |i: usize| self.xyz[i];
        match fields.rgb {
            Some([red, ..]) => {
                let colors = colors_of(&self.rgb, scalar_of(element.properties[red].kind));
                assemble(self.xyz.len(), xyz, Some(|i: usize| colors[i]), None)
            }
            None => assemble(self.xyz.len(), xyz, NO_COLORS, None),
        }
    }
}

fn read_ascii(
    path: &Path,
    bytes: &[u8],
    header: &Header,
    vertex: usize,
    fields: &Fields,
) -> Result<PointCloud> {
    let text = String::from_utf8_lossy(&bytes[header.data_start..]);
    let mut lines = text.split(['\n', '\r']).map(str::trim).filter(|l| !l.is_empty());
    for element in &header.elements[..vertex] {
        let rows = lines.by_ref().take(element.count).count();
        if rows < element.count {
            return Err(too_few(path, element, rows, 0, None));
        }
    }
    let element = &header.elements[vertex];
    let mut table = Table::new(element, fields, text.len());
    for row in 0..element.count {
        let line = lines.next().ok_or_else(|| too_few(path, element, row, 0, None))?;
        read_ascii_row(line, element, &mut table).ok_or_else(|| {
            let found = format!("vertex row {} '{}'", row + 1, line.chars().take(80).collect::<String>());
            let expected = format!(
                "numbers for its {}",
                counted(element.properties.len(), "property").replace("propertys", "properties")
            );
            Error::file(
                path,
                found,
                expected,
                "correct that row, or copy or export the file again if it is cut short",
            )
        })?;
    }
    if vertex + 1 == header.elements.len() {
        let more = lines.count();
        if more > 0 {
            return Err(too_many(path, format!("{} after the vertex rows", counted(more, "line")), element));
        }
    }
    Ok(table.into_cloud(element, fields))
}

fn read_ascii_row(line: &str, element: &Element, table: &mut Table) -> Option<()> {
    let mut words = line.split_ascii_whitespace();
    for (index, property) in element.properties.iter().enumerate() {
        let value = parse_number(words.next()?)?;
        match property.kind {
            Kind::Scalar(_) => table.set(index, value),
            Kind::List { .. } => {
                for _ in 0..value.max(0.0) as usize {
                    words.next()?;
                }
            }
        }
    }
    Some(())
}
