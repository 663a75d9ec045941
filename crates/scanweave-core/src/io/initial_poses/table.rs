//! Tables of poses with a header line.

use super::{Entry, Poses};
use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::io::poses::{motion_from_quaternion, repaired};
use crate::io::scalar::parse_number;
use std::path::Path;

/// Headers of the columns that say whose pose it is, in the order in which they are tried.
const KEYS: [&str; 5] = ["name", "scan", "file", "filename", "path"];
const POSE: [&str; 7] = ["tx", "ty", "tz", "qx", "qy", "qz", "qw"];
/// Columns that tell other things of a pose.
const OTHER: [&str; 6] = ["component", "probability", "sigma_t_m", "sigma_r_deg", "timestamp", "id"];
const REMEDY: &str = "correct the table or write it again";

/// A row and the line that it begins in.
type Row = (usize, Vec<String>);

fn delimiter(header: &str) -> char {
    [',', ';', '\t'].into_iter().find(|d| header.contains(*d)).unwrap_or(',')
}

fn column(cell: &str) -> String {
    cell.trim().to_ascii_lowercase()
}

/// Whether a line names the columns of a table of poses.
pub(super) fn is_header(line: &str) -> bool {
    let cells: Vec<String> = line.split(delimiter(line)).map(|c| column(c.trim_matches('"'))).collect();
    cells.len() > 7 && KEYS.iter().any(|k| cells.iter().any(|c| c == k))
}

/// Rows of a CSV (RFC 4180); lines that are empty or begin with `#` are left out.
fn rows(path: &Path, text: &str, delimiter: char) -> Result<Vec<Row>> {
    let (mut rows, mut row, mut field) = (Vec::new(), Vec::new(), String::new());
    let (mut line, mut begins, mut inside) = (1, 1, false);
    let mut characters = text.chars().peekable();
    let mut end = |row: &mut Vec<String>, begins: usize| {
        let row: Vec<String> = std::mem::take(row);
        let blank = row.iter().all(|f| f.trim().is_empty());
        if !blank && !row[0].trim_start().starts_with('#') {
            rows.push((begins, row));
        }
    };
    while let Some(c) = characters.next() {
        line += usize::from(c == '\n');
        match c {
            '"' if inside && characters.peek() == Some(&'"') => {
                characters.next();
                field.push('"');
            }
            '"' if inside => inside = false,
            '"' if field.trim().is_empty() => {
                inside = true;
                field.clear();
            }
            _ if inside => field.push(c),
            '\n' => {
                row.push(std::mem::take(&mut field));
                end(&mut row, begins);
                begins = line;
            }
            _ if c == delimiter => row.push(std::mem::take(&mut field)),
            _ => field.push(c),
        }
    }
    if inside {
        let found = format!("a quotation that is open from line {begins} to the end");
        return Err(Error::file(path, found, "a closing quotation mark", REMEDY));
    }
    row.push(field);
    end(&mut row, begins);
    Ok(rows)
}

/// Which columns hold what.
struct Columns {
    keys: Vec<usize>,
    pose: Vec<usize>,
    component: Option<usize>,
}

impl Columns {
    fn new(path: &Path, header: &[String]) -> Result<Self> {
        let names: Vec<String> = header.iter().map(|c| column(c)).collect();
        let place = |wanted: &&str| names.iter().position(|n| n == wanted);
        let keys: Vec<usize> = KEYS.iter().filter_map(place).collect();
        let quaternion: Vec<usize> = POSE.iter().filter_map(place).collect();
        let pose = if quaternion.len() == POSE.len() {
            quaternion
        } else {
            let told = |n: &String| KEYS.contains(&n.as_str()) || OTHER.contains(&n.as_str());
            (0..names.len()).filter(|&k| !told(&names[k]) && !names[k].is_empty()).collect()
        };
        if keys.is_empty()
            || !matches!(pose.len(), 7 | 12 | 16)
            || (pose.len() == 7 && place(&"qw").is_none())
        {
            let found = format!("the columns {}", names.join(", "));
            let expected = "name, and tx, ty, tz, qx, qy, qz, qw or 12 or 16 columns of a matrix, row by row";
            return Err(Error::file(path, found, expected, REMEDY));
        }
        Ok(Self { keys, pose, component: place(&"component") })
    }

    /// The pose in a row; none where its cells are empty.
    fn pose(&self, path: &Path, (line, row): &Row) -> Result<Option<RigidMotion>> {
        let cell = |&k: &usize| row.get(k).map(|c| c.trim()).unwrap_or_default();
        let cells: Vec<&str> = self.pose.iter().map(cell).collect();
        if cells.iter().all(|c| c.is_empty()) {
            return Ok(None);
        }
        let values: Option<Vec<f64>> = cells.iter().map(|c| parse_number(c)).collect();
        let wrong = |expected: &str| {
            let found = format!("line {line} '{}'", cells.join(" ").chars().take(80).collect::<String>());
            Error::file(path, found, expected, REMEDY)
        };
        let values = values.ok_or_else(|| wrong("numbers in the columns of the pose, or none"))?;
        if values.len() > 7 {
            return Ok(Some(repaired(path, &format!("in line {line} the matrix"), &values)?.0));
        }
        let pose = motion_from_quaternion(&values[..3], &values[3..]);
        Ok(Some(pose.ok_or_else(|| wrong("finite numbers and a quaternion of unit length"))?.0))
    }
}

/// A table of poses. Where it tells components, the poses of the first one that it names: those of
/// others are unrelated to them.
pub(super) fn read(path: &Path, text: &str) -> Result<Poses> {
    let header = text.lines().map(str::trim).find(|l| !l.is_empty() && !l.starts_with('#'));
    let rows = rows(path, text, delimiter(header.unwrap_or_default()))?;
    let Some(((_, header), rows)) = rows.split_first() else { return Ok(Poses::Named(Vec::new())) };
    let columns = Columns::new(path, header)?;
    let cell = |row: &Row, k: usize| row.1.get(k).map(|c| c.trim().to_owned()).unwrap_or_default();
    let (mut entries, mut first_component) = (Vec::new(), None);
    for row in rows {
        let Some(pose) = columns.pose(path, row)? else { continue };
        let component = columns.component.map(|k| cell(row, k));
        if *first_component.get_or_insert_with(|| component.clone()) != component {
            continue;
        }
        let key: Vec<String> = columns.keys.iter().map(|&k| cell(row, k)).filter(|n| !n.is_empty()).collect();
        entries.push(Entry { key, pose, at: format!("line {}", row.0) });
    }
    Ok(Poses::Named(entries))
}
