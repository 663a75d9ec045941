//! What right poses of a collection show of its sensor: no two sensors fit alike.

use crate::scan::Evidence;

/// How surfaces of the collection sit on each other where poses are right: the noise of its sensor, the
/// spacing of its points and how far its viewpoints hold, in the terms of the evidence. A pose is judged by
/// what it shows beyond these.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseLevel {
    /// Median of [`Evidence::plane_residual`].
    pub plane_residual: f64,
    /// 80th percentile of [`Evidence::free_space_violation`].
    pub free_space_violation: f64,
}

impl NoiseLevel {
    /// What is usual: the five RGB-D scenes of 3DMatch show residuals of 0.16 to 0.19 and violations of 0.003 to 0.005.
    pub const USUAL: Self = Self { plane_residual: 0.17, free_space_violation: 0.005 };

    /// A free-space violation in the place of what it would be with usual noise: right poses violate in
    /// proportion to the collection's level, so that limits set on RGB-D scenes hold for what this gives.
    pub fn scaled_violation(&self, violation: f64) -> f64 {
        violation / self.violation_ratio()
    }

    /// Scale of the violations of right poses over the usual one.
    pub(super) fn violation_ratio(&self) -> f64 {
        self.violation_scale() / Self::USUAL.violation_scale()
    }

    /// What is as good as no violation, besides the level.
    fn violation_scale(&self) -> f64 {
        0.005 + self.free_space_violation
    }

    /// What the best poses of pairs of scans show, the fifth of them that matches support best, without asking
    /// how well their surfaces fit; of few pairs mostly what is usual.
    pub fn of<'a>(best: impl Iterator<Item = &'a Evidence>) -> Self {
        /// One of so many pairs, and pairs at least: even where a scan overlaps few of those that it was
        /// registered with, those with most matches are right for the most part.
        const ONE_OF: usize = 5;
        const FEWEST: usize = 5;
        /// Pairs that count as much as what is usual.
        const PRIOR_PAIRS: f64 = 2.0;
        let mut best: Vec<&Evidence> = best.collect();
        best.sort_by(|x, y| {
            let order = y.inliers.cmp(&x.inliers).then(x.plane_residual.total_cmp(&y.plane_residual));
            order.then(x.free_space_violation.total_cmp(&y.free_space_violation))
        });
        best.truncate((best.len() / ONE_OF).max(FEWEST));
        let n = best.len() as f64;
        let level = |of: fn(&Evidence) -> f64, percent: usize, usual: f64| {
            let mut shown: Vec<f64> = best.iter().map(|e| of(e)).collect();
            shown.sort_by(f64::total_cmp);
            let shown = shown.get((shown.len().saturating_sub(1) * percent) / 100).copied().unwrap_or(usual);
            (n * shown + PRIOR_PAIRS * usual) / (n + PRIOR_PAIRS)
        };
        Self {
            plane_residual: level(|e| e.plane_residual, 50, Self::USUAL.plane_residual),
            free_space_violation: level(|e| e.free_space_violation, 80, Self::USUAL.free_space_violation),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn evidence(inliers: usize, plane_residual: f64, free_space_violation: f64) -> Evidence {
        Evidence { inliers, plane_residual, free_space_violation, ..Evidence::default() }
    }

    #[test]
    fn the_best_supported_fifth_tells_the_level_whatever_the_rest_shows() {
        // Ten pairs with fifty inliers and more, forty wrong ones with fewer.
        let right = (0..10).map(|k| evidence(50 + k, 0.30 + 0.01 * k as f64, 0.002 * k as f64));
        let wrong = (0..40).map(|k| evidence(10 + k % 30, 0.9, 0.5));
        let all: Vec<Evidence> = wrong.chain(right).collect();
        let level = NoiseLevel::of(all.iter());
        // The median of .30 to .39 (the lower of two) and the 80th percentile of 0 to .018, ten pairs to the two.
        assert_relative_eq!(level.plane_residual, (10.0 * 0.34 + 2.0 * 0.17) / 12.0, epsilon = 1e-12);
        assert_relative_eq!(level.free_space_violation, (10.0 * 0.014 + 2.0 * 0.005) / 12.0, epsilon = 1e-12);
        let turned: Vec<Evidence> = all.into_iter().rev().collect();
        assert_eq!(NoiseLevel::of(turned.iter()), level);
    }

    #[test]
    fn nothing_and_little_is_usual() {
        assert_eq!(NoiseLevel::of([].iter()), NoiseLevel::USUAL);
        let one = NoiseLevel::of([evidence(9, 0.47, 0.005)].iter());
        assert_relative_eq!(one.plane_residual, (0.47 + 2.0 * 0.17) / 3.0, epsilon = 1e-12);
        assert_relative_eq!(one.free_space_violation, 0.005, epsilon = 1e-12);
    }
}
