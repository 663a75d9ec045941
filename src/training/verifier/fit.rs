//! Monotone logistic regression with a ridge toward given weights.

use super::{Candidate, KindCandidates};
use crate::registration::EvidenceWeights;
use nalgebra::{DMatrix, DVector};

const N: usize = EvidenceWeights::NAMES.len();

/// Weights that minimise
///
/// ```text
///   mean over kinds of the mean over a kind's candidates of ln(1 + exp(∓(offset + w·x)))
/// + ridge · Σ_j (σ_j (w_j − given_j))²        where w_j has the sign of its meaning or is 0,
/// ```
///
/// with − for right candidates, σ_j the standard deviation of predictor j over all candidates, kinds
/// weighing equally, and 1 for the constant. The projected Newton method of Bertsekas (SIAM J. Control
/// Optim. 20(2), 1982); sums run in the order of the candidates, so that the result is the same to the
/// last bit for any number of threads.
///
/// The weight of the predictor `left_out`, numbered as [`EvidenceWeights::NAMES`], is 0; what it adds in the mean
/// by the given weights is part of the given constant then.
pub fn fit<'a>(
    kinds: impl IntoIterator<Item = &'a KindCandidates>,
    given: &EvidenceWeights,
    ridge: f64,
    left_out: Option<usize>,
) -> EvidenceWeights {
    let kinds: Vec<&KindCandidates> = kinds.into_iter().filter(|k| !k.candidates.is_empty()).collect();
    if ridge.is_infinite() || kinds.is_empty() {
        return given.clone();
    }
    let problem = Problem::new(&kinds, given, ridge, left_out);
    let start = problem.project(problem.given.clone());
    let scaled = problem.minimum(start);
    EvidenceWeights::from_array(std::array::from_fn(|j| scaled[j] / problem.deviation[j]))
}

/// The problem in units of the standard deviations of the predictors.
struct Problem<'a> {
    /// Every candidate with its share of the loss.
    candidates: Vec<(&'a Candidate, f64)>,
    deviation: [f64; N],
    given: DVector<f64>,
    ridge: f64,
    left_out: Option<usize>,
}

impl<'a> Problem<'a> {
    fn new(
        kinds: &[&'a KindCandidates],
        given: &EvidenceWeights,
        ridge: f64,
        left_out: Option<usize>,
    ) -> Self {
        let mut candidates = Vec::new();
        for kind in kinds {
            let share = 1.0 / (kinds.len() * kind.candidates.len()) as f64;
            candidates.extend(kind.candidates.iter().map(|c| (c, share)));
        }
        let deviation = std::array::from_fn(|j| {
            let mean: f64 = candidates.iter().map(|(c, share)| share * c.predictors[j]).sum();
            let variance: f64 =
                candidates.iter().map(|(c, share)| share * (c.predictors[j] - mean).powi(2)).sum();
            // The constant does not vary, and neither may a predictor.
            if variance > 1e-18 { variance.sqrt() } else { 1.0 }
        });
        let mut weights = given.as_array();
        if let Some(left_out) = left_out {
            let mean: f64 = candidates.iter().map(|(c, share)| share * c.predictors[left_out]).sum();
            weights[0] += weights[left_out] * mean;
            weights[left_out] = 0.0;
        }
        let given = DVector::from_fn(N, |j, _| weights[j] * deviation[j]);
        Self { candidates, deviation, given, ridge, left_out }
    }

    /// The nearest weights with the signs of their meaning.
    fn project(&self, mut w: DVector<f64>) -> DVector<f64> {
        for (j, (weight, sign)) in w.iter_mut().zip(EvidenceWeights::SIGNS).enumerate() {
            if *weight * sign < 0.0 || Some(j) == self.left_out {
                *weight = 0.0;
            }
        }
        w
    }

    /// Log odds of a candidate.
    fn score(&self, w: &DVector<f64>, c: &Candidate) -> f64 {
        c.offset + (0..N).map(|j| w[j] / self.deviation[j] * c.predictors[j]).sum::<f64>()
    }

    fn objective(&self, w: &DVector<f64>) -> f64 {
        let loss: f64 =
            self.candidates.iter().map(|(c, share)| share * loss(self.score(w, c), c.right)).sum();
        loss + self.ridge * (w - &self.given).norm_squared()
    }

    fn gradient_and_hessian(&self, w: &DVector<f64>) -> (DVector<f64>, DMatrix<f64>) {
        let mut gradient = (w - &self.given) * (2.0 * self.ridge);
        let mut hessian = DMatrix::identity(N, N) * (2.0 * self.ridge);
        for (c, share) in &self.candidates {
            let x = DVector::from_fn(N, |j, _| c.predictors[j] / self.deviation[j]);
            let p = 1.0 / (1.0 + (-self.score(w, c)).exp());
            gradient.axpy(share * (p - f64::from(u8::from(c.right))), &x, 1.0);
            hessian.ger(share * p * (1.0 - p), &x, &x, 1.0);
        }
        (gradient, hessian)
    }

    fn minimum(&self, mut w: DVector<f64>) -> DVector<f64> {
        /// Steps at most: candidates that weights separate have no minimum without a ridge.
        const STEPS: usize = 200;
        /// Largest component of the gradient along what is free where the minimum is reached.
        const FLAT: f64 = 1e-11;
        /// What the Hessian gains on its diagonal, so that it can always be inverted.
        const DAMPING: f64 = 1e-12;
        let mut value = self.objective(&w);
        for _ in 0..STEPS {
            let (gradient, mut hessian) = self.gradient_and_hessian(&w);
            let held: Vec<bool> = (0..N)
                .map(|j| {
                    w[j] == 0.0 && EvidenceWeights::SIGNS[j] * gradient[j] > 0.0 || Some(j) == self.left_out
                })
                .collect();
            let mut free = gradient.clone();
            for j in 0..N {
                if held[j] {
                    free[j] = 0.0;
                    hessian.row_mut(j).fill(0.0);
                    hessian.column_mut(j).fill(0.0);
                }
                hessian[(j, j)] += if held[j] { 1.0 } else { DAMPING };
            }
            if free.amax() < FLAT {
                break;
            }
            let Some(factor) = hessian.cholesky() else { break };
            let step = factor.solve(&free);
            let shorter = (0..40).map(|halvings| 0.5f64.powi(halvings));
            let lower = shorter
                .map(|length| self.project(&w - &step * length))
                .map(|next| (self.objective(&next), next))
                .find(|(lower, _)| *lower < value);
            let Some((lower, next)) = lower else { break };
            (value, w) = (lower, next);
        }
        w
    }
}

/// Log loss of a candidate with these log odds: −ln p of what is true.
pub(super) fn loss(log_odds: f64, right: bool) -> f64 {
    let against = if right { -log_odds } else { log_odds };
    against.max(0.0) + (-against.abs()).exp().ln_1p()
}
