//! PCD (Point Cloud Library): ASCII, binary and binary_compressed; organised clouds with NaN; colours.

use super::assemble::{NO_COLORS, assemble, channels_to_bytes};
use super::lzf;
use super::scalar::{Endian, Scalar, counted, parse_number};
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use std::path::Path;

#[derive(Debug, Clone)]
struct Field {
    name: String,
    scalar: Scalar,
    count: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Ascii,
    Binary,
    Compressed,
}

struct Header {
    fields: Vec<Field>,
    points: usize,
    viewpoint: Option<[f64; 3]>,
    encoding: Encoding,
    data_start: usize,
}

/// Where the first value of a field is found.
#[derive(Debug, Clone, Copy)]
struct Place {
    scalar: Scalar,
    /// Bytes between the values of neighbouring rows.
    step: usize,
    /// Byte of the first row's value.
    first: usize,
    /// Number of values before it in a row of text.
    column: usize,
}

/// How colour is stored.
#[derive(Clone, Copy)]
enum Color<T> {
    /// One number with the bytes 0xAARRGGBB, as an integer or as the bits of a float.
    Packed(T),
    Channels([T; 3]),
}

const CUT_SHORT: &str = "copy or export the file again: it is cut short";

/// Reads the points (and colours, where there are any) of a PCD file's `bytes`.
///
/// # Errors
/// [`Error::File`] when the header cannot be used or disagrees with the data.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<PointCloud> {
    let header = parse_header(path, bytes)?;
    let data = &bytes[header.data_start..];
    match header.encoding {
        Encoding::Ascii => read_ascii(path, data, &header),
        Encoding::Binary => read_rows(path, data, &header),
        Encoding::Compressed => {
            let columns = decompress(path, data)?;
            read_columns(path, &columns, &header)
        }
    }
}

fn parse_header(path: &Path, bytes: &[u8]) -> Result<Header> {
    let mut lines = HeaderLines::default();
    let mut at = 0;
    let encoding = loop {
        let Some(length) = bytes.get(at..).and_then(|rest| rest.iter().position(|&b| b == b'\n')) else {
            return Err(Error::file(
                path,
                "a PCD header without a DATA line",
                "a line DATA before the data",
                CUT_SHORT,
            ));
        };
        let line = String::from_utf8_lossy(&bytes[at..at + length]).into_owned();
        at += length + 1;
        let mut words = line.split('#').next().unwrap_or("").split_ascii_whitespace().map(str::to_owned);
        let Some(keyword) = words.next() else { continue };
        let values: Vec<String> = words.collect();
        match keyword.to_ascii_uppercase().as_str() {
            "FIELDS" | "COLUMNS" => lines.fields = values,
            "SIZE" => lines.size = values,
            "TYPE" => lines.kind = values,
            "COUNT" => lines.count = values,
            "WIDTH" => lines.width = values,
            "HEIGHT" => lines.height = values,
            "POINTS" => lines.points = values,
            "VIEWPOINT" => lines.viewpoint = values,
            "DATA" => {
                break match values.first().map(String::as_str) {
                    Some("ascii") => Encoding::Ascii,
                    Some("binary") => Encoding::Binary,
                    Some("binary_compressed") => Encoding::Compressed,
                    other => {
                        let found = format!("DATA {}", other.unwrap_or(""));
                        let expected = "DATA ascii, binary or binary_compressed";
                        return Err(Error::file(path, found, expected, "export the scan again as PCD"));
                    }
                };
            }
            _ => {}
        }
    };
    lines.into_header(path, encoding, at)
}

/// The header's entries as text.
#[derive(Default)]
struct HeaderLines {
    fields: Vec<String>,
    size: Vec<String>,
    kind: Vec<String>,
    count: Vec<String>,
    width: Vec<String>,
    height: Vec<String>,
    points: Vec<String>,
    viewpoint: Vec<String>,
}

