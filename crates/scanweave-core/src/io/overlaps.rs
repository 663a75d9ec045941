//! `gt_overlap.log`: a line `i,j,overlap` for pairs of scans.

use super::poses::read_text;
use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// Reads the overlaps of pairs of scans, by their numbers.
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] for a line that is not two numbers and a share.
pub fn read_overlaps(path: impl AsRef<Path>) -> Result<BTreeMap<(usize, usize), f32>> {
    let path = path.as_ref();
    let text = read_text(path)?;
    let lines = text.lines().enumerate().map(|(at, l)| (at + 1, l.trim())).filter(|l| !l.1.is_empty());
    lines
        .map(|(number, line)| {
            let words: Vec<&str> = line.split([',', ' ', '\t']).filter(|w| !w.is_empty()).collect();
            let parsed = match words[..] {
                [i, j, overlap] => i.parse().ok().zip(j.parse().ok()).zip(overlap.parse::<f32>().ok()),
                _ => None,
            };
            parsed.filter(|p| (0.0..=1.0).contains(&p.1)).ok_or_else(|| {
                let found = format!("line {number} '{}'", line.chars().take(80).collect::<String>());
                let expected = "two scan numbers and a share between 0 and 1, as in 3,7,0.4211";
                Error::file(path, found, expected, "correct that line, or remove the file")
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_numbers_and_shares() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("gt_overlap.log");
        std::fs::write(&path, "0,1,0.8017\n\n3, 12 , 0\n").unwrap();
        let read = read_overlaps(&path).unwrap();
        assert_eq!(read, BTreeMap::from([((0, 1), 0.8017), ((3, 12), 0.0)]));
        for bad in ["0,1", "0,1,1.5", "a,1,0.5", "0,1,nan"] {
            std::fs::write(&path, format!("0,1,0.5\n{bad}\n")).unwrap();
            let e = read_overlaps(&path).unwrap_err().to_string();
            assert!(e.contains("line 2") && e.contains(bad), "{e}");
        }
    }
}
