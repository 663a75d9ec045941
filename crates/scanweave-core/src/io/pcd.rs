//! PCD (Point Cloud Library): ASCII, binary and binary_compressed; organised clouds with NaN; colours.

use super::colors::channels_to_bytes;
use super::lzf;
use super::pcd_header::{CUT_SHORT, Color, Encoding, Header, Place, parse_header};
use super::scalar::{Endian, Scalar, counted, parse_number};
use crate::error::{Error, Result};
use crate::scan::PointCloud;
use crate::scan::assemble::{NO_COLORS, assemble};
use std::path::Path;

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
