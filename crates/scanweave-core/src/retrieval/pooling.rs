//! What the pooling layers have in common.

/// Floor of a norm before it divides, as in PyTorch's `normalize`.
const NORM_FLOOR: f32 = 1e-12;

/// Scales a row to unit length; a zero row stays zero.
#[inline(always)]
pub(super) fn unit_row(row: &mut [f32]) {
    let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt().max(NORM_FLOOR);
    row.iter_mut().for_each(|v| *v /= norm);
}

/// `sum += scale · row`.
#[inline(always)]
pub(super) fn add_scaled(sum: &mut [f32], row: &[f32], scale: f32) {
    sum.iter_mut().zip(row).for_each(|(s, v)| *s += scale * v);
}
