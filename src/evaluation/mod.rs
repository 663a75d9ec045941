//! Evaluation protocols of the literature: registration recall, pose errors, retrieval scores, and
//! the ground truth they need.

pub mod dataset;
pub mod diagnosis;
pub mod estimate;
pub mod ground_truth;
pub mod moments;
pub mod placement;
pub mod pose_error;
pub mod protocol;
pub mod recall;
pub mod retrieval;
pub mod retrieval_scores;
pub mod scene;
pub mod stated_error;
pub mod truth;

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