impl HeaderLines {
    fn into_header(self, path: &Path, encoding: Encoding, data_start: usize) -> Result<Header> {
        let bad = |found: String, expected: &str| {
            Error::file(path, found, expected, "correct the PCD header or export the scan again")
        };
        let n = self.fields.len();
        if n == 0
            || self.size.len() != n
            || self.kind.len() != n
            || !(self.count.is_empty() || self.count.len() == n)
        {
            let lengths = [n, self.size.len(), self.kind.len(), self.count.len()];
            return Err(bad(
                format!("FIELDS, SIZE, TYPE and COUNT with {lengths:?} entries"),
                "one SIZE, TYPE and COUNT for every field",
            ));
        }
        let mut fields = Vec::with_capacity(n);
        for (i, name) in self.fields.iter().enumerate() {
            let scalar = scalar(&self.kind[i], &self.size[i]).ok_or_else(|| {
                bad(
                    format!("field {name} of TYPE {} and SIZE {}", self.kind[i], self.size[i]),
                    "I, U or F of size 1, 2, 4 or 8",
                )
            })?;
            let count = match self.count.get(i) {
                None => 1,
                Some(word) => word
                    .parse::<usize>()
                    .map_err(|_| bad(format!("COUNT {word} of field {name}"), "a whole number"))?
                    // PCL itself reads COUNT 0 as 1.
                    .max(1),
            };
            fields.push(Field { name: name.clone(), scalar, count });
        }
        let number = |words: &[String]| words.first().and_then(|w| w.parse::<usize>().ok());
        let grid = number(&self.width).and_then(|w| w.checked_mul(number(&self.height).unwrap_or(1)));
        // Some writers fill in only one of the two; where both are there POINTS is what PCL allocates for.
        let points = number(&self.points).or(grid).ok_or_else(|| {
            let found = format!(
                "POINTS {} WIDTH {} HEIGHT {}",
                self.points.join(" "),
                self.width.join(" "),
                self.height.join(" ")
            );
            bad(found, "the number of points as POINTS, or as WIDTH and HEIGHT")
        })?;
        let translation: Vec<f64> = self.viewpoint.iter().take(3).filter_map(|w| parse_number(w)).collect();
        let viewpoint = <[f64; 3]>::try_from(translation).ok().filter(|t| t.iter().any(|&c| c != 0.0));
        Ok(Header { fields, points, viewpoint, encoding, data_start })
    }
}

fn scalar(kind: &str, size: &str) -> Option<Scalar> {
    Some(match (kind, size) {
        ("I", "1") => Scalar::I8,
        ("U", "1") => Scalar::U8,
        ("I", "2") => Scalar::I16,
        ("U", "2") => Scalar::U16,
        ("I", "4") => Scalar::I32,
        ("U", "4") => Scalar::U32,
        ("F", "4") => Scalar::F32,
        ("I", "8") => Scalar::I64,
        ("U", "8") => Scalar::U64,
        ("F", "8") => Scalar::F64,
        _ => return None,
    })
}

impl Header {
    /// Bytes of one row.
    fn stride(&self, path: &Path) -> Result<usize> {
        let sum = self
            .fields
            .iter()
            .try_fold(0usize, |sum, f| sum.checked_add(f.scalar.size().checked_mul(f.count)?));
        sum.ok_or_else(|| {
            Error::file(
                path,
                "a row too long to address",
                "a sensible COUNT for every field",
                "correct the PCD header",
            )
        })
    }

