//! What the names of columns mean: coordinates, their unit, colours, intensity, normals.
//!
//! A name is cut into words in lower case: `Points_m_XYZ:0` is points, m, xyz, 0. One word tells the axis, a
//! word may be a unit, and all others must be words for a position. So `Ori_x` and `vel x` are no coordinates.

use super::super::scan_file::unit_m;

/// Words that may stand beside the axis in the name of a coordinate.
const POSITION: [&str; 26] = [
    "coord",
    "coords",
    "coordinate",
    "coordinates",
    "pos",
    "position",
    "positions",
    "point",
    "points",
    "pt",
    "cartesian",
    "cart",
    "loc",
    "location",
    "xyz",
    "local",
    "global",
    "world",
    "lidar",
    "laser",
    "scan",
    "scanner",
    "sensor",
    "utm",
    "axis",
    "field",
];
/// Names of the axes in maps.
const MAP: [&[&str]; 3] = [
    &["easting", "east", "e", "rechtswert", "ostwert"],
    &["northing", "north", "n", "hochwert", "nordwert"],
    &["height", "elevation", "elev", "altitude", "alt", "h", "hoehe", "höhe"],
];
/// Words for the strength of a return, the plainest first.
const INTENSITY: [&str; 8] = [
    "intensity",
    "intensities",
    "reflectance",
    "reflectivity",
    "signal photons",
    "amplitude",
    "remission",
    "rssi",
];
const COLOR: [&str; 7] = ["color", "colour", "colors", "rgb", "diffuse", "vertex", "point"];
const NORMAL: [&str; 3] = ["normal", "normals", "n"];
const ROTATION: [&str; 7] = ["q", "quat", "quaternion", "orientation", "rotation", "rot", "pose"];

/// The name of one column.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Name {
    /// As the file writes it, without quotation marks.
    pub text: String,
    /// Metres in the unit that it states.
    pub unit_m: Option<f64>,
    words: Vec<String>,
}

impl Name {
    /// From the field of a line of names.
    pub(super) fn new(field: &str) -> Self {
        let text = field.trim_matches(|c: char| c.is_whitespace() || matches!(c, '"' | '\'' | '/' | '#'));
        let mut lower = text.to_lowercase();
        let mut unit = None;
        if let Some((before, bracket)) = lower.split_once(['[', '(']) {
            let inner = bracket.trim_end_matches([']', ')', ' ']).trim_start_matches("in ");
            if let Some(metres) = unit_m(inner.trim()) {
                unit = Some(metres);
                lower = before.to_owned();
            }
        }
        let mut words: Vec<String> = lower
            .split(|c: char| !c.is_alphanumeric())
            .filter(|w| !w.is_empty())
            .map(str::to_owned)
            .collect();
        // A first word is never a unit: `m` alone is a name. "in" as a word is not an inch.
        let found = words.iter().skip(1).position(|w| matches!(w.as_str(), "mm" | "cm" | "m" | "km" | "ft"));
        if let (Some(at), None) = (found, unit) {
            unit = unit_m(&words.remove(at + 1));
        }
        Self { text: text.to_owned(), unit_m: unit, words }
    }

    fn is(&self, word: &str) -> bool {
        self.words.len() == 1 && self.words[0] == word
    }

    /// The only word that is none of `others`, if it is one of `wanted`: its place there.
    fn one_of(&self, wanted: &[&str], others: &[&str]) -> Option<usize> {
        let mut rest = self.words.iter().filter(|w| !others.contains(&w.as_str()));
        match (rest.next(), rest.next()) {
            (Some(word), None) => wanted.iter().position(|w| w == word),
            _ => None,
        }
    }

    /// As [`one_of`](Self::one_of), with one of `others` beside it or joined to it: `pos x`, `posx`, `xpos`.
    fn joined(&self, wanted: &[&str], others: &[&str]) -> Option<usize> {
        if self.words.len() > 1 {
            return self.one_of(wanted, others);
        }
        let word = self.words.first()?;
        wanted.iter().position(|w| {
            let other = word.strip_suffix(w).filter(|o| others.contains(o));
            other.or_else(|| word.strip_prefix(w).filter(|o| others.contains(o))).is_some()
        })
    }

    /// The axis that a coordinate is of, with the rest of its name: columns of one point share it.
    fn axis(&self) -> Option<(usize, Family)> {
        const AXES: [&str; 3] = ["x", "y", "z"];
        if let Some(axis) = AXES.iter().position(|a| self.is(a)) {
            return Some((axis, Family::Plain));
        }
        let beside = || {
            let rest = self.words.iter().filter(|w| !AXES.contains(&w.as_str()) && w.len() > 1);
            Family::Named(rest.map(|w| w.trim_matches(['x', 'y', 'z'])).collect())
        };
        if let Some(axis) = self.joined(&AXES, &POSITION).or_else(|| self.joined(&["0", "1", "2"], &POSITION))
        {
            return Some((axis, beside()));
        }
        let map = |axis: &usize| self.one_of(MAP[*axis], &POSITION).is_some();
        (0..3).find(map).map(|axis| (axis, Family::Map))
    }
}

/// What the names of the three coordinates of a point share, the best first.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Family {
    /// x, y, z.
    Plain,
    /// The words beside the axis.
    Named(String),
    /// Easting, northing, height.
    Map,
}

/// Columns that names give a meaning to, from zero.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Meaning {
    /// Coordinates.
    pub xyz: [usize; 3],
    /// Red, green, blue.
    pub rgb: Option<[usize; 3]>,
    /// Strength of the return.
    pub intensity: Option<usize>,
    /// Normal.
    pub normal: Option<[usize; 3]>,
    /// Columns that are named after an axis too, and were not taken.
    pub others: Vec<usize>,
}

