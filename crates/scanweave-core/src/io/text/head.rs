//! What stands before the rows of numbers, and whether the file has such rows at all.

use super::grammar::{Grammar, Separator};
use super::names::{Meaning, Meaningless, Name, meaning};
use super::thousands;
use crate::error::{Error, Result};
use crate::io::scalar::counted;
use crate::printable::printable_start;
use std::path::Path;

/// Lines that are looked at to tell a scan from another table.
const LINES: usize = 1000;
/// Fewest rows of a scan: shorter tables are calibrations, targets or poses.
const FEWEST_ROWS: usize = 10;

/// The head of a text file of points.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Head {
    /// The names of the columns, none where the file has no line of names.
    pub names: Vec<Name>,
    /// What the names say, where there are some and the user does not say it.
    pub meaning: Option<Meaning>,
    /// Whether a comment names x, y, z in other columns, but not as many names as there are columns.
    pub doubtful_names: bool,
    /// Number of the line of the first row, from 1.
    pub first_row: usize,
    /// Fields of the first row.
    pub width: usize,
    /// Whether a number of points stands before the rows, as in PTS.
    pub counted: bool,
}

/// Lines with their numbers from 1, without blanks at their ends; the last says whether a line feed ends it.
pub(super) fn lines(text: &str) -> impl Iterator<Item = (usize, &str, bool)> {
    let numbered = text.split_inclusive('\n').enumerate();
    numbered.map(|(i, l)| (i + 1, l.trim_ascii_end(), l.ends_with('\n')))
}

/// Whether a line is a comment. Where a semicolon separates, one before a row is an empty field.
pub(super) fn is_comment(line: &str, grammar: &Grammar) -> bool {
    let line = line.trim_ascii_start();
    match line.as_bytes() {
        [b'#' | b'%' | b'!', ..] | [b'/', b'/', ..] => true,
        [b';', ..] => grammar.separator != Separator::Semicolon,
        _ => false,
    }
}

/// The number of points that a line states, if that is all it holds.
pub(super) fn count(fields: &[&str]) -> Option<usize> {
    match fields {
        [word] if word.bytes().all(|b| b.is_ascii_digit()) => word.parse().ok().filter(|&n| n > 0),
        _ => None,
    }
}

/// The lines at the beginning of a file, sorted by what they are.
#[derive(Default)]
struct Survey<'a> {
    comments: Vec<&'a str>,
    /// Lines of words before the first row.
    words: Vec<&'a str>,
    /// The first line that begins with a number and is no row, before the first row.
    damaged: Option<(usize, &'a str)>,
    /// Rows of three numbers or more, and lines that are none.
    rows: usize,
    others: usize,
    /// Most numbers in a line.
    most: usize,
    largest_count: usize,
    first_row: usize,
    first: Vec<&'a str>,
    whole: bool,
}

impl<'a> Survey<'a> {
    fn of(text: &'a str, grammar: &Grammar) -> Self {
        let mut survey = Self { whole: true, ..Self::default() };
        let mut fields = Vec::new();
        for (number, line, _) in lines(text) {
            if survey.rows + survey.others >= LINES {
                survey.whole = false;
                break;
            }
            if line.is_empty() {
                continue;
            }
            if is_comment(line, grammar) {
                if survey.rows == 0 && survey.comments.len() < LINES {
                    survey.comments.push(line);
                }
                continue;
            }
            grammar.split(line, &mut fields);
            survey.add(number, line, &fields, grammar);
        }
        survey
    }

