//! `overlap.csv`: predicted and verified overlap of every pair of scans.

use super::poses::{Document, EntryOutcome};
use crate::error::{Error, Result};
use crate::io;
use crate::scan::SimilarityMatrix;
use std::path::Path;

const HEAD: [&str; 4] = ["scan_a", "scan_b", "predicted", "verified"];

/// A line for every pair of scans, by their numbers: the overlap predicted before registration,
/// and, where both are placed and touch, that measured at the final poses.
pub fn csv(similarity: &SimilarityMatrix, document: &Document) -> String {
    let n = similarity.len();
    let verified = |i: usize, j: usize| match &document.scans.get(i)?.outcome {
        EntryOutcome::Placed(pose) => pose.neighbours.iter().find(|n| n.scan.0 == j).map(|n| n.overlap),
        EntryOutcome::Declined { .. } => None,
    };
    let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j)));
    let rows = pairs.map(|(i, j)| {
        let measured = verified(i, j).or_else(|| verified(j, i));
        let measured = measured.map(|o| format!("{o:.4}")).unwrap_or_default();
        format!("{i},{j},{:.4},{measured}\n", similarity.get(i, j))
    });
    std::iter::once(HEAD.join(",") + "\n").chain(rows).collect()
}

/// The predicted overlap of `n` scans from the file that [`csv`] made.
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] for another file or one that lacks a pair.
pub fn read_predicted(path: &Path, n: usize) -> Result<SimilarityMatrix> {
    let text = io::regular_text(path)?;
    let expected = || format!("'{}' and a line for every pair of {n} scans", HEAD.join(","));
    let refuse = |found: String| Error::file(path, found, expected(), "register again, or remove the file");
    let mut lines = text.lines().enumerate();
    if lines.next().map(|l| l.1) != Some(&HEAD.join(",")) {
        return Err(refuse("another first line".to_owned()));
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
    use crate::scan::{DeclineReason, NeighbourEvidence, Outcome, Placement, Reconstruction, Scan, ScanId};

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
        let touching = vec![NeighbourEvidence { scan: ScanId(0), overlap: 0.375, residual_m: 0.1 }];
        let declined = Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 0, needed: 3 });
        let outcomes = vec![placed(Vec::new()), placed(touching), declined];
        let document = Document::new(&[scan(0), scan(1), scan(2)], &Reconstruction { outcomes }, 0.07);
        let predicted =
            SimilarityMatrix::new(3, vec![0.0, 0.5, 0.25, 0.5, 0.0, 0.125, 0.25, 0.125, 0.0]).unwrap();
        let text = csv(&predicted, &document);
        assert_eq!(text, "scan_a,scan_b,predicted,verified\n0,1,0.5000,0.3750\n0,2,0.2500,\n1,2,0.1250,\n");
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("overlap.csv");
        std::fs::write(&path, &text).unwrap();
        assert_eq!(read_predicted(&path, 3).unwrap(), predicted);
        for (bad, n) in [(text.as_str(), 4), (text.as_str(), 2), ("a,b\n", 0), ("", 0)] {
            std::fs::write(&path, bad).unwrap();
            assert!(read_predicted(&path, n).unwrap_err().to_string().contains("overlap.csv"));
        }
        std::fs::write(&path, text.replace("0.25", "x")).unwrap();
        assert!(read_predicted(&path, 3).unwrap_err().to_string().contains("line 3"));
    }
}
