//! Evaluation protocols of the literature: registration recall, pose errors, retrieval scores, and
//! the ground truth they need.

pub(crate) mod dataset;
pub(crate) mod diagnosis;
pub(crate) mod estimate;
pub(crate) mod ground_truth;
pub(crate) mod moments;
pub(crate) mod placement;
pub(crate) mod pose_error;
pub(crate) mod protocol;
pub(crate) mod recall;
pub(crate) mod retrieval;
pub(crate) mod retrieval_scores;
pub(crate) mod scene;
pub(crate) mod stated_error;
pub(crate) mod truth;

pub use dataset::*;
pub use diagnosis::*;
pub use estimate::*;
pub use ground_truth::*;
pub use moments::*;
pub use placement::*;
pub use pose_error::*;
pub use protocol::*;
pub use recall::*;
pub use retrieval::*;
pub use retrieval_scores::*;
pub use scene::*;
pub use stated_error::*;
pub use truth::*;

/// Median (mean of the two middle values of an even number), `None` when empty.
/// `values` may hold infinities but no NaN.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    (n > 0).then(|| {
        let (a, b) = (values[(n - 1) / 2], values[n / 2]);
        if a == b { a } else { 0.5 * (a + b) }
    })
}

/// Mean, `None` when empty.
fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}
