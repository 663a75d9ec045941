//! Which columns are read as what, and in which unit.

use super::head::Head;
use super::names::Name;
use crate::error::{Error, Result};
use crate::io::scalar::counted;
use crate::io::scan_file::{Note, ReadOptions};
use crate::printable::printable_start;
use std::path::Path;

/// The columns that are read, from zero.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Columns {
    /// Coordinates.
    pub xyz: [usize; 3],
    /// Metres in the unit of each coordinate.
    pub unit_m: [f64; 3],
    /// Whether the file or the user says the unit.
    pub unit_is_said: bool,
    /// Red, green, blue.
    pub rgb: Option<[usize; 3]>,
    /// Whether the colour is said to be one; else the values must look like one.
    pub rgb_is_said: bool,
    /// Strength of the return.
    pub intensity: Option<usize>,
    /// Normal.
    pub normal: Option<[usize; 3]>,
    /// Whether names or the user say what the columns are.
    pub said: bool,
    /// Columns named after an axis that were not taken.
    others: Vec<usize>,
}

/// Chooses the columns: as the user says, else as they are named, else by their places.
///
/// # Errors
/// [`Error::File`] where the user names a column that the rows do not have.
pub(super) fn choose(path: &Path, head: &Head, options: &ReadOptions) -> Result<Columns> {
    let mut columns = match (&options.columns, &head.meaning) {
        (Some(told), _) => {
            let from_zero = |three: [usize; 3]| three.map(|c| c.saturating_sub(1));
            Columns {
                rgb: told.rgb.map(from_zero),
                intensity: told.intensity.map(|c| c.saturating_sub(1)),
                ..Columns::plain(from_zero(told.xyz), true)
            }
        }
        (None, Some(meaning)) => Columns {
            rgb: meaning.rgb,
            intensity: meaning.intensity,
            normal: meaning.normal,
            others: meaning.others.clone(),
            ..Columns::plain(meaning.xyz, true)
        },
        (None, None) => unnamed(path, head),
    };
    if options.columns.is_some()
        && let Some(c) = columns.all().find(|&c| c >= head.width)
    {
        let found = format!("rows of {}", counted(head.width, "column"));
        let remedy = "correct --columns: columns are counted from 1";
        return Err(Error::file(path, found, format!("a column {} as --columns says", c + 1), remedy));
    }
    if !options.attributes {
        (columns.intensity, columns.normal) = (None, None);
    }
    let named = named_units(&head.names, columns.xyz);
    columns.unit_is_said = named.is_some() || options.unit_m.is_some();
    columns.unit_m = options.unit_m.map(|u| [u; 3]).or(named).unwrap_or([1.0; 3]);
    Ok(columns)
}

/// Columns by their places: x y z, a colour in the fourth to sixth, or after an intensity. The colour is
/// one only if its values look so.
fn unnamed(path: &Path, head: &Head) -> Columns {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let plain = Columns::plain([0, 1, 2], false);
    let pts = head.counted || extension == "pts";
    match (extension.as_str(), head.width) {
        ("xyzn", 6..) => Columns { normal: Some([3, 4, 5]), ..plain },
        ("xyzrgb", 6..) => Columns { rgb: Some([3, 4, 5]), rgb_is_said: true, ..plain },
        (_, 7) => Columns { rgb: Some([4, 5, 6]), intensity: Some(3), ..plain },
        (_, 6..) => Columns { rgb: Some([3, 4, 5]), ..plain },
        (_, 4) if pts => Columns { intensity: Some(3), ..plain },
        _ => plain,
    }
}

/// The units that names state. One unit that only some of them state holds for all.
fn named_units(names: &[Name], xyz: [usize; 3]) -> Option<[f64; 3]> {
    let units = xyz.map(|c| names.get(c).and_then(|n| n.unit_m));
    let any = units.iter().flatten().next().copied()?;
    Some(units.map(|unit| unit.unwrap_or(any)))
}

impl Columns {
    fn plain(xyz: [usize; 3], said: bool) -> Self {
        Self {
            xyz,
            unit_m: [1.0; 3],
            unit_is_said: false,
            rgb: None,
            rgb_is_said: said,
            intensity: None,
            normal: None,
            said,
            others: Vec::new(),
        }
    }

    fn all(&self) -> impl Iterator<Item = usize> {
        self.xyz.into_iter().chain(self.beside())
    }

    /// Columns beside the coordinates: colour, intensity, normal, in this order.
    pub(super) fn beside(&self) -> impl Iterator<Item = usize> + use<> {
        let rgb = self.rgb.into_iter().flatten();
        rgb.chain(self.intensity).chain(self.normal.into_iter().flatten())
    }

    /// What a user should know of the choice. `colored` says whether the colour turned out to be one.
    pub(super) fn notes(&self, head: &Head, options: &ReadOptions, colored: bool) -> Vec<Note> {
        let mut notes = Vec::new();
        if self.said || head.width > 3 {
            notes.push(Note::info(self.sentence(head, colored)));
        }
        let named = named_units(&head.names, self.xyz);
        if let (Some(unit), Some(named)) = (options.unit_m, named)
            && named != [unit; 3]
        {
            let named = in_unit(named);
            notes.push(Note::warning(format!(
                "the names of the columns say {named}, --unit says {}: the flag was followed",
                in_unit([unit; 3])
            )));
        }
        if head.doubtful_names && !self.said {
            notes.push(Note::warning(
                "a comment names x, y and z, but has another number of names than there are columns: \
                 columns 1 to 3 were read; if they are others, pass --columns x=…,y=…,z=…",
            ));
        }
        notes
    }

    fn sentence(&self, head: &Head, colored: bool) -> String {
        let name = |c: usize| match head.names.get(c) {
            Some(name) if !name.text.is_empty() => printable_start(&name.text, 40),
            _ => format!("column {}", c + 1),
        };
        let list = |columns: &[usize]| columns.iter().map(|&c| name(c)).collect::<Vec<_>>().join(", ");
        let [x, y, z] = self.xyz.map(name);
        let colour = self.rgb.filter(|_| colored).map_or("none".to_owned(), |rgb| list(&rgb));
        let mut text = format!("columns x: {x}, y: {y}, z: {z} {}; colour: {colour}", in_unit(self.unit_m));
        if let Some(intensity) = self.intensity {
            text.push_str(&format!("; intensity: {}", name(intensity)));
        }
        if let Some(normal) = self.normal {
            text.push_str(&format!("; normal: {}", list(&normal)));
        }
        if !self.others.is_empty() {
            let some = self.others.get(..3).unwrap_or(&self.others);
            text.push_str(&format!("; not taken: {}", list(some)));
        }
        text
    }
}

/// "in metres", "in mm", "in units of 0.3048 m".
fn in_unit(unit_m: [f64; 3]) -> String {
    let one = |unit: f64| match unit {
        1.0 => "metres".to_owned(),
        0.001 => "mm".to_owned(),
        0.01 => "cm".to_owned(),
        1000.0 => "km".to_owned(),
        unit => format!("units of {unit} m"),
    };
    let [x, y, z] = unit_m;
    if x == y && y == z { format!("in {}", one(x)) } else { format!("in {}, {}, {}", one(x), one(y), one(z)) }
}
