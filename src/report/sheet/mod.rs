//! One self-contained page of figures, tables and plots, for any browser and without a network.
//!
//! `page.html` is built from `scripts/viewer/` (scripts/build-viewer.sh): it has the style of
//! `report.html`, and its content security policy lets nothing run but the script that sorts
//! tables. Without JavaScript everything is still there.

mod evaluation;

pub use evaluation::{Evaluation, SceneSheet, evaluation};

use super::chart::{self, Panel};
use super::grid::{Grid, Part};
use super::markup::{escaped, filled};
use crate::{Error, Result};
use std::fmt::Write;

const TEMPLATE: &str = include_str!("page.html");

/// What a page shows, from above to below.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheet {
    /// What kind of page it is.
    pub brand: String,
    /// What came out, in a sentence.
    pub headline: String,
    /// What else belongs at the top of the page; may be empty.
    pub note: String,
    /// The rest.
    pub sections: Vec<Section>,
}

/// A part of a page with a heading.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    /// Heading.
    pub title: String,
    /// How what follows is to be read; may be empty.
    pub text: String,
    /// What follows.
    pub blocks: Vec<Block>,
}

/// Something in a section.
#[derive(Debug, Clone, PartialEq)]
pub enum Block {
    /// Large figures, each with what it is.
    Figures(Vec<(String, String)>),
    /// A sentence.
    Text(String),
    /// A table that is sorted by clicks on its heads.
    Grid(Grid),
    /// A table that is opened by a click on this text.
    Folded(String, Grid),
    /// An SVG that stands for itself, such as [`chart::svg`] gives, and what it shows.
    Picture(String, String),
}

impl From<Part> for Section {
    fn from(part: Part) -> Self {
        Self { title: part.title, text: part.text, blocks: part.grids.into_iter().map(Block::Grid).collect() }
    }
}

impl Block {
    /// A chart with what it shows.
    ///
    /// # Errors
    /// [`Error::Input`] where it cannot be laid out.
    pub fn chart(panels: &[Panel], caption: impl Into<String>) -> Result<Self> {
        let caption = caption.into();
        let svg = chart::svg(panels).map_err(|e| {
            Error::input(caption.as_str(), e.to_string(), "figures that can be drawn", "leave the plot out")
        })?;
        Ok(Self::Picture(svg, caption))
    }
}

impl Sheet {
    /// The whole page; every text in it is shown as text.
    pub fn html(&self) -> String {
        let generator = concat!("Made by scanweave ", env!("CARGO_PKG_VERSION"), ".");
        let mut body = String::new();
        for (at, section) in self.sections.iter().enumerate() {
            section.write(at, &mut body);
        }
        let headline = escaped(&self.headline);
        let values = [
            ("title", escaped(&format!("{}: {}", self.brand, self.headline))),
            ("brand", escaped(&self.brand)),
            ("headline", headline),
            ("note", escaped(&self.note)),
            ("body", body),
            ("generator", escaped(generator)),
        ];
        filled(TEMPLATE, &values.each_ref().map(|(name, value)| (*name, value.as_str())))
    }
}

impl Section {
    // Writing into a `String` cannot fail.
    fn write(&self, at: usize, out: &mut String) {
        let title = escaped(&self.title);
        writeln!(out, "<section aria-labelledby=\"part-{at}\">\n<h2 id=\"part-{at}\">{title}</h2>").ok();
        if !self.text.is_empty() {
            writeln!(out, "<p>{}</p>", escaped(&self.text)).ok();
        }
        for block in &self.blocks {
            block.write(&title, out);
        }
        out.push_str("</section>\n");
    }
}

impl Block {
    /// `title` is the heading above, escaped.
    fn write(&self, title: &str, out: &mut String) {
        match self {
            Self::Figures(figures) => {
                out.push_str("<ul class=\"big\">\n");
                for (figure, what) in figures {
                    let (figure, what) = (escaped(figure), escaped(what));
                    writeln!(out, "<li><strong>{figure}</strong> <span>{what}</span></li>").ok();
                }
                out.push_str("</ul>\n");
            }
            Self::Text(text) => {
                writeln!(out, "<p>{}</p>", escaped(text)).ok();
            }
            Self::Grid(grid) => table(grid, title, out),
            Self::Folded(text, grid) => {
                let text = escaped(text);
                writeln!(out, "<details><summary>{text}</summary>").ok();
                table(grid, &text, out);
                out.push_str("</details>\n");
            }
            Self::Picture(svg, caption) => {
                let caption = escaped(caption);
                writeln!(
                    out,
                    "<figure><div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"{caption}\">\n{svg}\
                     </div><figcaption>{caption}</figcaption></figure>"
                )
                .ok();
            }
        }
    }
}

/// Whether the cells of a column are numbers, as far as there are any.
fn is_number(grid: &Grid, column: usize) -> bool {
    let cells = || grid.rows.iter().filter_map(|r| r.cells.get(column)).filter(|c| !c.is_empty());
    let number = |c: &String| c.starts_with(|c: char| c.is_ascii_digit() || "-\u{2013}\u{221e}".contains(c));
    column >= grid.left && cells().all(number)
}

/// `name` is what a table is called for those who do not see it, escaped.
fn table(grid: &Grid, name: &str, out: &mut String) {
    let class = |column: usize| if is_number(grid, column) { "number" } else { "text" };
    writeln!(
        out,
        "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"{name}\"><table>\n<thead><tr>"
    )
    .ok();
    for (c, head) in grid.head.iter().enumerate() {
        writeln!(out, "<th scope=\"col\" class=\"{}\">{}</th>", class(c), escaped(head)).ok();
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    for row in &grid.rows {
        out.push_str(if row.quoted { "<tr class=\"quoted\">" } else { "<tr>" });
        for (c, cell) in row.cells.iter().enumerate() {
            let cell = escaped(cell);
            match c {
                0 => write!(out, "<th scope=\"row\" class=\"{}\">{cell}</th>", class(c)).ok(),
                _ => write!(out, "<td class=\"{}\">{cell}</td>", class(c)).ok(),
            };
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
