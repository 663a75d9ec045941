//! `overlap.csv`: predicted and verified overlap of every pair of scans.

use super::poses::{Document, EntryOutcome};
use crate::error::{Error, Result};
use crate::monitor::Monitor;
use crate::scan::SimilarityMatrix;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

const HEAD: [&str; 4] = ["scan_a", "scan_b", "predicted", "verified"];

/// Writes a line for every pair of scans, by their numbers: the overlap predicted before registration,
/// and, where both are placed and touch, that measured at the final poses. Ten thousand scans have fifty
/// million pairs: they are not held as text.
///
/// # Errors
/// Those of `out`; [`io::ErrorKind::Interrupted`] where the monitor is cancelled.
pub fn write_overlaps_csv(
    out: &mut impl Write,
    similarity: &SimilarityMatrix,
    document: &Document,
    monitor: &dyn Monitor,
) -> io::Result<()> {
    let n = similarity.len();
    let verified = verified(document);
    let numbers: Vec<String> = (0..n).map(|i| format!("{i},")).collect();
    out.write_all((HEAD.join(",") + "\n").as_bytes())?;
    let mut rows = Vec::new();
    for (i, row) in (0..n).map(|i| (i, similarity.row(i))) {
        if monitor.cancelled() {
            return Err(io::ErrorKind::Interrupted.into());
        }
        rows.clear();
        let mut measured = verified.range((i, 0)..(i + 1, 0)).peekable();
        for (number, (j, &predicted)) in numbers.iter().zip(row.iter().enumerate()).skip(i + 1) {
            rows.extend_from_slice(numbers[i].as_bytes());
            rows.extend_from_slice(number.as_bytes());
            match ten_thousandths(predicted) {
                Some(digits) => {
                    let digit = |unit: u32| b'0' + (digits / unit % 10) as u8;
                    rows.extend([digit(10_000), b'.', digit(1000), digit(100), digit(10), digit(1)]);
                }
                None => write!(rows, "{predicted:.4}")?,
            }
            rows.push(b',');
            if let Some((_, overlap)) = measured.next_if(|(pair, _)| pair.1 == j) {
                write!(rows, "{overlap:.4}")?;
            }
            rows.push(b'\n');
        }
        out.write_all(&rows)?;
    }
    Ok(())
}

/// The overlap measured at the final poses, of pairs of placed scans that touch, the lower number first.
fn verified(document: &Document) -> BTreeMap<(usize, usize), f64> {
    let mut verified = BTreeMap::new();
    // What the scan with the lower number says comes last, and stands.
    for (i, entry) in document.scans.iter().enumerate().rev() {
        let EntryOutcome::Placed(pose) = &entry.outcome else { continue };
        // Of a scan that is named twice the first.
        for neighbour in pose.neighbours.iter().rev() {
            let j = neighbour.scan.0;
            verified.insert((i.min(j), i.max(j)), neighbour.overlap);
        }
    }
    verified
}

/// A predicted overlap in ten thousandths, the digits that are written of it; none where it is below 0, or
/// has a digit more before the point.
pub fn ten_thousandths(overlap: f32) -> Option<u32> {
    // Exact: 24 bits of the number and 10 of the factor are fewer than those of a double.
    let digits = (f64::from(overlap) * 1e4).round_ties_even();
    (overlap.is_sign_positive() && digits < 1e5).then_some(digits as u32)
}