    /// Finds coordinates and colours; `columnar` when all values of a field lie together.
    fn places(
        &self,
        path: &Path,
        stride: usize,
        columnar: bool,
    ) -> Result<([Place; 3], Option<Color<Place>>)> {
        let find = |names: &[&str]| {
            let index =
                self.fields.iter().position(|f| names.iter().any(|n| f.name.eq_ignore_ascii_case(n)))?;
            let field = &self.fields[index];
            let before: usize = self.fields[..index].iter().map(|f| f.scalar.size() * f.count).sum();
            let column = self.fields[..index].iter().map(|f| f.count).sum();
            let (step, first) = if columnar {
                (field.scalar.size() * field.count, before * self.points)
            } else {
                (stride, before)
            };
            Some(Place { scalar: field.scalar, step, first, column })
        };
        let (Some(x), Some(y), Some(z)) = (find(&["x"]), find(&["y"]), find(&["z"])) else {
            let names: Vec<&str> = self.fields.iter().map(|f| f.name.as_str()).collect();
            let found = format!("fields [{}]", names.join(", "));
            return Err(Error::file(path, found, "fields x, y and z", "export the scan with coordinates"));
        };
        let channels =
            || Some(Color::Channels([find(&["r", "red"])?, find(&["g", "green"])?, find(&["b", "blue"])?]));
        let packed = find(&["rgb", "rgba"]).filter(|p| p.scalar.size() == 4).map(Color::Packed);
        Ok(([x, y, z], packed.or_else(channels)))
    }
}

fn unpack(bits: u32) -> [u8; 3] {
    let [_, r, g, b] = bits.to_be_bytes();
    [r, g, b]
}

fn short(path: &Path, header: &Header, stride: usize, found: usize) -> Error {
    let rows = found.checked_div(stride).unwrap_or(0);
    let needed = stride.checked_mul(header.points).map_or_else(|| "more".to_owned(), |n| n.to_string());
    Error::file(
        path,
        format!("{found} bytes of data with {rows} complete points"),
        format!("{needed} bytes with {} as its header says", counted(header.points, "point")),
        CUT_SHORT,
    )
}

fn read_rows(path: &Path, data: &[u8], header: &Header) -> Result<PointCloud> {
    let stride = header.stride(path)?;
    let needed = stride.checked_mul(header.points).filter(|&n| n <= data.len());
    let Some(needed) = needed else { return Err(short(path, header, stride, data.len())) };
    // Padding with zeros up to a page is common; other bytes mean that the count is wrong.
    let rest = &data[needed..];
    if rest.len() >= stride.max(17) && rest.iter().any(|&b| b != 0) {
        return Err(Error::file(
            path,
            format!("{} bytes of data with {} complete points", data.len(), data.len() / stride.max(1)),
            format!("{needed} bytes with {} as its header says", counted(header.points, "point")),
            "correct POINTS, WIDTH and HEIGHT in the header or export the scan again",
        ));
    }
    let (xyz, color) = header.places(path, stride, false)?;
    Ok(decode(data, header, xyz, color))
}

fn read_columns(path: &Path, columns: &[u8], header: &Header) -> Result<PointCloud> {
    let stride = header.stride(path)?;
    if stride.checked_mul(header.points) != Some(columns.len()) {
        return Err(short(path, header, stride, columns.len()));
    }
    let (xyz, color) = header.places(path, stride, true)?;
    Ok(decode(columns, header, xyz, color))
}

/// Values at their places in memory; the caller has checked the length.
fn decode(data: &[u8], header: &Header, xyz: [Place; 3], color: Option<Color<Place>>) -> PointCloud {
    let n = header.points;
    let bytes = |i: usize, p: Place| data.get(p.first + i * p.step..).unwrap_or(&[]);
    let number = |i: usize, p: Place| p.scalar.read(bytes(i, p), Endian::Little);
    let at = |i: usize| xyz.map(|p| number(i, p));
    match color {
        None => assemble(n, at, NO_COLORS, header.viewpoint),
        Some(Color::Packed(p)) => {
            // Read as bits: a float whose alpha byte is 255 is NaN as a number.
            let rgb = |i: usize| unpack(bytes(i, p).first_chunk().map_or(0, |b| u32::from_le_bytes(*b)));
            assemble(n, at, Some(rgb), header.viewpoint)
        }
        Some(Color::Channels(c)) => {
            let values: Vec<[f64; 3]> = (0..n).map(|i| c.map(|p| number(i, p))).collect();
            let colors = channels_of(&values, c[0].scalar);
            assemble(n, at, Some(|i: usize| colors[i]), header.viewpoint)
        }
    }
}

