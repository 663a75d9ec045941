//! The data of an ASCII PLY file: values between any white space, of which a line end is one kind.

use super::header::{Element, Header, Kind};
use super::{Fields, Table, too_few, too_many};
use crate::error::{Error, Result};
use crate::io::scalar::{counted, parse_between_blanks};
use crate::scan::PointCloud;
use std::path::Path;

pub(super) fn read(
    path: &Path,
    bytes: &[u8],
    header: &Header,
    vertex: usize,
    fields: &Fields,
) -> Result<PointCloud> {
    let mut tokens = Tokens { rest: &bytes[header.data_start..] };
    for element in &header.elements[..vertex] {
        walk(path, &mut tokens, element, None)?;
    }
    let element = &header.elements[vertex];
    let mut table = Table::new(element, fields, tokens.rest.len());
    walk(path, &mut tokens, element, Some(&mut table))?;
    // A row with a value too few takes one of the next element. Only the end of the file shows it.
    for element in &header.elements[vertex + 1..] {
        walk(path, &mut tokens, element, None)?;
    }
    let more = tokens.count();
    if more > 0 {
        let last = &header.elements[header.elements.len() - 1];
        return Err(too_many(path, format!("{} after the {} rows", counted(more, "value"), last.name), last));
    }
    Ok(table.into_cloud(fields))
}

/// Walks over an element's rows, and fills `table` where it is given.
fn walk(
    path: &Path,
    tokens: &mut Tokens<'_>,
    element: &Element,
    mut table: Option<&mut Table>,
) -> Result<()> {
    if element.properties.is_empty() {
        return Ok(());
    }
    for row in 0..element.count {
        let start = tokens.rest;
        let cut = || too_few(path, element, row, None);
        for (index, property) in element.properties.iter().enumerate() {
            let token = tokens.next().ok_or_else(cut)?;
            let bad = || bad_row(path, element, row, start);
            match property.kind {
                Kind::Scalar(_) => {
                    if let Some(table) = table.as_mut().filter(|t| t.is_wanted(index)) {
                        table.set(index, number(token).ok_or_else(bad)?);
                    }
                }
                Kind::List { .. } => {
                    let items = number(token).filter(|n| *n >= 0.0 && n.fract() == 0.0).ok_or_else(bad)?;
                    // Ends with the tokens, however many items the count promises.
                    for _ in 0..items as usize {
                        tokens.next().ok_or_else(cut)?;
                    }
                }
            }
        }
        if let Some(table) = table.as_mut() {
            table.end_row();
        }
    }
    Ok(())
}

fn number(token: &[u8]) -> Option<f64> {
    parse_between_blanks(std::str::from_utf8(token).ok()?)
}

/// A row with a word where a number belongs. `start` is where the row begins.
fn bad_row(path: &Path, element: &Element, row: usize, start: &[u8]) -> Error {
    let line = start.trim_ascii_start().split(|b| matches!(b, b'\n' | b'\r')).next().unwrap_or_default();
    let shown: String = String::from_utf8_lossy(line).trim_end().chars().take(80).collect();
    let properties = match element.properties.len() {
        1 => "property".to_owned(),
        n => format!("{n} properties"),
    };
    Error::file(
        path,
        format!("{} row {} '{shown}'", element.name, row + 1),
        format!("numbers for its {properties}"),
        "correct that row, or the one before it if that has a value too many or too few",
    )
}

/// Words between white space.
struct Tokens<'a> {
    rest: &'a [u8],
}

impl<'a> Iterator for Tokens<'a> {
    type Item = &'a [u8];

    #[inline]
    fn next(&mut self) -> Option<&'a [u8]> {
        let start = self.rest.iter().position(|b| !is_space(*b))?;
        let word = &self.rest[start..];
        let length = word.iter().position(|b| is_space(*b)).unwrap_or(word.len());
        let (token, rest) = word.split_at(length);
        self.rest = rest;
        Some(token)
    }
}

/// White space of the C locale, with which PLY files are read.
#[inline]
fn is_space(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t'..=b'\r')
}