/// The predicted overlap of `n` scans from the file that [`write_overlaps_csv`] made.
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] for another file or one that lacks a pair.
pub fn read_predicted_overlaps(path: &Path, n: usize) -> Result<SimilarityMatrix> {
    let text = crate::files::read_text(path)?;
    let expected = || format!("'{}' and a line for every pair of {n} scans", HEAD.join(","));
    let refuse = |found: String| Error::file(path, found, expected(), "register again, or remove the file");
    let mut lines = text.lines().enumerate();
    if lines.next().map(|l| l.1) != Some(&HEAD.join(",")) {
        return Err(refuse("another first line".to_owned()));
    }
    // A line for every pair, each of six characters at least: the file has room for what is reserved.
    let pairs_in_all = n.saturating_mul(n.saturating_sub(1)) / 2;
    if pairs_in_all.saturating_mul(6) > text.len() {
        return Err(refuse(format!("{} bytes", text.len())));
    }
    let mut values = vec![0.0f32; n * n];
    let mut pairs = 0;
    for (at, line) in lines {
        let mut cells = line.split(',');
        let mut next = || cells.next().unwrap_or_default();
        let parsed = (next().parse::<usize>(), next().parse::<usize>(), next().parse::<f32>());
        let (Ok(i), Ok(j), Ok(value)) = parsed else {
            return Err(refuse(format!("line {} '{}'", at + 1, line.chars().take(80).collect::<String>())));
        };
        if i >= j || j >= n {
            return Err(refuse(format!("the pair {i}, {j} in line {}", at + 1)));
        }
        (values[i * n + j], values[j * n + i]) = (value, value);
        pairs += 1;
    }
    if pairs != n * n.saturating_sub(1) / 2 {
        return Err(refuse(format!("{pairs} pairs")));
    }
    SimilarityMatrix::new(n, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::RigidMotion;
    use crate::monitor::Silent;
    use crate::scan::{DeclineReason, NeighbourEvidence, Outcome, Placement, Reconstruction, Scan, ScanId};

    #[test]
    fn digits_are_those_of_the_formatter() {
        // Ties (a half in binary), ends of the range, what is next to them, and values all over.
        let ties = [0.00005, 0.5, 0.03125, 0.00390625, 0.999_95, 1.0, 9.99994, 9.999_95, 9.99996, 0.0];
        let spread = (0..20_000u32).map(|k| f32::from_bits(k.wrapping_mul(0x9E37_79B9) >> 2));
        for value in ties.into_iter().chain(spread).filter(|v| v.is_finite() && *v < 20.0) {
            let written = format!("{value:.4}");
            let digits = ten_thousandths(value).map(|d| format!("{}.{:04}", d / 10_000, d % 10_000));
            assert_eq!(digits.as_deref(), (value < 9.999_95).then_some(written.as_str()), "{value:?}");
        }
        assert_eq!([ten_thousandths(-0.0), ten_thousandths(-1e-9), ten_thousandths(12.0)], [None; 3]);
    }

    #[test]
    fn predicted_and_verified_stand_side_by_side_and_the_prediction_reads_back() {
        let scan = |i| Scan { id: ScanId(i), name: i.to_string(), ..Scan::default() };
        let placed = |neighbours| {
            Outcome::Placed(Placement {
                world_from_scan: RigidMotion::identity(),
                component: 0,
                step: 0,
                parent: None,
                matches: 0,
                inliers: 0,
                residual_m: 0.0,
                evidence: None,
                pose_uncertainty: None,
                neighbours,
            })
        };
        let touching = vec![NeighbourEvidence {
            scan: ScanId(0),
            overlap: 0.375,
            residual_m: 0.1,
            plane_distance_m: None,
        }];
        let declined = Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 0, needed: 3 });
        let outcomes = vec![placed(Vec::new()), placed(touching), declined];
        let document = Document::new(&[scan(0), scan(1), scan(2)], &Reconstruction { outcomes }, 0.07);
        let predicted =
            SimilarityMatrix::new(3, vec![0.0, 0.5, 0.25, 0.5, 0.0, 0.125, 0.25, 0.125, 0.0]).unwrap();
        let mut text = Vec::new();
        write_overlaps_csv(&mut text, &predicted, &document, &Silent).unwrap();
        let text = String::from_utf8(text).unwrap();
        assert_eq!(text, "scan_a,scan_b,predicted,verified\n0,1,0.5000,0.3750\n0,2,0.2500,\n1,2,0.1250,\n");
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("overlap.csv");
        std::fs::write(&path, &text).unwrap();
        assert_eq!(read_predicted_overlaps(&path, 3).unwrap(), predicted);
        for (bad, n) in [(text.as_str(), 4), (text.as_str(), 2), ("a,b\n", 0), ("", 0)] {
            std::fs::write(&path, bad).unwrap();
            assert!(read_predicted_overlaps(&path, n).unwrap_err().to_string().contains("overlap.csv"));
        }
        std::fs::write(&path, text.replace("0.25", "x")).unwrap();
        assert!(read_predicted_overlaps(&path, 3).unwrap_err().to_string().contains("line 3"));
    }
}
