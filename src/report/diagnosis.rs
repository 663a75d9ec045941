//! A diagnosis as text and tables.

use super::grid::{Grid, csv, heads};
use crate::evaluation::diagnosis::{Cause, Diagnosis, PairFinding, ScanFinding};
use std::fmt::Write;

const SCAN_COLUMNS: [&str; 15] = [
    "scan",
    "component",
    "step",
    "parent",
    "cause",
    "began_with",
    "join_error_m",
    "final_error_m",
    "pivot_error_m",
    "matches",
    "inliers",
    "probability",
    "best_before",
    "best_after",
    "reason",
];
const PAIR_COLUMNS: [&str; 8] =
    ["benchmark", "i", "j", "rmse_m", "overlap", "cause", "carried", "began_with"];

impl Diagnosis {
    /// Failed pairs by cause, and how many of each were carried along by a third scan.
    pub fn counts(&self) -> Vec<(Cause, usize, usize)> {
        let of = |cause: Cause| {
            let pairs = || self.pairs.iter().filter(move |p| p.cause == cause);
            (cause, pairs().count(), pairs().filter(|p| p.carried).count())
        };
        Cause::ALL.into_iter().map(of).filter(|c| c.1 > 0).collect()
    }

    fn name(&self, scan: usize) -> String {
        self.scans.get(scan).map(|s| s.scan.clone()).unwrap_or_default()
    }

    /// Every scan, one line each.
    pub fn scans_csv(&self) -> String {
        let link = |best: Option<(usize, f32)>| {
            best.map(|(scan, overlap)| format!("{} {overlap:.3}", self.name(scan))).unwrap_or_default()
        };
        let row = |s: &ScanFinding| {
            vec![
                s.scan.clone(),
                s.component.map(|v| v.to_string()).unwrap_or_default(),
                s.step.map(|v| v.to_string()).unwrap_or_default(),
                s.parent.map(|p| self.name(p)).unwrap_or_default(),
                s.cause.map(|c| c.name().to_owned()).unwrap_or_default(),
                s.origin.map(|o| self.name(o)).unwrap_or_default(),
                number(s.join_error_m),
                number(s.final_error_m),
                number(s.pivot_error_m),
                s.matches.to_string(),
                s.inliers.to_string(),
                number(s.probability),
                link(s.best_before),
                link(s.best_after),
                s.reason.clone().unwrap_or_default(),
            ]
        };
        csv(&SCAN_COLUMNS, &self.scans.iter().map(row).collect::<Vec<_>>())
    }

    /// Every failed pair, one line each.
    pub fn pairs_csv(&self) -> String {
        csv(&PAIR_COLUMNS, &self.pair_rows())
    }

    fn pair_rows(&self) -> Vec<Vec<String>> {
        let row = |p: &PairFinding| {
            vec![
                p.benchmark.clone(),
                p.i.to_string(),
                p.j.to_string(),
                number(p.rmse_m),
                format!("{:.3}", p.overlap),
                p.cause.name().to_owned(),
                if p.carried { "yes" } else { "no" }.to_owned(),
                self.name(p.scan),
            ]
        };
        self.pairs.iter().map(row).collect()
    }

    /// What went wrong first and what it cost, then every failed pair.
    pub fn markdown(&self, title: &str) -> String {
        let mut text = format!("# {title}\n\n");
        if self.pairs.is_empty() {
            text.push_str("No pair failed.\n");
            return text;
        }
        let counts: Vec<String> = self
            .counts()
            .into_iter()
            .map(|(cause, all, carried)| match carried {
                0 => format!("{} {all}", cause.name()),
                _ => format!("{} {all} ({carried} carried along)", cause.name()),
            })
            .collect();
        writeln!(
            text,
            "{} failed pairs: {}. Errors beyond {} m are wrong.\n",
            self.pairs.len(),
            counts.join(", "),
            self.limit_m
        )
        .ok();
        text.push_str("## What went wrong first\n\n");
        text.push_str(&self.origins().markdown());
        text.push_str("\n## Failed pairs\n\n");
        text.push_str(&self.failed_pairs().markdown());
        text
    }

    /// Every failed pair.
    pub fn failed_pairs(&self) -> Grid {
        Grid::new(PAIR_COLUMNS.map(|c| c.replace('_', " ")).to_vec(), 1, self.pair_rows())
    }

