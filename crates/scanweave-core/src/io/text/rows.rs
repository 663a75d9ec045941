//! The rows of numbers: one scan, or the blocks of a PTS file, each after its number of points.

use super::columns::Columns;
use super::grammar::Grammar;
use super::head::{Head, bad_row, count, is_comment, lines};
use super::watch::Watch;
use crate::error::{Error, Result};
use crate::io::scalar::counted;
use crate::io::scan_file::Note;
use std::ops::Range;
use std::path::Path;

/// Whole numbers that reach so far are rather millimetres than metres.
const LARGE_EXTENT: f64 = 1000.0;

/// The rows of a file.
pub(super) struct Table {
    /// Coordinates of every row, in metres.
    pub xyz: Vec<[f64; 3]>,
    /// What stands beside them in every row, in the order of [`Columns::beside`]; NaN where it is no number.
    pub beside: Vec<f64>,
    /// The rows of each scan.
    pub blocks: Vec<Range<usize>>,
    /// What is odd about them.
    pub notes: Vec<Note>,
    /// What was seen of the columns.
    pub watch: Watch,
}

struct Reader<'a> {
    path: &'a Path,
    grammar: Grammar,
    columns: &'a Columns,
    beside: Vec<usize>,
    table: Table,
    /// First row of the block, the points that it should have, and rows beyond these.
    start: usize,
    promised: Option<usize>,
    extra: usize,
    /// Fewest and most fields of a row.
    narrowest: usize,
    widest: usize,
    all_whole: bool,
    lowest: f64,
    highest: f64,
}

/// Reads the rows of `text`.
///
/// # Errors
/// [`Error::File`] for a line that is no row, with its number; for a last row that is cut; for a number of
/// points that cannot be one.
pub(super) fn read(
    path: &Path,
    text: &str,
    grammar: &Grammar,
    columns: &Columns,
    head: &Head,
) -> Result<Table> {
    let table = Table {
        xyz: Vec::new(),
        beside: Vec::new(),
        blocks: Vec::new(),
        notes: Vec::new(),
        watch: Watch::new(head.width),
    };
    let mut reader = Reader {
        path,
        grammar: *grammar,
        columns,
        beside: columns.beside().collect(),
        table,
        start: 0,
        promised: None,
        extra: 0,
        narrowest: usize::MAX,
        widest: 0,
        all_whole: true,
        lowest: f64::INFINITY,
        highest: f64::NEG_INFINITY,
    };
    let mut fields = Vec::new();
    for (number, line, ended) in lines(text) {
        if line.is_empty() || is_comment(line, grammar) {
            continue;
        }
        grammar.split(line, &mut fields);
        if let Some(points) = count(&fields)
            && (number < head.first_row || reader.promised.is_some())
            && (ended || reader.table.xyz.is_empty())
        {
            reader.next_block(number, points)?;
        } else if number >= head.first_row {
            reader.row(number, line, &fields, ended)?;
        }
    }
    reader.end_block()?;
    reader.note_whole_numbers();
    Ok(reader.table)
}

impl Reader<'_> {
    #[inline]
    fn row(&mut self, number: usize, line: &str, fields: &[&str], ended: bool) -> Result<()> {
        let uniform = self.narrowest == self.widest;
        if !ended && uniform && fields.len() < self.widest {
            let found = format!("a last row cut short, line {number}: {}", counted(fields.len(), "field"));
            let expected = format!("{} as in the other rows", self.widest);
            return Err(Error::file(self.path, found, expected, "copy or export the file again"));
        }
        self.narrowest = self.narrowest.min(fields.len());
        self.widest = self.widest.max(fields.len());
        // Only what is used must be a number: a label does not spoil a row.
        let grammar = self.grammar;
        let value = |c: usize| fields.get(c).and_then(|f| grammar.number(f));
        let [x, y, z] = self.columns.xyz;
        let (Some(x), Some(y), Some(z)) = (value(x), value(y), value(z)) else {
            return Err(bad_row(self.path, number, line, &self.expected()));
        };
        if self.promised.is_some_and(|points| self.table.xyz.len() - self.start >= points) {
            self.extra += 1;
            return Ok(());
        }
        let raw = [x, y, z];
        if !self.columns.said {
            self.table.watch.add(raw, fields, &grammar);
        }
        if self.all_whole {
            self.add_whole(raw);
        }
        let [ux, uy, uz] = self.columns.unit_m;
        self.table.xyz.push([x * ux, y * uy, z * uz]);
        self.table.beside.extend(self.beside.iter().map(|&c| value(c).unwrap_or(f64::NAN)));
        Ok(())
    }

    fn expected(&self) -> String {
        let marks = if self.grammar.decimal_comma { " with decimal commas, as in other rows" } else { "" };
        match self.columns.xyz {
            [0, 1, 2] => format!("at least three numbers{marks}"),
            [x, y, z] => format!("numbers{marks} in columns {}, {} and {}", x + 1, y + 1, z + 1),
        }
    }

    fn add_whole(&mut self, raw: [f64; 3]) {
        for v in raw.into_iter().filter(|v| v.is_finite()) {
            self.all_whole &= v.fract() == 0.0;
            self.lowest = self.lowest.min(v);
            self.highest = self.highest.max(v);
        }
    }

    /// A number of points begins a block.
    fn next_block(&mut self, number: usize, points: usize) -> Result<()> {
        if self.promised.is_some() && self.table.xyz.len() == self.start {
            let found = format!("line {number} '{points}' right after another number of points");
            let remedy = "remove the number that is none, or export the scan again";
            return Err(Error::file(self.path, found, "rows of numbers", remedy));
        }
        self.end_block()?;
        self.promised = Some(points);
        Ok(())
    }

    fn end_block(&mut self) -> Result<()> {
        let rows = self.table.xyz.len() - self.start;
        if let Some(points) = self.promised.filter(|&p| p != rows || self.extra > 0) {
            // That many more rows are no slip of a writer: the number counts something else.
            if self.extra > points {
                let found = format!("{} after the number {points}", counted(rows + self.extra, "row"));
                let remedy = "remove that line if it is no number of points, or export the scan again";
                return Err(Error::file(self.path, found, counted(points, "row"), remedy));
            }
            // The difference and not the numbers: files with the same fault give one message.
            let text = if self.extra > 0 {
                let more = counted(self.extra, "more row");
                format!("{more} than the number of points before them: as many as that were read")
            } else {
                let missing = counted(points - rows, "row");
                format!("{missing} fewer than the number of points before them: the file may be cut short")
            };
            self.table.notes.push(Note::warning(text));
        }
        if rows > 0 || self.promised.is_some() {
            self.table.blocks.push(self.start..self.table.xyz.len());
        }
        (self.start, self.promised, self.extra) = (self.table.xyz.len(), None, 0);
        Ok(())
    }

    fn note_whole_numbers(&mut self) {
        if self.all_whole && !self.columns.unit_is_said && self.highest - self.lowest > LARGE_EXTENT {
            self.table.notes.push(Note::warning(format!(
                "the coordinates are whole numbers that span more than {LARGE_EXTENT}: \
                 if they are millimetres, pass --unit mm"
            )));
        }
    }
}
