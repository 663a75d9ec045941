//! Numbers with marks between their thousands.

use super::grammar::Grammar;
use crate::error::{Error, Result};
use crate::printable::printable_start;
use std::path::Path;

/// Refuses numbers with marks between their thousands, which leave it open what each mark means.
pub(super) fn refuse(path: &Path, lines: &[&str], grammar: &Grammar) -> Result<()> {
    let mut fields = Vec::new();
    for line in lines {
        grammar.split(line, &mut fields);
        // Where no line is one of numbers, the grammar says nothing.
        fields.extend(line.split([';', '\t', ' ']));
        if let Some(field) = fields.iter().find(|f| has_thousands(f)) {
            let found =
                format!("numbers with marks between thousands, such as '{}'", printable_start(field, 24));
            let remedy = "export the scan without thousands separators";
            return Err(Error::file(path, found, "numbers with a decimal mark only", remedy));
        }
    }
    Ok(())
}

/// Whether a field is a number as `1,234.5`, `1.234,5` or `1'234.5`.
fn has_thousands(field: &str) -> bool {
    let number = field.trim_matches(['"', ' ']).trim_start_matches(['+', '-']);
    let Some((whole, fraction)) = number.rsplit_once(['.', ',']) else { return false };
    let Some(mark) = whole.chars().find(|c| matches!(c, '.' | ',' | '\'' | '\u{2019}')) else { return false };
    let digits = |s: &str| !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit());
    let mut groups = whole.split(mark);
    !number[whole.len()..].starts_with(mark)
        && digits(fraction)
        && groups.next().is_some_and(|first| digits(first) && first.len() <= 3)
        && groups.all(|group| digits(group) && group.len() == 3)
}