/// What names say where they name no coordinates.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Meaningless {
    /// A list of poses.
    Poses,
    /// Ranges and angles.
    Spherical,
    /// Degrees on the globe.
    Geographic,
    /// Some of the coordinates and not all.
    Partial,
    /// Three numbers along the axes that are no place, such as a rate of turn.
    Vectors,
    /// Nothing of a point.
    Table,
}

/// What the columns of these names hold.
pub(super) fn meaning(names: &[Name]) -> Result<Meaning, Meaningless> {
    let color = three(names, |n, k| {
        let (letter, word) = (["r", "g", "b"][k], ["red", "green", "blue"][k]);
        let float = ["rf", "gf", "bf"][k];
        let digit = ["0", "1", "2"][k];
        n.is(letter)
            || n.one_of(&[letter, word, float], &COLOR).is_some()
            || (n.words.len() > 1 && n.one_of(&[digit], &COLOR[..4]).is_some())
    });
    let intensity = INTENSITY.iter().find_map(|wanted| {
        // What follows is its unit or kind: `Reflectance[dB]`.
        let begins = |n: &Name| {
            let words = n.words.join(" ");
            let rest = words.trim_start_matches("scalar ").strip_prefix(wanted);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(' '))
        };
        names.iter().position(begins)
    });
    // `i` beside `j` is a place in an image.
    let letter = || names.iter().position(|n| n.is("i")).filter(|_| !names.iter().any(|n| n.is("j")));
    let intensity = intensity.or_else(letter);
    if is_poses(names, color.is_some() || intensity.is_some()) {
        return Err(Meaningless::Poses);
    }
    let Some(xyz) = coordinates(names) else { return Err(without_coordinates(names)) };
    let normal = three(names, |n, k| {
        let (axis, digit) = (["x", "y", "z"][k], ["0", "1", "2"][k]);
        n.joined(&[axis], &NORMAL).is_some() || n.joined(&[digit], &NORMAL).is_some()
    });
    let taken = |c: &usize| xyz.contains(c) || normal.is_some_and(|n| n.contains(c));
    let of_axis = |n: &Name| n.words.iter().any(|w| matches!(w.as_str(), "x" | "y" | "z"));
    let others = (0..names.len()).filter(|c| of_axis(&names[*c]) && !taken(c)).collect();
    Ok(Meaning { xyz, rgb: color, intensity, normal, others })
}

fn three(names: &[Name], is: impl Fn(&Name, usize) -> bool) -> Option<[usize; 3]> {
    let find = |k: usize| names.iter().position(|n| is(n, k));
    Some([find(0)?, find(1)?, find(2)?])
}

/// The coordinates of the best family that has all three. A height may stand for z.
fn coordinates(names: &[Name]) -> Option<[usize; 3]> {
    let found: Vec<(usize, usize, Family)> = names
        .iter()
        .enumerate()
        .filter_map(|(c, n)| n.axis().map(|(axis, family)| (c, axis, family)))
        .collect();
    let column =
        |axis: usize, family: &Family| found.iter().find(|f| f.1 == axis && f.2 == *family).map(|f| f.0);
    let mut families: Vec<&Family> = Vec::new();
    found.iter().filter(|f| f.1 == 0).for_each(|f| {
        if !families.contains(&&f.2) {
            families.push(&f.2);
        }
    });
    // Stable: named families stay in the order of the file.
    families.sort_by_key(|f| match f {
        Family::Plain => 0,
        Family::Named(_) => 1,
        Family::Map => 2,
    });
    families.into_iter().find_map(|family| {
        let z = column(2, family).or_else(|| column(2, &Family::Map)).or_else(|| column(2, &Family::Plain));
        Some([column(0, family)?, column(1, family)?, z?])
    })
}

/// Quaternions or a rotation matrix; three angles only where nothing says that rows are points.
fn is_poses(names: &[Name], of_points: bool) -> bool {
    let any = |words: &[&str]| names.iter().any(|n| words.iter().any(|w| n.is(w)));
    let quaternion = ["x", "y", "z", "w"].iter().all(|k| {
        names.iter().any(|n| {
            n.joined(&[k], &ROTATION).is_some()
                || n.joined(&[&format!("q{k}")], &ROTATION).is_some()
                || n.is(&format!("q{k}"))
        })
    });
    let matrix = (any(&["r11"]) && any(&["r22"]) && any(&["r33"]))
        || (any(&["r00"]) && any(&["r11"]) && any(&["r22"]));
    let angles = any(&["roll"]) && any(&["pitch"]) && any(&["yaw", "heading"]);
    quaternion || matrix || (angles && !of_points)
}

fn without_coordinates(names: &[Name]) -> Meaningless {
    let any = |wanted: &[&str]| names.iter().any(|n| n.words.iter().any(|w| wanted.contains(&w.as_str())));
    let both = any(&["range", "distance", "dist", "radius", "rho"])
        && any(&["azimuth", "azi", "theta", "phi", "hz", "bearing", "elevation", "angle"]);
    if both {
        return Meaningless::Spherical;
    }
    if any(&["latitude", "lat"]) && any(&["longitude", "lon", "lng", "long"]) {
        return Meaningless::Geographic;
    }
    let axes = (0..3).filter(|axis| names.iter().any(|n| n.axis().is_some_and(|a| a.0 == *axis))).count();
    // Only names without blanks: in prose, axes stand beside other words too.
    let vector = |axis: &str| {
        names.iter().any(|n| {
            n.words.len() > 1 && !n.text.contains(char::is_whitespace) && n.words.iter().any(|w| w == axis)
        })
    };
    match axes {
        2.. => Meaningless::Partial,
        _ if ["x", "y", "z"].into_iter().all(vector) => Meaningless::Vectors,
        _ => Meaningless::Table,
    }
}
