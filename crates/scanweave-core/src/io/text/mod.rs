//! Plain text clouds: XYZ, PTS, TXT, ASC, CSV.
//!
//! The order of work: bytes become lines ([`decode`]); lines from all over the file tell what separates
//! fields ([`grammar`]); what stands before the rows names the columns ([`head`], [`names`]); that, or the
//! user, says which are read ([`columns`]); then the rows are read ([`rows`]), and what they hold is checked
//! where nothing says that they are points ([`watch`]).
//!
//! `#`, `//`, `%`, `!` and `;` begin a comment, which may be the line of names.

mod columns;
mod decode;
mod grammar;
mod head;
mod names;
mod rows;
#[cfg(test)]
mod tests;
mod thousands;
mod watch;

use super::colors::channels_to_bytes;
use super::scan_file::{Note, ReadOptions, ScanFile, StoredScan};
use super::scanner::without_zeros;
use crate::error::{Error, Result};
use crate::scan::assemble::{Attributes, assemble_with};
use columns::Columns;
use grammar::{Grammar, Separator};
use rows::Table;
use std::path::Path;

pub(super) use decode::is_utf16;

/// Reads the points (and colours, where there are any) of a text file's `bytes`.
///
/// Without a line of names the first three columns are coordinates, and colours are columns 4 to 6 (or 5 to
/// 7 of seven, after an intensity) where they hold only whole numbers from 0 to 255.
///
/// # Errors
/// [`Error::NotAScan`] for a table of something else than points. [`Error::File`] for a row that is not
/// numbers, for names that do not say which columns are coordinates, and where there are no names and a
/// column looks like an index or times.
pub(super) fn read(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<ScanFile> {
    let text = decode::decode(bytes);
    let grammar = Grammar::of(&text);
    let head = head::find(path, &text, &grammar, options.columns.is_some())?;
    let columns = columns::choose(path, &head, options)?;
    let mut table = rows::read(path, &text, &grammar, &columns, &head)?;
    refuse_other_tables(path, &table)?;
    let colors = colors(&table, &columns);
    let mut notes = columns.notes(&head, options, colors.is_some());
    notes.extend(grammar_note(&grammar, &table, head.width));
    notes.append(&mut table.notes);
    let scans = scans(&table, &columns, colors.as_deref());
    Ok(notes.into_iter().fold(ScanFile::of(scans), ScanFile::with))
}

/// Refuses rows that are poses, an index or times, where nothing says that they are coordinates.
fn refuse_other_tables(path: &Path, table: &Table) -> Result<()> {
    if let Some(poses) = table.watch.poses() {
        let found = format!("a list of poses: every row is {poses}");
        let remedy = "pass poses by --poses, or --columns x=…,y=…,z=… if the rows are points";
        return Err(Error::not_a_scan(path, found, "points", remedy));
    }
    let Some((column, what)) = table.watch.no_coordinate() else { return Ok(()) };
    let found = format!("column {} looks like {what}, and the columns have no names", column + 1);
    let remedy = "pass --columns x=…,y=…,z=… to say which columns are the coordinates, counted from 1";
    Err(Error::file(path, found, "coordinates in the first three columns", remedy))
}

/// What a user should know of commas.
fn grammar_note(grammar: &Grammar, table: &Table, width: usize) -> Option<Note> {
    if grammar.decimal_comma {
        return Some(Note::info("commas are read as decimal marks"));
    }
    let whole = |v: &f64| v.fract() == 0.0;
    let doubtful = grammar.separator == Separator::Comma && width >= 6 && width.is_multiple_of(2);
    (doubtful && table.xyz.iter().flatten().all(whole)).then(|| {
        Note::warning(
            "commas are read as separators, and all coordinates are whole numbers: if the commas are \
             decimal marks, export with decimal points",
        )
    })
}

/// Colours of all rows, if that is what the values are: said to be, or whole numbers from 0 to 255 that
/// are not all 0 or 1 (which would be normals along the axes).
fn colors(table: &Table, columns: &Columns) -> Option<Vec<[u8; 3]>> {
    columns.rgb?;
    let stride = columns.beside().count();
    let values: Vec<[f64; 3]> =
        table.beside.chunks_exact(stride).filter_map(|row| row.first_chunk().copied()).collect();
    let mut all = values.iter().flatten();
    let bytes =
        all.clone().all(|v| v.fract() == 0.0 && (0.0..=255.0).contains(v)) && all.clone().any(|&v| v > 1.0);
    let usable = bytes || (columns.rgb_is_said && all.all(|v| v.is_finite()));
    usable.then(|| channels_to_bytes(&values))
}

/// One scan for each block of rows.
fn scans(table: &Table, columns: &Columns, colors: Option<&[[u8; 3]]>) -> Vec<StoredScan> {
    let stride = columns.beside().count();
    let after_rgb = if columns.rgb.is_some() { 3 } else { 0 };
    let after_intensity = after_rgb + usize::from(columns.intensity.is_some());
    // Of seven columns without names the fourth is an intensity only if the last three are a colour.
    let intensity =
        columns.intensity.filter(|_| columns.rgb_is_said || columns.rgb.is_none() || colors.is_some());
    let one = |block: &std::ops::Range<usize>| {
        let beside = |i: usize, at: usize| table.beside[stride * (block.start + i) + at] as f32;
        let color = |i: usize| colors.map_or([0; 3], |all| all[block.start + i]);
        let strength = |i: usize| beside(i, after_rgb);
        let direction = |i: usize| [0, 1, 2].map(|k| beside(i, after_intensity + k));
        let attributes = Attributes {
            rgb: colors.map(|_| &color as &dyn Fn(usize) -> [u8; 3]),
            intensity: intensity.map(|_| &strength as &dyn Fn(usize) -> f32),
            normal: columns.normal.map(|_| &direction as &dyn Fn(usize) -> [f32; 3]),
        };
        let xyz = without_zeros(block.len(), |i| table.xyz[block.start + i]);
        let cloud = assemble_with(block.len(), xyz, &attributes, None);
        StoredScan { cloud, pose: None }
    };
    table.blocks.iter().map(one).collect()
}
