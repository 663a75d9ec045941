//! What separates the fields of a file's rows, and how its numbers are written.
//!
//! One row cannot tell: `0,558 0,583 -1,397` is three numbers with decimal commas, or six between commas
//! and blanks. So lines from all over the file are looked at. What they decide holds for every row, and a
//! row that does not fit is an error and not another reading.

use super::super::scalar::parse_number;

/// Places of the file that are looked at, and lines at each.
const PLACES: usize = 64;
const LINES: usize = 16;

/// What stands between fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Separator {
    /// Any number of blanks and tabs.
    Blank,
    /// One tab: fields may be empty or hold blanks.
    Tab,
    /// One comma.
    Comma,
    /// One semicolon.
    Semicolon,
    /// Any mixture of these.
    Any,
}

/// How the rows of a file are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Grammar {
    /// What stands between fields.
    pub separator: Separator,
    /// Whether the comma is the decimal mark.
    pub decimal_comma: bool,
    /// Whether a field may stand in quotation marks.
    pub quotes: bool,
}

impl Grammar {
    /// How the rows of `text` are written.
    pub(super) fn of(text: &str) -> Self {
        let quotes = text.contains('"');
        let lines = sample(text);
        let grammar = |separator, decimal_comma| Self { separator, decimal_comma, quotes };
        let all = |mark: char| !lines.is_empty() && lines.iter().all(|l| l.contains(mark));
        let look = |separator| Look::at(&lines, &grammar(separator, false));
        if all(';') {
            let look = look(Separator::Semicolon);
            let separator = if look.joined { Separator::Any } else { Separator::Semicolon };
            return grammar(separator, !look.joined && look.commas > look.points);
        }
        if all('\t') {
            let look = look(Separator::Tab);
            // Several tabs may align columns: then they are blanks.
            if look.regular && !look.joined {
                return grammar(Separator::Tab, look.commas > look.points);
            }
        }
        if !lines.iter().any(|l| l.contains([',', ';'])) {
            return grammar(Separator::Blank, false);
        }
        let blank = look(Separator::Blank);
        // Where both marks occur, the rarer one is an error of its row.
        if blank.commas > 0 && !blank.several && blank.narrowest >= 3 {
            return grammar(Separator::Blank, blank.commas > blank.points);
        }
        let comma = all(',') && !look(Separator::Comma).joined;
        grammar(if comma { Separator::Comma } else { Separator::Any }, false)
    }

    /// Puts the fields of `line` into `fields`.
    pub(super) fn split<'a>(&self, line: &'a str, fields: &mut Vec<&'a str>) {
        fields.clear();
        if self.quotes && line.contains('"') {
            return self.split_quoted(line, fields);
        }
        match self.mark() {
            Some(mark) => {
                fields.extend(line.split(mark).map(str::trim_ascii));
                // A mark at the end of a row begins no field.
                if fields.last().is_some_and(|f| f.is_empty()) {
                    fields.pop();
                }
            }
            None if self.separator == Separator::Blank => fields.extend(line.split_ascii_whitespace()),
            None => fields.extend(line.split(|c| self.ends(c)).filter(|f| !f.is_empty())),
        }
    }

    /// The mark that stands once between two fields, so that a field may be empty.
    fn mark(&self) -> Option<char> {
        match self.separator {
            Separator::Tab => Some('\t'),
            Separator::Comma => Some(','),
            Separator::Semicolon => Some(';'),
            Separator::Blank | Separator::Any => None,
        }
    }

    fn ends(&self, c: char) -> bool {
        match self.mark() {
            Some(mark) => c == mark,
            None => c.is_ascii_whitespace() || (self.separator == Separator::Any && matches!(c, ',' | ';')),
        }
    }

    /// Fields that may stand in quotation marks, and then hold what otherwise separates.
    fn split_quoted<'a>(&self, line: &'a str, fields: &mut Vec<&'a str>) {
        // A tab that separates is no blank around a field.
        let blank = |c: char| c.is_ascii_whitespace() && self.mark() != Some(c);
        let mut rest = line.trim_start_matches(blank);
        while !rest.is_empty() {
            let quoted = rest.strip_prefix('"').and_then(|inner| inner.split_once('"'));
            let (field, after) = match quoted {
                Some((inner, after)) => (inner.trim_ascii(), after),
                None => rest.split_at(rest.find(|c| self.ends(c)).unwrap_or(rest.len())),
            };
            if self.mark().is_some() || quoted.is_some() || !field.is_empty() {
                fields.push(field.trim_ascii());
            }
            // Up to the next separator, which nothing but blanks may precede.
            let next = after.find(|c| self.ends(c)).map_or("", |at| after.get(at + 1..).unwrap_or(""));
            rest = next.trim_start_matches(blank);
        }
    }

    /// The number in a field; NaN where it is empty or says that there is none.
    #[inline]
    pub(super) fn number(&self, field: &str) -> Option<f64> {
        if !self.decimal_comma || !field.contains([',', '.']) {
            return plain(field);
        }
        if field.contains('.') {
            // Both marks in one file: one of them is read wrong. "1.#QNAN" and the like are not numbers anyway.
            return parse_number(field).filter(|v| v.is_nan());
        }
        let mut buffer = [0u8; 48];
        let point = buffer.get_mut(..field.len())?;
        point.copy_from_slice(field.as_bytes());
        point.iter_mut().filter(|b| **b == b',').for_each(|b| *b = b'.');
        plain(std::str::from_utf8(point).ok()?)
    }

    /// Whether a field holds a number, and is not empty.
    pub(super) fn is_number(&self, field: &str) -> bool {
        !is_empty(field) && self.number(field).is_some()
    }
}

