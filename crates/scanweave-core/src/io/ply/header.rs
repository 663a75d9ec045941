//! The header of a PLY file.

use crate::error::{Error, Result};
use crate::io::scalar::{Endian, Scalar};
use std::path::Path;

/// How the numbers after the header are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    Binary(Endian),
}

/// What a property holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Debug, Clone)]
pub(super) struct Property {
    pub name: String,
    pub kind: Kind,
}

#[derive(Debug, Clone)]
pub(super) struct Element {
    pub name: String,
    pub count: usize,
    pub properties: Vec<Property>,
}

impl Element {
    /// Bytes of one row, `None` when a list makes it vary.
    pub(super) fn stride(&self) -> Option<usize> {
        self.properties.iter().try_fold(0usize, |sum, p| match p.kind {
            Kind::Scalar(s) => sum.checked_add(s.size()),
            Kind::List { .. } => None,
        })
    }

    /// Index of the first property with one of these names.
    pub(super) fn find(&self, names: &[&str]) -> Option<usize> {
        names.iter().find_map(|n| self.properties.iter().position(|p| p.name.eq_ignore_ascii_case(n)))
    }
}

#[derive(Debug, Clone)]
pub(super) struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// First byte after the header.
    pub data_start: usize,
}

/// A header longer than this has lost its `end_header`.
const HEADER_LIMIT_BYTES: usize = 1 << 20;
const REMEDY: &str = "export the scan again as PLY";

/// Reads the header. Lines with keywords this reader does not need (`comment`, `obj_info`, …) are passed over.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Header> {
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut at = 0;
    let mut number = 0;
    loop {
        let (line, next) = take_line(&bytes[..bytes.len().min(HEADER_LIMIT_BYTES)], at).ok_or_else(|| {
            let found = format!("a PLY header of {number} lines without end_header");
            Error::file(
                path,
                found,
                "a line end_header before the data",
                "copy or export the file again: it is cut short",
            )
        })?;
        at = next;
        number += 1;
        // Comments may be in any encoding; keywords are ASCII.
        let line = String::from_utf8_lossy(line);
        let mut words = line.split_ascii_whitespace();
        let bad = |expected: &str| {
            let found =
                format!("header line {number} '{}'", line.trim().chars().take(80).collect::<String>());
            Error::file(path, found, expected, REMEDY)
        };
        match words.next() {
            Some("format") => {
                encoding = Some(
                    parse_format(words.next())
                        .ok_or_else(|| bad("format ascii, binary_little_endian or binary_big_endian"))?,
                )
            }
            Some("element") => {
                let (name, count) = (words.next(), words.next().and_then(|w| w.parse().ok()));
                let (Some(name), Some(count)) = (name, count) else {
                    return Err(bad("'element NAME COUNT' with a count that is not negative"));
                };
                elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
            }
            Some("property") => {
                let property = parse_property(&mut words)
                    .ok_or_else(|| bad("'property TYPE NAME' or 'property list TYPE TYPE NAME'"))?;
                let element = elements.last_mut().ok_or_else(|| bad("an element line before it"))?;
                element.properties.push(property);
            }
            Some("end_header") => break,
            _ => {}
        }
    }
    let encoding = encoding.ok_or_else(|| {
        Error::file(
            path,
            "a PLY header without a format line",
            "format ascii, binary_little_endian or binary_big_endian",
            REMEDY,
        )
    })?;
    Ok(Header { encoding, elements, data_start: at })
}

/// The line at `start` without its end, and where the next begins.
///
/// A line ends with LF, CR LF, or a CR alone; `None` when no end follows.
fn take_line(bytes: &[u8], start: usize) -> Option<(&[u8], usize)> {
    let rest = bytes.get(start..)?;
    let end = rest.iter().position(|b| matches!(b, b'\n' | b'\r'))?;
    // After `end_header` CR, an LF belongs to the line end only if the file's lines end so. The first
    // line tells: binary data of a CR-only file may begin with the byte 10.
    let crlf = rest[end] == b'\r' && rest.get(end + 1) == Some(&b'\n') && !cr_only(bytes);
    Some((&rest[..end], start + end + if crlf { 2 } else { 1 }))
}

/// True when the first line ends with a CR that no LF follows.
fn cr_only(bytes: &[u8]) -> bool {
    let first = bytes.iter().position(|b| matches!(b, b'\n' | b'\r'));
    first.is_some_and(|i| bytes[i] == b'\r' && bytes.get(i + 1) != Some(&b'\n'))
}

fn parse_format(word: Option<&str>) -> Option<Encoding> {
    match word? {
        "ascii" => Some(Encoding::Ascii),
        "binary_little_endian" => Some(Encoding::Binary(Endian::Little)),
        "binary_big_endian" => Some(Encoding::Binary(Endian::Big)),
        _ => None,
    }
}

fn parse_property<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<Property> {
    let first = words.next()?;
    let kind = if first == "list" {
        Kind::List { count: parse_scalar(words.next()?)?, item: parse_scalar(words.next()?)? }
    } else {
        Kind::Scalar(parse_scalar(first)?)
    };
    Some(Property { name: words.next()?.to_owned(), kind })
}

fn parse_scalar(word: &str) -> Option<Scalar> {
    Some(match word {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "int64" | "long" => Scalar::I64,
        "uint64" | "ulong" => Scalar::U64,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}
