//! What a file of scans holds, and how it is to be read.

use super::text_columns::TextColumns;
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::scan::PointCloud;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What the user says about files that do not say it themselves.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct ReadOptions {
    /// Which columns of a text file hold what, in place of its line of names: `x=3,y=4,z=5`, counted
    /// from 1, with `r=`, `g=`, `b=` and `i=` (intensity) where wanted.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<String>")]
    pub columns: Option<TextColumns>,
    /// Length of one unit of the coordinates in metres, where it is not one metre (or what the file says).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit_m: Option<f64>,
    /// Units of a depth image in a metre, where the images do not tell.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_units_per_m: Option<f64>,
    /// File of the intrinsics of depth images, where none lies beside them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub intrinsics: Option<PathBuf>,
    /// Most MiB that a packed file or image may unpack to. Not given: 64 MiB and 100 times the size of the
    /// file up to 4 GiB, or 20 times its size where that is more.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unpack_limit_mib: Option<u64>,
    /// Whether intensities and normals are read, which registration does not need.
    #[serde(skip)]
    pub attributes: bool,
}

impl ReadOptions {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`Error::Setting`] naming the key.
    pub fn validate(&self) -> Result<()> {
        let positive = |key: &str, value: Option<f64>| match value {
            Some(v) if !(v > 0.0 && v.is_finite()) => {
                Err(Error::setting(key, v.to_string(), "a positive number", "correct it or leave it out"))
            }
            _ => Ok(()),
        };
        if self.unpack_limit_mib == Some(0) {
            let remedy = "correct it or leave it out";
            return Err(Error::setting(
                "input.unpack_limit_mib",
                "0",
                "a whole number of MiB from 1",
                remedy,
            ));
        }
        positive("input.unit_m", self.unit_m)?;
        positive("input.depth_units_per_m", self.depth_units_per_m)
    }
}

/// Metres in a unit of length by its name or sign; `None` for a word that is none.
pub fn unit_m(word: &str) -> Option<f64> {
    Some(match word.to_ascii_lowercase().as_str() {
        "mm" | "millimetre" | "millimetres" | "millimeter" | "millimeters" => 1e-3,
        "cm" | "centimetre" | "centimetres" | "centimeter" | "centimeters" => 1e-2,
        "m" | "metre" | "metres" | "meter" | "meters" => 1.0,
        "km" | "kilometre" | "kilometres" | "kilometer" | "kilometers" => 1e3,
        "in" | "inch" | "inches" => 0.0254,
        "ft" | "foot" | "feet" => 0.3048,
        // The survey foot of the United States: 1200/3937 m.
        "us-ft" | "usft" | "us_ft" | "ftus" => 1200.0 / 3937.0,
        _ => return None,
    })
}

/// The scans of one file.
#[derive(Debug, Clone, Default)]
pub struct ScanFile {
    /// In the order of the file; at least one.
    pub scans: Vec<StoredScan>,
    /// What a user should know of how it was read.
    pub notes: Vec<Note>,
}

/// One scan of a file.
#[derive(Debug, Clone, Default)]
pub struct StoredScan {
    /// Its points, in the coordinates in which the file stores them.
    pub cloud: PointCloud,
    /// `world_from_scan` that the file states, where its format has a place for it.
    pub pose: Option<RigidMotion>,
}

/// A sentence about how a file was read.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Note {
    /// Whether something may be wrong, and is not only worth knowing.
    pub warning: bool,
    /// The sentence, without the name of the file: the same for files that are read alike.
    pub text: String,
}

impl Note {
    /// Something worth knowing, such as which columns are taken for what.
    pub fn info(text: impl Into<String>) -> Self {
        Self { warning: false, text: text.into() }
    }

    /// Something that may be wrong.
    pub fn warning(text: impl Into<String>) -> Self {
        Self { warning: true, text: text.into() }
    }
}

impl ScanFile {
    /// A file of several scans.
    pub(super) fn of(scans: Vec<StoredScan>) -> Self {
        Self { scans, notes: Vec::new() }
    }

    /// The same with one more note.
    pub(super) fn with(mut self, note: Note) -> Self {
        self.notes.push(note);
        self
    }
}

impl From<PointCloud> for ScanFile {
    fn from(cloud: PointCloud) -> Self {
        Self::of(vec![StoredScan { cloud, ..StoredScan::default() }])
    }
}
