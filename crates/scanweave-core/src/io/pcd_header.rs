//! The header of a PCD file, and where it says that coordinates and colours are.

use super::fields::{INTENSITY, NORMAL, RGB, three};
use super::scalar::{Scalar, parse_number};
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use std::path::Path;

#[derive(Debug, Clone)]
pub(super) struct Field {
    name: String,
    scalar: Scalar,
    pub count: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    Binary,
    Compressed,
}

pub(super) struct Header {
    pub fields: Vec<Field>,
    pub points: usize,
    /// Where it says that the sensor stood, unless all that it says is zero.
    pub viewpoint: Option<Sensor>,
    pub encoding: Encoding,
    /// Byte at which the data begin.
    pub data_start: usize,
}

/// What VIEWPOINT says of the sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sensor {
    pub translation: [f64; 3],
    /// The same with the rotation, where that is one.
    pub pose: Option<RigidMotion>,
}

/// Where the first value of a field is found.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub scalar: Scalar,
    /// Bytes between the values of neighbouring rows.
    pub step: usize,
    /// Byte of the first row's value.
    pub first: usize,
    /// Number of values before it in a row of text.
    pub column: usize,
}

/// How colour is stored.
#[derive(Clone, Copy)]
pub(super) enum Color<T> {
    /// One number with the bytes 0xAARRGGBB, as an integer or as the bits of a float.
    Packed(T),
    Channels([T; 3]),
}

/// Where all that is read stands.
pub(super) struct Places {
    pub xyz: [Place; 3],
    pub color: Option<Color<Place>>,
    pub intensity: Option<Place>,
    pub normal: Option<[Place; 3]>,
}

pub(super) const CUT_SHORT: &str = "copy or export the file again: it is cut short";

pub(super) fn parse_header(path: &Path, bytes: &[u8]) -> Result<Header> {
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
                    .map_err(|_| bad(format!("COUNT {word} of field {name}"), "a whole number"))?,
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
        let viewpoint = sensor(&self.viewpoint);
        Ok(Header { fields, points, viewpoint, encoding, data_start })
    }
}

/// Rotations whose quaternion is further than this from unit length are not written as rotations. Six
/// digits, as text files have them, are ten thousand times nearer.
const QUATERNION_TOLERANCE: f64 = 0.01;

/// The sensor of `tx ty tz qw qx qy qz`. At zero, which is also what writers say who do not know,
/// nothing is said.
fn sensor(words: &[String]) -> Option<Sensor> {
    let numbers: Vec<f64> = words.iter().map_while(|w| parse_number(w)).filter(|v| v.is_finite()).collect();
    let translation = *numbers.first_chunk::<3>()?;
    if translation == [0.0; 3] {
        return None;
    }
    let pose = numbers.get(3..).and_then(|q| q.first_chunk::<4>()).and_then(|&[w, x, y, z]| {
        let quaternion = Quaternion::new(w, x, y, z);
        let is_rotation = (quaternion.norm() - 1.0).abs() < QUATERNION_TOLERANCE;
        let rotation = is_rotation.then(|| UnitQuaternion::from_quaternion(quaternion))?;
        Some(RigidMotion::from_parts(Translation3::from(translation), rotation))
    });
    Some(Sensor { translation, pose })
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
    /// Settles what COUNT 0 means: one, as the Point Cloud Library reads it, unless the `data` have no
    /// room for it. Then it is padding of no width, as drivers of sensors write it.
    pub fn settle_counts_of_zero(&mut self, path: &Path, data: &[u8]) -> Result<()> {
        let mut ones = self.fields.clone();
        ones.iter_mut().for_each(|field| field.count = field.count.max(1));
        let written = std::mem::replace(&mut self.fields, ones);
        let needed = self.stride(path)?.checked_mul(self.points);
        if self.encoding == Encoding::Binary && needed.is_none_or(|needed| needed > data.len()) {
            self.fields = written;
        }
        Ok(())
    }

    /// Bytes of one row.
    pub fn stride(&self, path: &Path) -> Result<usize> {
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

    /// Finds coordinates, colours, intensities and normals; `columnar` when all values of a field lie
    /// together.
    pub fn places(&self, path: &Path, stride: usize, columnar: bool) -> Result<Places> {
        let find = |names: &[&str]| {
            let index = names
                .iter()
                .find_map(|n| self.fields.iter().position(|f| n.eq_ignore_ascii_case(&f.name)))?;
            let field = &self.fields[index];
            let before: usize = self.fields[..index].iter().map(|f| f.scalar.size() * f.count).sum();
            let column = self.fields[..index].iter().map(|f| f.count).sum();
            let (step, first) = if columnar {
                (field.scalar.size() * field.count, before.saturating_mul(self.points))
            } else {
                (stride, before)
            };
            Some(Place { scalar: field.scalar, step, first, column })
        };
        let Some(xyz) = three([&["x"], &["y"], &["z"]], find) else {
            let names: Vec<&str> = self.fields.iter().map(|f| f.name.as_str()).collect();
            let found = format!("fields [{}]", names.join(", "));
            return Err(Error::file(path, found, "fields x, y and z", "export the scan with coordinates"));
        };
        let packed = find(&["rgb", "rgba"]).filter(|p| p.scalar.size() == 4).map(Color::Packed);
        let color = packed.or_else(|| three(RGB, find).map(Color::Channels));
        Ok(Places { xyz, color, intensity: find(INTENSITY), normal: three(NORMAL, find) })
    }
}