fn channels_of(values: &[[f64; 3]], scalar: Scalar) -> Vec<[u8; 3]> {
    match scalar {
        Scalar::U8 => values.iter().map(|c| c.map(|v| v as u8)).collect(),
        _ => channels_to_bytes(values),
    }
}

/// The columns of a binary_compressed body: compressed length, plain length, LZF stream.
fn decompress(path: &Path, data: &[u8]) -> Result<Vec<u8>> {
    let length = |at: usize| {
        let bytes = data.get(at..at + 4)?.first_chunk().copied()?;
        Some(u32::from_le_bytes(bytes) as usize)
    };
    let (Some(packed), Some(plain)) = (length(0), length(4)) else {
        return Err(Error::file(
            path,
            format!("{} bytes of data", data.len()),
            "two lengths before the compressed data",
            CUT_SHORT,
        ));
    };
    let Some(stream) = data.get(8..).and_then(|d| d.get(..packed)) else {
        return Err(Error::file(
            path,
            format!("{} bytes of compressed data", data.len() - 8),
            format!("{packed} bytes as its header says"),
            CUT_SHORT,
        ));
    };
    lzf::decompress(stream, plain).map_err(|got| {
        let expected = format!("{plain} bytes as its header says");
        Error::file(
            path,
            format!("damaged compressed data after {got} bytes"),
            expected,
            "copy or export the file again",
        )
    })
}

fn read_ascii(path: &Path, data: &[u8], header: &Header) -> Result<PointCloud> {
    let (xyz, color) = header.places(path, header.stride(path)?, false)?;
    let text = String::from_utf8_lossy(data);
    let mut lines = text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with('#'));
    let mut rows: Vec<[f64; 3]> = Vec::with_capacity(header.points.min(data.len()));
    let mut values: Vec<[f64; 3]> = Vec::new();
    let mut colors: Vec<[u8; 3]> = Vec::new();
    for row in 0..header.points {
        let Some(line) = lines.next() else {
            let expected = format!("{} rows as its header says", header.points);
            return Err(Error::file(path, format!("{row} rows"), expected, CUT_SHORT));
        };
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let number = |p: Place| words.get(p.column).and_then(|w| parse_number(w));
        let bad = || {
            let found = format!("row {} '{}'", row + 1, line.chars().take(80).collect::<String>());
            let columns: usize = header.fields.iter().map(|f| f.count).sum();
            Error::file(
                path,
                found,
                counted(columns, "number"),
                "correct that row, or export the file again if it is cut short",
            )
        };
        let three = |p: [Place; 3]| Some([number(p[0])?, number(p[1])?, number(p[2])?]);
        rows.push(three(xyz).ok_or_else(bad)?);
        match color {
            None => {}
            Some(Color::Packed(p)) => {
                let word = words.get(p.column).ok_or_else(bad)?;
                colors.push(unpack(packed_bits(word, p.scalar).ok_or_else(bad)?));
            }
            Some(Color::Channels(c)) => values.push(three(c).ok_or_else(bad)?),
        }
    }
    let more = lines.count();
    if more > 0 {
        let expected = format!("{} rows as its header says", header.points);
        let remedy = "correct POINTS, WIDTH and HEIGHT in the header or export the scan again";
        return Err(Error::file(path, format!("{} rows", header.points + more), expected, remedy));
    }
    if let Some(Color::Channels(c)) = color {
        colors = channels_of(&values, c[0].scalar);
    }
    let rgb = color.map(|_| |i: usize| colors[i]);
    Ok(assemble(rows.len(), |i| rows[i], rgb, header.viewpoint))
}

/// The bits of a packed colour written as text: of the float, or of the integer.
fn packed_bits(word: &str, scalar: Scalar) -> Option<u32> {
    match scalar {
        // A float with alpha 255 is written as nan and its colour is lost: black.
        Scalar::F32 => word.parse::<f32>().ok().map(|v| if v.is_nan() { 0 } else { v.to_bits() }),
        _ => word.parse::<i64>().ok().map(|v| v as u32),
    }
}