    fn add(&mut self, number: usize, line: &'a str, fields: &[&'a str], grammar: &Grammar) {
        let numbers = fields.iter().filter(|f| grammar.is_number(f)).count();
        self.most = self.most.max(numbers);
        if let Some(count) = count(fields) {
            self.largest_count = self.largest_count.max(count);
            return;
        }
        // Beside a first row, rows without a return may be empty.
        let usable = fields.iter().filter(|f| grammar.number(f).is_some()).count();
        if numbers >= 3 || (self.rows > 0 && usable >= 3) {
            self.rows += 1;
            if self.rows == 1 {
                self.first_row = number;
                self.first = fields.to_vec();
            }
            return;
        }
        self.others += 1;
        if self.rows == 0 {
            self.words.push(line);
            if self.damaged.is_none() && fields.first().is_some_and(|f| grammar.is_number(f)) {
                self.damaged = Some((number, line));
            }
        }
    }
}

/// Reads the head of `text`. Where the user says what the columns hold (`told`), names need no meaning.
///
/// # Errors
/// [`Error::NotAScan`] for a list of poses and for a table of something else; [`Error::File`] for names
/// that do not fit, and for coordinates that are not x, y and z.
pub(super) fn find(path: &Path, text: &str, grammar: &Grammar, told: bool) -> Result<Head> {
    let survey = Survey::of(text, grammar);
    refuse_other_text(path, &survey, grammar, told)?;
    if let Some((number, line)) = survey.damaged {
        return Err(bad_row(path, number, line, "a row of at least three numbers"));
    }
    let width = survey.first.len();
    let mut head = Head {
        names: Vec::new(),
        meaning: None,
        doubtful_names: false,
        first_row: survey.first_row,
        width,
        counted: survey.largest_count > 0,
    };
    // The line right before the rows names them, unless it is prose.
    let words = survey.words.iter().rev().map(|l| (*l, false));
    let comments = survey.comments.iter().rev().map(|l| (*l, true));
    for (place, (line, comment)) in words.chain(comments).enumerate() {
        let Some((names, said)) = read_names(line, grammar, width) else { continue };
        let fits = fits(&names, &survey.first, grammar) && (!comment || names.len() <= width);
        match said {
            _ if told && fits && (!comment || said.is_ok()) => return Ok(Head { names, ..head }),
            _ if told => {}
            Ok(meaning) if fits => {
                (head.names, head.meaning) = (names, Some(meaning));
                return Ok(head);
            }
            // It may be prose; if it mentions x, y, z first, it says what no names would.
            Ok(meaning) if comment => {
                let differs = meaning.xyz != [0, 1, 2];
                head.doubtful_names |= differs;
            }
            Ok(_) => {
                let found =
                    format!("{} for rows of {}", counted(names.len(), "name"), counted(width, "column"));
                let remedy =
                    "pass --columns x=…,y=…,z=… to say which columns are the coordinates, counted from 1";
                return Err(Error::file(path, found, "as many names as columns", remedy));
            }
            Err(Meaningless::Table) if comment || place > 0 => {}
            Err(why) if fits && names.len() == width => return Err(refusal(path, &names, &why)),
            Err(_) => {}
        }
    }
    Ok(head)
}

/// Refuses text that is no table of points, by its rows alone.
fn refuse_other_text(path: &Path, survey: &Survey<'_>, grammar: &Grammar, told: bool) -> Result<()> {
    let expected = "rows of coordinates x, y, z";
    let other = |found: String| {
        let remedy = "leave it out, or pass --columns x=…,y=…,z=… if its rows are points";
        Err(Error::not_a_scan(path, found, expected, remedy))
    };
    if survey.words.iter().any(|l| l.trim_ascii_start().to_ascii_lowercase().starts_with("ncols ")) {
        return other("a grid of heights (ESRI ASCII)".to_owned());
    }
    if survey.rows < survey.others {
        thousands::refuse(path, &survey.words, grammar)?;
    }
    if survey.rows == 0 {
        return other(match survey.most {
            0 => "text without numbers".to_owned(),
            n => format!("text with at most {} in a row", counted(n, "number")),
        });
    }
    let lines = survey.rows + survey.others;
    if survey.rows < survey.others {
        return other(format!("text in which {} of {lines} lines are rows of numbers", survey.rows));
    }
    let few = survey.whole && survey.rows < FEWEST_ROWS && survey.largest_count < FEWEST_ROWS;
    if few && !told {
        return other(format!("a table of {}", counted(survey.rows, "row")));
    }
    Ok(())
}

