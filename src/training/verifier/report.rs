//! What a verifier was trained on and how good it is on kinds that it was not.

use super::fit::{fit, loss};
use super::{Candidate, KindCandidates, VerifierRecipe};
use crate::registration::EvidenceWeights;
use crate::report::chart::{self, Panel, Series};
use crate::{Error, Result, files};
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// Probability from which a candidate counts as accepted, and as surely so.
const THRESHOLDS: [f64; 2] = [0.6, 0.9];

/// Bins of the reliability.
const BINS: usize = 10;

/// Right and wrong candidates with at least some probability.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Accepted {
    /// Right ones.
    pub right: usize,
    /// Wrong ones.
    pub wrong: usize,
}

/// What weights make of candidates.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Judgement {
    /// Mean of −ln p of what is true.
    pub log_loss: f64,
    /// At a probability of 0.6 and more.
    pub accepted: Accepted,
    /// At 0.9 and more.
    pub sure: Accepted,
}

/// A kind, judged by the given weights and by those learned from all others.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KindRow {
    /// Name of the kind.
    pub kind: String,
    /// Folders of its scans, relative to the data root; none of a synthetic place.
    pub folders: Vec<String>,
    /// Candidates with a label.
    pub candidates: usize,
    /// Right ones of them.
    pub right: usize,
    /// By the given weights; none without a candidate.
    pub given: Option<Judgement>,
    /// By the weights that were learned without the kind.
    pub left_out: Option<Judgement>,
}

/// Candidates whose probability, by weights learned without their kind, is in one tenth of `[0, 1]`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct ReliabilityBin {
    /// Least probability.
    pub from: f64,
    /// Candidates.
    pub candidates: usize,
    /// Their mean probability.
    pub stated: f64,
    /// Share of right ones.
    pub right: f64,
}

/// What the left-out kinds lose, or gain, without one predictor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PredictorRow {
    /// Name of its weight.
    pub predictor: String,
    /// Mean log loss over the kinds, each judged by weights learned from the others without the predictor.
    pub log_loss: f64,
    /// All kinds' candidates at a probability of 0.6 and more.
    pub accepted: Accepted,
    /// At 0.9 and more.
    pub sure: Accepted,
}

/// A trained verifier and its judgement; as JSON it is what is shipped.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VerifierReport {
    format: &'static str,
    version: u32,
    /// The learned weights by name, to four decimals.
    #[serde(serialize_with = "by_name")]
    pub weights: EvidenceWeights,
    /// The weights that the ridge drew to.
    #[serde(serialize_with = "by_name")]
    pub given: EvidenceWeights,
    /// Every kind, left out in turn.
    pub kinds: Vec<KindRow>,
    /// Mean log loss over the kinds that have candidates: of the given weights, and left out.
    pub mean_log_loss: [f64; 2],
    /// Reliability of the left-out probabilities.
    pub reliability: Vec<ReliabilityBin>,
    /// The same without each predictor.
    pub without_predictor: Vec<PredictorRow>,
    /// How it was trained.
    pub recipe: VerifierRecipe,
}

fn by_name<S: serde::Serializer>(
    weights: &EvidenceWeights,
    serializer: S,
) -> std::result::Result<S::Ok, S::Error> {
    serializer.collect_map(EvidenceWeights::NAMES.into_iter().zip(weights.as_array()))
}