    /// One row for every scan (and cause) that failed pairs began with, the costliest first.
    pub fn origins(&self) -> Grid {
        let mut groups: Vec<(usize, Cause, usize)> = Vec::new();
        for pair in &self.pairs {
            match groups.iter_mut().find(|g| (g.0, g.1) == (pair.scan, pair.cause)) {
                Some(group) => group.2 += 1,
                None => groups.push((pair.scan, pair.cause, 1)),
            }
        }
        groups.sort_by_key(|&(scan, cause, pairs)| (std::cmp::Reverse(pairs), cause, scan));
        let row = |&(scan, cause, pairs): &(usize, Cause, usize)| {
            let step = self.scans.get(scan).and_then(|s| s.step).map(|s| s.to_string()).unwrap_or_default();
            vec![
                self.name(scan),
                cause.name().to_owned(),
                pairs.to_string(),
                step,
                self.evidence(scan, cause),
            ]
        };
        let head = heads(&["scan", "cause", "failed pairs", "step", "evidence"]);
        Grid::new(head, 5, groups.iter().map(row).collect())
    }

    /// Why that scan counts as the first that went wrong, in a sentence.
    fn evidence(&self, scan: usize, cause: Cause) -> String {
        let Some(s) = self.scans.get(scan) else { return String::new() };
        if let Some(reason) = &s.reason {
            return reason.clone();
        }
        let mut text = match s.parent {
            Some(parent) => format!("joined to {}", self.name(parent)),
            None => "began its component".to_owned(),
        };
        if let (Some(_), true) = (s.parent, s.matches > 0) {
            write!(text, " by {} of {} matches", s.inliers, s.matches).ok();
        }
        if let Some(p) = s.probability {
            write!(text, ", probability {p:.2}").ok();
        }
        if let Some(error) = s.join_error_m {
            write!(text, "; {error:.2} m off when it joined").ok();
        }
        if let Some(error) = s.final_error_m {
            write!(text, "{} {error:.2} m at the end", if s.join_error_m.is_some() { "," } else { ";" }).ok();
        }
        if let Some((other, overlap)) = s.best_before {
            write!(text, "; true overlap {overlap:.2} with {} in the model", self.name(other)).ok();
        }
        if let (Cause::WrongOrder | Cause::OtherComponent, Some((other, overlap))) = (cause, s.best_after) {
            write!(
                text,
                "; true overlap {overlap:.2} with {}, which was not in the model then",
                self.name(other)
            )
            .ok();
        }
        text
    }
}

fn number(value: Option<f64>) -> String {
    value.map(|v| format!("{v:.3}")).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_costliest_mistake_comes_first_with_its_evidence() {
        let scan = |name: &str, step: usize, parent: Option<usize>| ScanFinding {
            scan: name.to_owned(),
            component: Some(0),
            step: Some(step),
            parent,
            cause: None,
            origin: None,
            join_error_m: None,
            final_error_m: None,
            pivot_error_m: None,
            matches: 0,
            inliers: 0,
            probability: None,
            best_before: None,
            best_after: None,
            reason: None,
        };
        let mut scans = vec![scan("zero", 0, None), scan("one", 1, Some(0)), scan("two", 2, Some(1))];
        (scans[1].cause, scans[1].origin, scans[1].matches, scans[1].inliers) =
            (Some(Cause::WrongOrder), Some(1), 310, 83);
        (scans[1].join_error_m, scans[1].final_error_m) = (Some(0.574), Some(0.6));
        (scans[1].best_before, scans[1].best_after) = (Some((0, 0.12)), Some((2, 0.5)));
        (scans[2].component, scans[2].reason) = (None, Some("no keypoints".to_owned()));
        let pair = |j: usize, cause: Cause, scan: usize, carried: bool| PairFinding {
            benchmark: "b".to_owned(),
            i: 0,
            j,
            rmse_m: (cause != Cause::Declined).then_some(0.5),
            overlap: 0.25,
            cause,
            scan,
            carried,
        };
        let pairs = vec![
            pair(2, Cause::Declined, 2, false),
            pair(1, Cause::WrongOrder, 1, false),
            pair(3, Cause::WrongOrder, 1, true),
        ];
        let found = Diagnosis { limit_m: 0.2, scans, pairs };
        assert_eq!(found.counts(), [(Cause::Declined, 1, 0), (Cause::WrongOrder, 2, 1)]);
        let text = found.markdown("title");
        assert!(text.contains("3 failed pairs: declined 1, wrong order 2 (1 carried along)."), "{text}");
        let (one, two) = (text.find("| one ").unwrap(), text.find("| two ").unwrap());
        assert!(one < two, "{text}");
        for said in [
            "joined to zero by 83 of 310 matches; 0.57 m off when it joined, 0.60 m at the end",
            "true overlap 0.12 with zero in the model; true overlap 0.50 with two, which was not",
            "no keypoints",
        ] {
            assert!(text.contains(said), "{said} is missing in {text}");
        }
        assert_eq!(found.pairs_csv().lines().nth(1), Some("b,0,2,,0.250,declined,no,two"));
        let line = found.scans_csv().lines().nth(2).unwrap().to_owned();
        assert_eq!(line, "one,0,1,zero,wrong order,one,0.574,0.600,,310,83,,zero 0.120,two 0.500,");
    }
}
