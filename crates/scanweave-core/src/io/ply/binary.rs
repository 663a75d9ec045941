//! The data of a binary PLY file.
//!
//! Vertex rows of a fixed length, the usual case, are read in place. Anything else goes row by row.

use super::header::{Element, Header, Kind};
use super::{ColorRange, Fields, Table, scalar_of, too_few, too_many};
use crate::error::Result;
use crate::io::scalar::{Endian, Scalar};
use crate::io::scanner::without_zeros;
use crate::scan::PointCloud;
use crate::scan::assemble::{Attributes, assemble_with};
use std::path::Path;

pub(super) fn read(
    path: &Path,
    bytes: &[u8],
    header: &Header,
    vertex: usize,
    fields: &Fields,
    endian: Endian,
) -> Result<PointCloud> {
    let mut data = &bytes[header.data_start..];
    for element in &header.elements[..vertex] {
        data = walk(path, data, element, endian, None)?;
    }
    let element = &header.elements[vertex];
    let (cloud, rest) = match element.stride() {
        Some(stride) => {
            let needed = stride.checked_mul(element.count);
            let Some(rows) = needed.and_then(|n| data.get(..n)) else {
                let whole = data.len().checked_div(stride).unwrap_or(0);
                return Err(too_few(path, element, whole, Some((data.len(), needed))));
            };
            (fixed_rows(rows, element, stride, fields, endian), &data[rows.len()..])
        }
        None => {
            let mut table = Table::new(element, fields, data.len());
            let rest = walk(path, data, element, endian, Some(&mut table))?;
            (table.into_cloud(fields), rest)
        }
    };
    // Some writers pad with zeros; anything else after the last element means that a count is wrong.
    if vertex + 1 == header.elements.len() && rest.len() > 16 && rest.iter().any(|&b| b != 0) {
        return Err(too_many(path, format!("{} bytes after the vertex rows", rest.len()), element));
    }
    Ok(cloud)
}

/// Vertex rows of equal length, decoded where they lie.
pub(super) fn fixed_rows(
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
    let number = |i: usize, (scalar, offset): (Scalar, usize)| {
        rows.get(i * stride + offset..).map_or(f64::NAN, |b| scalar.read(b, endian))
    };
    let color = fields.rgb.map(|f| f.map(place)).map(|rgb| {
        let channels = move |i: usize| rgb.map(|p| number(i, p));
        // Where all are read for their range they are not kept: three doubles are more than a point.
        let range = ColorRange::of(fields.color, (0..n).map(channels));
        move |i: usize| range.bytes(channels(i))
    });
    let intensity = fields.intensity.map(place).map(|p| move |i: usize| number(i, p) as f32);
    let normal = fields.normal.map(|f| f.map(place));
    let normal = normal.map(|places| move |i: usize| places.map(|p| number(i, p) as f32));
    let attributes = Attributes {
        rgb: color.as_ref().map(|f| f as &dyn Fn(usize) -> [u8; 3]),
        intensity: intensity.as_ref().map(|f| f as &dyn Fn(usize) -> f32),
        normal: normal.as_ref().map(|f| f as &dyn Fn(usize) -> [f32; 3]),
    };
    let xyz = fields.xyz.map(place);
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
        return assembled(n, at, &attributes, fields);
    }
    assembled(n, |i| xyz.map(|p| number(i, p)), &attributes, fields)
}

fn assembled(
    rows: usize,
    xyz: impl Fn(usize) -> [f64; 3],
    attributes: &Attributes<'_>,
    fields: &Fields,
) -> PointCloud {
    match fields.drop_zeros {
        true => assemble_with(rows, without_zeros(rows, xyz), attributes, None),
        false => assemble_with(rows, xyz, attributes, None),
    }
}

/// Walks over an element's rows, and fills `table` where it is given; returns what follows.
fn walk<'a>(
    path: &Path,
    data: &'a [u8],
    element: &Element,
    endian: Endian,
    mut table: Option<&mut Table>,
) -> Result<&'a [u8]> {
    if element.properties.is_empty() {
        return Ok(data);
    }
    let mut at = 0usize;
    for row in 0..element.count {
        let short = || too_few(path, element, row, None);
        for (index, property) in element.properties.iter().enumerate() {
            match property.kind {
                Kind::Scalar(s) => {
                    let bytes = data.get(at..at + s.size()).ok_or_else(short)?;
                    if let Some(table) = table.as_mut() {
                        table.set(index, s.read(bytes, endian));
                    }
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
        if let Some(table) = table.as_mut() {
            table.end_row();
        }
    }
    Ok(&data[at..])
}