/// The names in a line, with what they mean: split as the rows are, else as the names themselves suggest.
fn read_names(
    line: &str,
    grammar: &Grammar,
    width: usize,
) -> Option<(Vec<Name>, Result<Meaning, Meaningless>)> {
    let line = line.trim_ascii_start().trim_start_matches(['#', '/', '%', '!', ';']);
    // "Columns: x y z"
    let list =
        line.split_once(": ").filter(|(title, _)| !title.contains([' ', ',', '"'])).map_or(line, |l| l.1);
    let ways = [grammar.separator, Separator::Tab, Separator::Comma, Separator::Semicolon, Separator::Any];
    let read = |separator| {
        let mut fields = Vec::new();
        Grammar { separator, decimal_comma: false, quotes: true }.split(list.trim_ascii(), &mut fields);
        let names = joined(&fields, separator);
        let said = meaning(&names);
        (names, said)
    };
    let all: Vec<_> = ways.into_iter().map(read).filter(|(names, _)| names.len() >= 3).collect();
    let rank = |(names, said): &(Vec<Name>, Result<Meaning, Meaningless>)| {
        (said.is_err(), names.len() != width, *said == Err(Meaningless::Table))
    };
    all.into_iter().min_by_key(rank)
}

/// Names, with a unit in brackets joined to the word before it where blanks separate.
fn joined(fields: &[&str], separator: Separator) -> Vec<Name> {
    let mut words: Vec<String> = Vec::new();
    for field in fields {
        match words.last_mut() {
            Some(last) if separator != Separator::Comma && field.starts_with(['[', '(']) => {
                last.push(' ');
                last.push_str(field);
            }
            _ => words.push((*field).to_owned()),
        }
    }
    words.iter().map(|w| Name::new(w)).collect()
}

/// Whether names can be those of the columns: as many, or only labels without a name behind them.
fn fits(names: &[Name], first: &[&str], grammar: &Grammar) -> bool {
    // Rows may leave out fields at their ends.
    let beyond = first.get(names.len()..).unwrap_or_default();
    beyond.iter().all(|f| !grammar.is_number(f))
}

fn refusal(path: &Path, names: &[Name], why: &Meaningless) -> Error {
    let list: Vec<String> = names.iter().take(12).map(|n| printable_start(&n.text, 24)).collect();
    let more = if names.len() > 12 { ", …" } else { "" };
    let columns = format!("columns [{}{more}]", list.join(", "));
    let expected = "columns named x, y and z";
    let remedy = "pass --columns x=…,y=…,z=… to say which columns are the coordinates, counted from 1";
    match why {
        Meaningless::Poses => Error::not_a_scan(
            path,
            format!("a list of poses: {columns}"),
            "points",
            "pass poses by --poses, or --columns if the rows are points",
        ),
        Meaningless::Table | Meaningless::Vectors => {
            Error::not_a_scan(path, format!("a table with {columns}"), expected, remedy)
        }
        Meaningless::Spherical => Error::file(
            path,
            format!("ranges and angles: {columns}"),
            expected,
            "export Cartesian coordinates",
        ),
        Meaningless::Geographic => Error::file(
            path,
            format!("degrees of latitude and longitude: {columns}"),
            expected,
            "export coordinates in metres, in a map projection or a local frame",
        ),
        Meaningless::Partial => Error::file(path, columns, expected, remedy),
    }
}

/// A line that should be a row and is none.
pub(super) fn bad_row(path: &Path, number: usize, line: &str, expected: &str) -> Error {
    let found = format!("line {number} '{}'", printable_start(line.trim_ascii(), 80));
    let remedy = "remove that line, start it with # if it is a comment, or export the scan again";
    Error::file(path, found, expected, remedy)
}
