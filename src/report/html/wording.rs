//! The result in words, for readers new to registration.

use crate::result::{Document, EntryOutcome};
use crate::scan::DeclineReason;

/// Below this probability of being right the best fit only shows that there is none.
const UNLIKELY: f64 = 0.1;

/// One sentence or two that say how many scans were placed, in how many models, and how many were
/// left out.
pub fn headline(document: &Document) -> String {
    let total = document.scans.len();
    let placed: Vec<_> = document
        .scans
        .iter()
        .filter_map(|e| match &e.outcome {
            EntryOutcome::Placed(pose) => Some(pose),
            EntryOutcome::Declined { .. } => None,
        })
        .collect();
    if placed.iter().all(|p| p.parent.is_none()) {
        return format!("No two of the {total} scans could be joined.");
    }
    let counted = match placed.len() {
        n if n == total => format!("All {total} scans placed"),
        n => format!("{n} of {total} scans placed"),
    };
    let sizes: Vec<String> = document.components.iter().map(|c| c.scans.len().to_string()).collect();
    let models = match &sizes[..] {
        [] | [_] => " in one model".to_owned(),
        [first @ .., last] => format!(
            ", but in {} separate models that found no join with each other (of {} and {last} scans)",
            sizes.len(),
            first.join(", ")
        ),
    };
    let left = match total - placed.len() {
        0 => ".".to_owned(),
        1 => "; one was left out.".to_owned(),
        n => format!("; {n} were left out."),
    };
    counted + &models + &left
}

/// Why a scan was left out, in plain words.
pub(super) fn plain(reason: &DeclineReason) -> String {
    match reason {
        DeclineReason::TooFewInliers { inliers, needed, matches: _ } if *inliers < 4 => format!(
            "It matches no other scan: nothing above chance was found ({inliers} points agreed on a \
             position, {needed} are needed). It probably shows another place, or overlaps too little."
        ),
        DeclineReason::TooFewInliers { inliers, needed, matches } => format!(
            "It hardly matches any other scan: of {matches} points that looked alike, {inliers} agreed on \
             one position, and {needed} are needed. It probably shows another place, or overlaps too little."
        ),
        DeclineReason::WeakEvidence { evidence, needed } => {
            let chance = evidence.probability.unwrap_or(0.0);
            let outcome = match chance {
                c if c < UNLIKELY => "It probably shows another place, or overlaps too little",
                _ => "Its best fit is too doubtful",
            };
            format!(
                "{outcome}: its best position is right with a chance of {}, where {} is needed. {} points \
                 agreed on that position, {} on the next best one, and {} of its surface touches the rest.",
                percent(chance),
                percent(*needed),
                evidence.inliers,
                evidence.second_best_inliers,
                percent(evidence.overlap),
            )
        }
        DeclineReason::Pruned { inliers, median_distance_m } => format!(
            "All its fits with single scans were too poor to keep: the best one, with {inliers} points in \
             agreement, leaves the surfaces {:.1} cm apart.",
            median_distance_m * 100.0
        ),
        DeclineReason::TooFewKeypoints { keypoints, needed } => format!(
            "It has too few points to work with: {keypoints} places on it could be described, {needed} are needed."
        ),
        DeclineReason::Degenerate { detail } => {
            format!("Its shape does not fix a position: {detail}.")
        }
        other => format!("It was left out: {other}."),
    }
}

/// A share in whole percent; a small one is not rounded to nothing.
fn percent(share: f64) -> String {
    match 100.0 * share {
        p if p > 0.0 && p < 1.0 => "below 1\u{a0}%".to_owned(),
        p => format!("{p:.0}\u{a0}%"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{document, placed};
    use super::*;
    use crate::geometry::RigidMotion;
    use crate::result::Component;
    use crate::scan::{Evidence, Outcome};

    #[test]
    fn the_headline_counts_scans_models_and_what_was_left_out() {
        let scan = |component: usize, parent: bool| {
            let mut p = placed(RigidMotion::identity(), usize::from(parent), parent.then_some(0));
            p.component = component;
            Outcome::Placed(p)
        };
        let lost = || Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 0, needed: 3 });
        let said = |verdicts| headline(&document(verdicts));
        assert_eq!(said(vec![scan(0, false), scan(0, true)]), "All 2 scans placed in one model.");
        assert_eq!(
            said(vec![scan(0, false), scan(0, true), lost()]),
            "2 of 3 scans placed in one model; one was left out."
        );
        let mut two =
            document(vec![scan(0, false), scan(0, true), scan(1, false), scan(1, true), lost(), lost()]);
        assert_eq!(two.components[1], Component { pivot: Some(2), scans: vec![2, 3] });
        assert_eq!(
            headline(&two),
            "4 of 6 scans placed, but in 2 separate models that found no join with each other \
             (of 2 and 2 scans); 2 were left out."
        );
        two.scans.truncate(0);
        assert_eq!(said(vec![scan(0, false), lost()]), "No two of the 2 scans could be joined.");
        assert_eq!(said(vec![lost(), lost(), lost()]), "No two of the 3 scans could be joined.");
    }

    #[test]
    fn reasons_tell_what_was_found_and_what_was_needed() {
        let mut evidence = Evidence::default();
        evidence.inliers = 14;
        evidence.second_best_inliers = 12;
        evidence.overlap = 0.004;
        evidence.probability = Some(0.31);
        let cases = [
            (
                DeclineReason::TooFewInliers { inliers: 2, needed: 8, matches: 90 },
                vec!["2 points", "8 are needed"],
            ),
            (
                DeclineReason::TooFewInliers { inliers: 6, needed: 8, matches: 90 },
                vec!["of 90", "6 agreed", "and 8"],
            ),
            (
                DeclineReason::WeakEvidence { evidence, needed: 0.5 },
                vec!["too doubtful", "31\u{a0}%", "50\u{a0}%", "14 points", "12 on", "below 1\u{a0}%"],
            ),
            (DeclineReason::Pruned { inliers: 9, median_distance_m: 0.123 }, vec!["9 points", "12.3 cm"]),
            (DeclineReason::TooFewKeypoints { keypoints: 1, needed: 3 }, vec!["1 places", "3 are"]),
            (DeclineReason::Degenerate { detail: "all on one line".into() }, vec!["all on one line"]),
        ];
        for (reason, expected) in cases {
            let text = plain(&reason);
            for part in expected {
                assert!(text.contains(part), "{part} is missing in {text}");
            }
        }
    }
}