#[inline]
fn plain(field: &str) -> Option<f64> {
    field.parse().ok().or_else(|| unusual(field))
}

/// Numbers of other programs: `1.0D+03` of Fortran, a typeset minus, no value at all.
fn unusual(field: &str) -> Option<f64> {
    if is_empty(field) {
        return Some(f64::NAN);
    }
    if let Some(v) = parse_number(field) {
        return Some(v);
    }
    let written = field.trim_matches(['"', '\'']).replace('\u{2212}', "-");
    let fortran = written.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '+' | '-' | '.'));
    let written = if fortran { written.replace(['d', 'D'], "e") } else { written };
    written.parse().ok()
}

/// Whether a field says that it has no value.
fn is_empty(field: &str) -> bool {
    field.is_empty() || ["na", "null", "none"].iter().any(|word| field.eq_ignore_ascii_case(word))
}

/// What the fields of lines have in common when split in one way.
struct Look {
    /// A field is several numbers: the separator is not all that separates.
    joined: bool,
    /// Numbers with one comma between digits and no point.
    commas: usize,
    /// Some have more than one comma, one at an end, or a point too: there it is no decimal mark.
    several: bool,
    /// Numbers with a decimal point and no comma.
    points: usize,
    /// Every line has as many fields, and no column is empty throughout.
    regular: bool,
    /// Fields of the line that has the fewest.
    narrowest: usize,
}

impl Look {
    fn at(lines: &[&str], grammar: &Grammar) -> Self {
        let mut fields = Vec::new();
        let mut filled: Vec<bool> = Vec::new();
        let mut look = Self {
            joined: false,
            commas: 0,
            several: false,
            points: 0,
            regular: true,
            narrowest: usize::MAX,
        };
        for line in lines {
            grammar.split(line, &mut fields);
            look.narrowest = look.narrowest.min(fields.len());
            if filled.is_empty() {
                filled.resize(fields.len(), false);
            }
            look.regular &= filled.len() == fields.len();
            filled.iter_mut().zip(&fields).for_each(|(filled, field)| *filled |= !field.is_empty());
            for field in fields.iter().filter(|f| f.contains(|c: char| c.is_ascii_digit())) {
                look.number(field);
            }
        }
        look.regular &= filled.iter().all(|f| *f);
        look
    }

    fn number(&mut self, field: &str) {
        let numeric = |c: char| c.is_ascii_digit() || "+-.,eEdD".contains(c);
        if field.contains(char::is_whitespace) {
            let numbers = words(field).filter(|w| parse_number(w).is_some()).count();
            self.joined |= numbers >= 2 && numbers == words(field).count();
        } else if field.chars().all(numeric) {
            let comma = field.split_once(',').map(|(before, after)| {
                before.ends_with(|c: char| c.is_ascii_digit())
                    && after.starts_with(|c: char| c.is_ascii_digit())
                    && !after.contains(',')
            });
            let point = field.contains('.');
            self.commas += usize::from(comma == Some(true) && !point);
            self.several |= comma == Some(false) || (comma.is_some() && point);
            self.points += usize::from(comma.is_none() && point);
        }
    }
}

fn words(line: &str) -> impl Iterator<Item = &str> {
    line.split(|c: char| c.is_ascii_whitespace() || matches!(c, ',' | ';')).filter(|w| !w.is_empty())
}

/// Lines of numbers from all over the text, and from the first comma, which may stand between these places.
/// A short text is looked at whole.
fn sample(text: &str) -> Vec<&str> {
    let mut lines = Vec::new();
    let mut from = 0;
    for place in 0..PLACES {
        // Places of a short text overlap: go on where the last one ended.
        let at = text.len() / PLACES * place;
        let start = if at <= from { from } else { next_line(text, at) };
        from = take_numeric(text, start, &mut lines);
    }
    if !lines.iter().any(|l| l.contains(','))
        && let Some(comma) = text.find(',')
    {
        let start = text.get(..comma).and_then(|t| t.rfind('\n')).map_or(0, |end| end + 1);
        take_numeric(text, start, &mut lines);
    }
    lines
}

/// Where the line after the one at byte `at` begins.
fn next_line(text: &str, at: usize) -> usize {
    let tail = text.as_bytes().get(at..).unwrap_or_default();
    tail.iter().position(|&b| b == b'\n').map_or(text.len(), |end| at + end + 1)
}

/// Adds those of the lines from `start` that hold numbers, and gives where they end.
fn take_numeric<'a>(text: &'a str, start: usize, lines: &mut Vec<&'a str>) -> usize {
    let mut end = start;
    for line in text.get(start..).unwrap_or("").split_inclusive('\n').take(LINES) {
        end += line.len();
        let line = line.trim_ascii_end();
        if is_numeric(line.trim_ascii_start()) {
            lines.push(line);
        }
    }
    end
}

/// Whether a line is no comment and holds numbers for the most part.
fn is_numeric(line: &str) -> bool {
    if line.starts_with(['#', '/', '%', '!']) {
        return false;
    }
    let number = |w: &&str| unusual(w.trim_matches('"')).is_some();
    let count = words(line).count();
    let numbers = words(line).filter(number).count();
    count >= 2 && 2 * numbers >= count
}