impl VerifierReport {
    /// Names of the files of a training run, the last to be written first.
    pub const FILES: [&'static str; 3] = ["verifier.json", "reliability.svg", "recipe.toml"];

    /// Fits weights to all kinds, and for each to all others.
    pub(super) fn new(recipe: &VerifierRecipe, kinds: &[KindCandidates]) -> Self {
        let weights = rounded(&fit(kinds, &recipe.given, recipe.ridge, None));
        let mut rows = Vec::new();
        let mut left_out_probabilities: Vec<(f64, bool)> = Vec::new();
        for (at, kind) in kinds.iter().enumerate() {
            let without = fitted_without(recipe, kinds, at, None);
            left_out_probabilities
                .extend(kind.candidates.iter().map(|c| (probability(log_odds(&without, c)), c.right)));
            rows.push(KindRow {
                kind: kind.name.clone(),
                // Spelled alike on every system.
                folders: kind.folders.iter().map(|f| f.to_string_lossy().replace('\\', "/")).collect(),
                candidates: kind.candidates.len(),
                right: kind.candidates.iter().filter(|c| c.right).count(),
                given: judge(&kind.candidates, &recipe.given),
                left_out: judge(&kind.candidates, &without),
            });
        }
        let mean = |of: fn(&KindRow) -> Option<Judgement>| {
            let losses: Vec<f64> = rows.iter().filter_map(of).map(|j| j.log_loss).collect();
            losses.iter().sum::<f64>() / losses.len().max(1) as f64
        };
        Self {
            format: "scanweave-verifier",
            version: 1,
            weights,
            given: recipe.given.clone(),
            mean_log_loss: [mean(|r| r.given), mean(|r| r.left_out)],
            kinds: rows,
            reliability: reliability(&left_out_probabilities),
            without_predictor: (1..EvidenceWeights::NAMES.len())
                .into_par_iter()
                .map(|predictor| PredictorRow::new(recipe, kinds, predictor))
                .collect(),
            recipe: recipe.clone(),
        }
    }

    /// The tables that the command prints.
    pub fn table(&self) -> String {
        let mut text = String::new();
        let wide = self.kinds.iter().map(|r| r.kind.len()).max().unwrap_or(0).max(12);
        // Writing to a string never fails.
        let _ = writeln!(
            text,
            "every kind by the given weights | by those learned without it; accepted as right/wrong\n\
             {:wide$} {:>10} {:>6}   {:^15}   {:^23}   {:^23}",
            "kind", "candidates", "right", "log loss", "p >= 0.6", "p >= 0.9"
        );
        let both = |a: Accepted, b: Accepted| {
            format!("{:>5}/{:<5} | {:>5}/{:<5}", a.right, a.wrong, b.right, b.wrong)
        };
        let mut sums = [Accepted::default(); 4];
        for row in &self.kinds {
            let _ = write!(text, "{:wide$} {:>10} {:>6}", row.kind, row.candidates, row.right);
            if let (Some(given), Some(without)) = (&row.given, &row.left_out) {
                let cells = [given.accepted, without.accepted, given.sure, without.sure];
                for (sum, cell) in sums.iter_mut().zip(cells) {
                    *sum = Accepted { right: sum.right + cell.right, wrong: sum.wrong + cell.wrong };
                }
                let losses = format!("{:>6.3} | {:<6.3}", given.log_loss, without.log_loss);
                let _ =
                    write!(text, "   {losses}   {}   {}", both(cells[0], cells[1]), both(cells[2], cells[3]));
            }
            text.push('\n');
        }
        let (candidates, right) =
            self.kinds.iter().fold((0, 0), |(n, r), row| (n + row.candidates, r + row.right));
        let losses = format!("{:>6.3} | {:<6.3}", self.mean_log_loss[0], self.mean_log_loss[1]);
        let _ = writeln!(
            text,
            "{:wide$} {candidates:>10} {right:>6}   {losses}   {}   {}",
            "mean, sums",
            both(sums[0], sums[1]),
            both(sums[2], sums[3])
        );
        let _ = writeln!(
            text,
            "\nreliability of the left-out probabilities\n{:>10} {:>10} {:>8} {:>8}",
            "p", "candidates", "stated", "right"
        );
        for bin in &self.reliability {
            let range = format!("{:.1} to {:.1}", bin.from, bin.from + 1.0 / BINS as f64);
            let _ =
                writeln!(text, "{range:>10} {:>10} {:>8.3} {:>8.3}", bin.candidates, bin.stated, bin.right);
        }
        let _ = writeln!(
            text,
            "\nwithout each predictor, kinds left out\n{:22} {:>9} {:>13} {:>13}",
            "predictor", "log loss", "p >= 0.6", "p >= 0.9"
        );
        for row in &self.without_predictor {
            let [accepted, sure] = [row.accepted, row.sure].map(|a| format!("{}/{}", a.right, a.wrong));
            let _ = writeln!(text, "{:22} {:>9.3} {accepted:>13} {sure:>13}", row.predictor, row.log_loss);
        }
        let _ = writeln!(text, "\n{:22} {:>9} {:>9}", "weight", "given", "learned");
        let weights = self.given.as_array().into_iter().zip(self.weights.as_array());
        for (name, (given, learned)) in EvidenceWeights::NAMES.into_iter().zip(weights) {
            let _ = writeln!(text, "{name:22} {given:>9.4} {learned:>9.4}");
        }
        text
    }

    /// Writes recipe.toml, reliability.svg and, last, verifier.json into a folder that exists.
    ///
    /// # Errors
    /// [`Error::Write`] naming the file.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let write =
            |name: &str, text: &str| files::write(&folder.join(name), |out| out.write_all(text.as_bytes()));
        let [verifier, picture, recipe] = Self::FILES;
        write(recipe, &self.recipe.to_toml()?)?;
        let picture_text = chart::svg(&[self.panel()]).map_err(|e| Error::write(folder.join(picture), e))?;
        write(picture, &picture_text)?;
        let text = serde_json::to_string_pretty(self)
            .map_err(|e| Error::write(folder.join(verifier), std::io::Error::other(e)))?;
        write(verifier, &(text + "\n"))
    }

    fn panel(&self) -> Panel {
        let series = |name: &str, points: Vec<(f64, f64)>, line: bool| Series {
            name: name.to_owned(),
            points,
            line,
            spread: Vec::new(),
        };
        let filled = self.reliability.iter().filter(|b| b.candidates > 0);
        Panel {
            title: "kinds by weights learned without them".to_owned(),
            x_label: "stated probability".to_owned(),
            y_label: "share of right candidates".to_owned(),
            x_names: Vec::new(),
            series: vec![
                series("left out", filled.map(|b| (b.stated, b.right)).collect(), true),
                series(
                    "reliable",
                    (0..=20).map(|k| (0.05 * f64::from(k), 0.05 * f64::from(k))).collect(),
                    true,
                ),
            ],
            y_most: 1.0,
        }
    }
}

