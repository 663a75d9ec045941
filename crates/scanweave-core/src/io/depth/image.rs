//! Depth images as files hold them: 16-bit PNG and PGM.

use super::png_file;
use crate::error::{Error, Result};
use crate::files;
use crate::io::scan_file::ReadOptions;
use crate::io::unpack_limit::UnpackLimit;
use std::path::Path;

/// A depth image: distance along the optical axis, 0 and 65535 for no measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredDepth {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height·width]`, row-major.
    pub values: Vec<u16>,
}

/// The kinds of image that are told apart, the later of which cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Png,
    Pgm,
    Tiff,
    Exr,
    Pfm,
}

const EXPECTED: &str = "16-bit greyscale depth";

/// The kind of an image by its first bytes.
fn kind_of(bytes: &[u8]) -> Option<Kind> {
    let kinds: [(&[u8], Kind); 8] = [
        (b"\x89PNG", Kind::Png),
        (b"P5\n", Kind::Pgm),
        (b"P5\r", Kind::Pgm),
        (b"P5 ", Kind::Pgm),
        (b"II*\0", Kind::Tiff),
        (b"MM\0*", Kind::Tiff),
        (b"\x76\x2f\x31\x01", Kind::Exr),
        (b"Pf\n", Kind::Pfm),
    ];
    kinds.into_iter().find(|(magic, _)| bytes.starts_with(magic)).map(|(_, kind)| kind)
}

/// Whether a file is an image that may hold depth, by its first bytes.
pub(in crate::io) fn is_image(bytes: &[u8]) -> bool {
    kind_of(bytes).is_some()
}

/// Reads a 16-bit greyscale PNG or PGM.
///
/// # Errors
/// [`Error::Read`]; [`Error::NotAScan`] for another pixel type; [`Error::File`] for a damaged image or
/// a format that is not read.
pub fn read_depth_png(path: impl AsRef<Path>) -> Result<StoredDepth> {
    let path = path.as_ref();
    let bytes = files::read(path)?;
    let limit = UnpackLimit::of_scan(&ReadOptions::default(), bytes.len() as u64);
    decode(path, &bytes, limit)
}

/// [`read_depth_png`] of the file's bytes.
pub(super) fn decode(path: &Path, bytes: &[u8], limit: UnpackLimit) -> Result<StoredDepth> {
    let other = |found: &str| {
        let remedy =
            "convert it to a 16-bit greyscale PNG in millimetres, or in other whole units with --depth-scale";
        Error::file(path, found, "a depth image in PNG or PGM", remedy)
    };
    match kind_of(bytes) {
        Some(Kind::Png) => decode_png(path, bytes, limit),
        Some(Kind::Pgm) => decode_pgm(path, bytes),
        Some(Kind::Tiff) => Err(other("a TIFF image, which is not read")),
        Some(Kind::Exr) => Err(other("an OpenEXR image, which is not read")),
        Some(Kind::Pfm) => Err(other("a PFM image of floating-point numbers, which is not read")),
        None => Err(other("bytes of no known image format")),
    }
}

fn damaged(path: &Path, format: &str, why: &str) -> Error {
    let found = format!("a damaged {format} ({why})");
    Error::file(path, found, format!("a 16-bit greyscale {format}"), "copy or export the image again")
}

fn not_depth(path: &Path, found: String) -> Error {
    Error::not_a_scan(path, found, EXPECTED, "give the depth image, not the colour image, saved with 16 bits")
}

fn decode_png(path: &Path, bytes: &[u8], limit: UnpackLimit) -> Result<StoredDepth> {
    let bad = |why: String| damaged(path, "PNG", &why);
    if png_file::stated_bytes(bytes).map_err(bad)? > limit.bytes() {
        return Err(limit.exceeded(path, "pixels"));
    }
    let mut reader = png_file::open(bytes, png::Transformations::IDENTITY).map_err(bad)?;
    let (color, depth) = reader.output_color_type();
    if (color, depth) != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        let found = format!("a PNG of {color:?} pixels, {} bits a channel", depth as u8);
        return Err(not_depth(path, found));
    }
    let (width, height, pixels) = png_file::pixels(&mut reader).map_err(bad)?;
    Ok(StoredDepth { width, height, values: big_endian(&pixels) })
}

/// A binary PGM: `P5`, width, height, the largest value, one white space, then the rows. Values of two
/// bytes are big-endian.
/// <https://netpbm.sourceforge.net/doc/pgm.html>
fn decode_pgm(path: &Path, bytes: &[u8]) -> Result<StoredDepth> {
    let bad = |why: &str| damaged(path, "PGM", why);
    let mut at = 2;
    let mut number = || -> Option<usize> {
        loop {
            match bytes.get(at)? {
                b'#' => at += bytes.get(at..)?.iter().position(|b| *b == b'\n')?,
                b if b.is_ascii_whitespace() => at += 1,
                _ => break,
            }
        }
        let digits = bytes.get(at..)?.iter().take_while(|b| b.is_ascii_digit()).count();
        let value = std::str::from_utf8(bytes.get(at..at + digits)?).ok()?.parse().ok()?;
        at += digits;
        Some(value)
    };
    let header = (number(), number(), number());
    let (Some(width), Some(height), Some(largest)) = header else {
        return Err(bad("its header is not 'P5 width height maximum'"));
    };
    if largest <= 255 {
        return Err(not_depth(path, "a PGM of 8 bits a pixel".to_owned()));
    }
    let rows = bytes.get(at + 1..).unwrap_or_default();
    let size = width.checked_mul(height).and_then(|n| n.checked_mul(2)).filter(|n| *n <= rows.len());
    match size {
        Some(size) if size > 0 => Ok(StoredDepth { width, height, values: big_endian(&rows[..size]) }),
        _ => Err(bad(&format!("{} bytes for {width}x{height} pixels of two bytes", rows.len()))),
    }
}

fn big_endian(bytes: &[u8]) -> Vec<u16> {
    bytes.as_chunks::<2>().0.iter().map(|b| u16::from_be_bytes(*b)).collect()
}
