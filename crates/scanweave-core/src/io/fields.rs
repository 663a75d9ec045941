//! Names that writers give to the fields of a point, and what is said of fields that need care.

use super::scalar::Scalar;
use super::scan_file::{Note, ReadOptions};

/// Names of one field, the most common first.
pub(super) type Names = &'static [&'static str];

/// Red, green, blue.
pub(super) const RGB: [Names; 3] =
    [&["red", "r", "diffuse_red"], &["green", "g", "diffuse_green"], &["blue", "b", "diffuse_blue"]];
/// Strength of the return. CloudCompare puts `scalar_` before the names of its scalar fields.
pub(super) const INTENSITY: Names = &[
    "intensity",
    "scalar_intensity",
    "intensities",
    "reflectance",
    "scalar_reflectance",
    "scalar_intensities",
];
/// The normal's x, y, z.
pub(super) const NORMAL: [Names; 3] = [&["nx", "normal_x"], &["ny", "normal_y"], &["nz", "normal_z"]];

/// The places of three fields, where all of them are found.
pub(super) fn three<T>(names: [Names; 3], find: impl Fn(Names) -> Option<T>) -> Option<[T; 3]> {
    let [a, b, c] = names;
    Some([find(a)?, find(b)?, find(c)?])
}

/// What to say of coordinates that are whole numbers: scanners write millimetres so, and nothing in the
/// file tells. Their size is left out, as it differs between files that are read alike.
pub(super) fn whole_number_note(xyz: [Scalar; 3], options: &ReadOptions) -> Option<Note> {
    let whole = xyz.iter().all(|s| !matches!(s, Scalar::F16 | Scalar::F32 | Scalar::F64));
    let text =
        "the coordinates are whole numbers and taken as metres: if they are millimetres, pass --unit mm";
    (whole && options.unit_m.is_none()).then(|| Note::warning(text))
}