/// Weights by all kinds but that at `at`, and without the predictor `left_out`.
fn fitted_without(
    recipe: &VerifierRecipe,
    kinds: &[KindCandidates],
    at: usize,
    left_out: Option<usize>,
) -> EvidenceWeights {
    let others = kinds.iter().enumerate().filter(|k| k.0 != at).map(|k| k.1);
    fit(others, &recipe.given, recipe.ridge, left_out)
}

impl PredictorRow {
    fn new(recipe: &VerifierRecipe, kinds: &[KindCandidates], predictor: usize) -> Self {
        let judged: Vec<Judgement> = kinds
            .iter()
            .enumerate()
            .filter_map(|(at, kind)| {
                judge(&kind.candidates, &fitted_without(recipe, kinds, at, Some(predictor)))
            })
            .collect();
        let sum = |of: fn(&Judgement) -> Accepted| {
            judged.iter().map(of).fold(Accepted::default(), |sum, a| Accepted {
                right: sum.right + a.right,
                wrong: sum.wrong + a.wrong,
            })
        };
        Self {
            predictor: EvidenceWeights::NAMES[predictor].to_owned(),
            log_loss: judged.iter().map(|j| j.log_loss).sum::<f64>() / judged.len().max(1) as f64,
            accepted: sum(|j| j.accepted),
            sure: sum(|j| j.sure),
        }
    }
}

/// Weights to four decimals: more of them say nothing, and fewer digits are the same on every machine.
fn rounded(weights: &EvidenceWeights) -> EvidenceWeights {
    // Adding zero turns −0 into 0.
    EvidenceWeights::from_array(weights.as_array().map(|w| (w * 1e4).round() / 1e4 + 0.0))
}

fn log_odds(weights: &EvidenceWeights, candidate: &Candidate) -> f64 {
    let terms = candidate.predictors.iter().zip(weights.as_array()).map(|(x, w)| x * w);
    candidate.offset + terms.sum::<f64>()
}

fn probability(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds).exp())
}

fn judge(candidates: &[Candidate], weights: &EvidenceWeights) -> Option<Judgement> {
    if candidates.is_empty() {
        return None;
    }
    let mut judgement = Judgement::default();
    for candidate in candidates {
        let score = log_odds(weights, candidate);
        judgement.log_loss += loss(score, candidate.right) / candidates.len() as f64;
        for (threshold, accepted) in
            THRESHOLDS.into_iter().zip([&mut judgement.accepted, &mut judgement.sure])
        {
            if probability(score) >= threshold {
                accepted.right += usize::from(candidate.right);
                accepted.wrong += usize::from(!candidate.right);
            }
        }
    }
    Some(judgement)
}

fn reliability(judged: &[(f64, bool)]) -> Vec<ReliabilityBin> {
    let mut bins: Vec<ReliabilityBin> = (0..BINS)
        .map(|b| ReliabilityBin { from: b as f64 / BINS as f64, ..ReliabilityBin::default() })
        .collect();
    for &(p, right) in judged {
        let bin = &mut bins[((p * BINS as f64) as usize).min(BINS - 1)];
        bin.candidates += 1;
        bin.stated += p;
        bin.right += f64::from(u8::from(right));
    }
    for bin in &mut bins {
        let n = bin.candidates.max(1) as f64;
        (bin.stated, bin.right) = (bin.stated / n, bin.right / n);
    }
    bins
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_hold_what_is_stated_and_what_is_right() {
        let bins = reliability(&[(0.0, false), (0.05, true), (0.95, true), (1.0, false), (1.0, true)]);
        assert_eq!(bins.iter().map(|b| b.candidates).collect::<Vec<_>>(), [2, 0, 0, 0, 0, 0, 0, 0, 0, 3]);
        assert!((bins[0].stated - 0.025).abs() < 1e-12 && (bins[0].right - 0.5).abs() < 1e-12);
        assert!((bins[9].stated - 2.95 / 3.0).abs() < 1e-12 && (bins[9].right - 2.0 / 3.0).abs() < 1e-12);
    }

    /// Log odds 0 and ±ln 9, and an offset that takes one below the limit.
    #[test]
    fn a_judgement_is_its_closed_form() {
        let weights = EvidenceWeights { constant: 9f64.ln(), ..EvidenceWeights::from_array([0.0; 10]) };
        let mut predictors = [0.0; 10];
        predictors[0] = 1.0;
        let of = |offset: f64, right: bool| Candidate { predictors, offset, right };
        let all = [of(1e-9, true), of(1e-9, false), of(-9f64.ln(), true)];
        let judged = judge(&all, &weights).unwrap();
        let expected = -(0.9f64.ln() + 0.1f64.ln() + 0.5f64.ln()) / 3.0;
        assert!((judged.log_loss - expected).abs() < 1e-8);
        assert_eq!(judged.accepted, Accepted { right: 1, wrong: 1 });
        assert_eq!(judged.sure, Accepted { right: 1, wrong: 1 });
        assert_eq!(judge(&[], &weights), None);
    }
}
