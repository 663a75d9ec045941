//! Tables as Markdown and as comma-separated values.

use std::fmt::Write;

/// A table for people.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Grid {
    /// Heads of the columns.
    pub head: Vec<String>,
    /// So many columns hold text, the others numbers.
    pub left: usize,
    /// One a line.
    pub rows: Vec<Row>,
}

/// A line of a [`Grid`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Row {
    /// One a column.
    pub cells: Vec<String>,
    /// Its figures were published elsewhere and not measured here.
    pub quoted: bool,
}

/// A heading, an explanation and the tables below it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Part {
    /// Heading.
    pub title: String,
    /// How the tables are to be read; may be empty.
    pub text: String,
    /// The tables.
    pub grids: Vec<Grid>,
}

impl Grid {
    /// A table whose rows are all our own.
    pub fn new(head: Vec<String>, left: usize, rows: Vec<Vec<String>>) -> Self {
        let rows = rows.into_iter().map(|cells| Row { cells, quoted: false }).collect();
        Self { head, left, rows }
    }

    /// As Markdown; the second cell of a quoted row is in italics.
    pub fn markdown(&self) -> String {
        let cells = |row: &Row| {
            let mut cells = row.cells.clone();
            if let Some(cell) = cells.get_mut(1).filter(|_| row.quoted) {
                *cell = format!("*{cell}*");
            }
            cells
        };
        markdown(&self.head, self.left, &self.rows.iter().map(cells).collect::<Vec<_>>())
    }
}

impl Part {
    /// As Markdown, with an empty line at the end.
    pub fn markdown(&self) -> String {
        let mut text = format!("## {}\n\n", self.title);
        if !self.text.is_empty() {
            text.push_str(&format!("{}\n\n", self.text));
        }
        for grid in &self.grids {
            text.push_str(&(grid.markdown() + "\n"));
        }
        text
    }
}

/// A Markdown table; the first `left` columns are aligned left, the others right.
pub fn markdown(head: &[String], left: usize, rows: &[Vec<String>]) -> String {
    let cell = |row: &[String], c: usize| row.get(c).map_or("", String::as_str).replace('|', "\\|");
    let width = |c: usize| {
        let rows = rows.iter().map(|r| cell(r, c).chars().count());
        rows.chain([head[c].chars().count(), 3]).max().unwrap_or(3)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let mut text = String::new();
    let mut line = |cells: &[String]| {
        let padded = widths.iter().enumerate().map(|(c, &width)| {
            let cell = cell(cells, c);
            let pad = " ".repeat(width - cell.chars().count());
            if c < left { format!("{cell}{pad}") } else { format!("{pad}{cell}") }
        });
        writeln!(text, "| {} |", padded.collect::<Vec<_>>().join(" | ")).ok();
    };
    line(head);
    let rule = |(c, &width): (usize, &usize)| match c < left {
        true => "-".repeat(width),
        false => format!("{}:", "-".repeat(width - 1)),
    };
    line(&widths.iter().enumerate().map(rule).collect::<Vec<_>>());
    rows.iter().for_each(|row| line(row));
    text
}

/// Comma-separated values (RFC 4180, lines end in a line feed).
pub fn csv(head: &[&str], rows: &[Vec<String>]) -> String {
    let quoted = |v: &str| match v.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", v.replace('"', "\"\"")),
        false => v.to_owned(),
    };
    let mut text = head.join(",") + "\n";
    for row in rows {
        text.push_str(&row.iter().map(|v| quoted(v)).collect::<Vec<_>>().join(","));
        text.push('\n');
    }
    text
}

/// Names as heads of columns.
pub fn heads(names: &[&str]) -> Vec<String> {
    names.iter().map(|n| (*n).to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_line_up_and_odd_characters_stay_inside_their_cell() {
        let rows = [heads(&["a|b", "1"]), heads(&["longer", "12345"])];
        let text = markdown(&heads(&["name", "n"]), 1, &rows);
        assert_eq!(text, "| name   |     n |\n| ------ | ----: |\n| a\\|b   |     1 |\n| longer | 12345 |\n");
        let rows = [heads(&["a,b", "say \"x\""])];
        assert_eq!(csv(&["one", "two"], &rows), "one,two\n\"a,b\",\"say \"\"x\"\"\"\n");
    }
}
