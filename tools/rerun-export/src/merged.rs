//! merged.ply: points with the scan that each comes from.

use anyhow::{Context, Result, bail, ensure};
use std::path::Path;

/// A merged cloud.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Merged {
    /// `[n,3]`, metres, in the frame of the component.
    pub points: Vec<[f64; 3]>,
    /// `[n]` index of the scan.
    pub scans: Vec<usize>,
}

/// Reads a binary little-endian PLY of vertices with x, y, z and `int scan`, in any order among
/// other properties of fixed length.
///
/// # Errors
/// A file that cannot be read or is no such PLY.
pub fn read_merged(path: &Path) -> Result<Merged> {
    let place = path.display();
    let bytes = std::fs::read(path).with_context(|| format!("{place}: cannot read it"))?;
    parse(&bytes).with_context(|| format!("{place}: no merged cloud of `scanweave register`"))
}

fn parse(bytes: &[u8]) -> Result<Merged> {
    const END: &[u8] = b"end_header\n";
    let head = bytes.windows(END.len()).position(|w| w == END).context("no end of the header")?;
    let header = std::str::from_utf8(&bytes[..head]).context("a header that is no text")?;
    ensure!(header.starts_with("ply\nformat binary_little_endian 1.0\n"), "not binary little-endian PLY");
    let (mut count, mut row) = (None, 0);
    let mut places: [Option<(usize, Number)>; 4] = [None; 4];
    for line in header.lines().skip(2).filter(|l| !l.starts_with("comment")) {
        match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["element", "vertex", n] if count.is_none() => count = Some(n.parse::<usize>()?),
            ["property", kind, name] if count.is_some() => {
                let number = Number::named(kind).with_context(|| format!("a property of type {kind}"))?;
                if let Some(at) = ["x", "y", "z", "scan"].iter().position(|n| *n == name) {
                    places[at] = Some((row, number));
                }
                row += number.size();
            }
            _ => bail!("a line '{line}' that merged clouds do not have"),
        }
    }
    let [Some(x), Some(y), Some(z), Some(scan)] = places else {
        bail!("vertices without x, y, z and scan");
    };
    let (count, data) = (count.unwrap_or(0), &bytes[head + END.len()..]);
    ensure!(Some(data.len()) == count.checked_mul(row), "{} bytes for {count} rows of {row}", data.len());
    let mut merged = Merged::default();
    for row in data.chunks_exact(row.max(1)) {
        let value = |(at, number): (usize, Number)| number.read(&row[at..]);
        let id = value(scan);
        ensure!(id >= 0.0 && id.fract() == 0.0, "a point of the scan {id}");
        merged.points.push([x, y, z].map(value));
        merged.scans.push(id as usize);
    }
    Ok(merged)
}

#[derive(Debug, Clone, Copy)]
enum Number {
    Byte,
    Int,
    Float,
    Double,
}

impl Number {
    fn named(kind: &str) -> Option<Self> {
        Some(match kind {
            "uchar" | "uint8" => Self::Byte,
            "int" | "int32" => Self::Int,
            "float" | "float32" => Self::Float,
            "double" | "float64" => Self::Double,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::Byte => 1,
            Self::Int | Self::Float => 4,
            Self::Double => 8,
        }
    }

    /// The number at the beginning of `bytes`, of which there are enough.
    fn read(self, bytes: &[u8]) -> f64 {
        let four = || [bytes[0], bytes[1], bytes[2], bytes[3]];
        match self {
            Self::Byte => f64::from(bytes[0]),
            Self::Int => f64::from(i32::from_le_bytes(four())),
            Self::Float => f64::from(f32::from_le_bytes(four())),
            Self::Double => {
                let [a, b, c, d] = four();
                f64::from_le_bytes([a, b, c, d, bytes[4], bytes[5], bytes[6], bytes[7]])
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(properties: &str, rows: &[&[u8]]) -> Vec<u8> {
        let header = format!(
            "ply\nformat binary_little_endian 1.0\ncomment lengths in metres\nelement vertex {}\n{properties}end_header\n",
            rows.len()
        );
        [header.as_bytes(), &rows.concat()].concat()
    }

    const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";

    fn row(xyz: [f32; 3], more: &[u8]) -> Vec<u8> {
        xyz.iter().flat_map(|v| v.to_le_bytes()).chain(more.iter().copied()).collect()
    }

    #[test]
    fn points_come_with_their_scans_with_colours_or_without() {
        let plain = file(&format!("{XYZ}property int scan\n"), &[&row([1.0, 2.0, 3.5], &[7, 0, 0, 0])]);
        let expected = Merged { points: vec![[1.0, 2.0, 3.5]], scans: vec![7] };
        assert_eq!(parse(&plain).unwrap(), expected);
        let rgb = "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty int scan\n";
        let coloured = file(&format!("{XYZ}{rgb}"), &[&row([1.0, 2.0, 3.5], &[9, 9, 9, 7, 0, 0, 0])]);
        assert_eq!(parse(&coloured).unwrap(), expected);
    }

    #[test]
    fn what_is_no_merged_cloud_is_refused() {
        let whole = file(&format!("{XYZ}property int scan\n"), &[&row([1.0, 2.0, 3.5], &[7, 0, 0, 0])]);
        assert!(parse(&whole[..whole.len() - 1]).is_err());
        assert!(parse(&whole[..20]).is_err());
        let negative = file(&format!("{XYZ}property int scan\n"), &[&row([1.0, 2.0, 3.5], &[255; 4])]);
        assert!(parse(&negative).is_err());
        assert!(parse(&file(XYZ, &[&row([1.0, 2.0, 3.5], &[])])).is_err());
        assert!(parse(&file(&format!("{XYZ}property list uchar int scan\n"), &[])).is_err());
    }
}
