//! Contradictions around loops, spread by matched points.

use super::system::gauss_newton_step;
use super::terms::PairTerm;
use crate::geometry::{Point, RigidMotion};
use nalgebra::{Matrix3, Matrix3x6};
use rayon::prelude::*;

/// Points of two scans that are one place by a registration of the two.
#[derive(Debug, Clone)]
pub struct MatchedPair {
    /// Places of the two scans in the list of poses, the first lower.
    pub scans: (usize, usize),
    /// One place a row: in the first scan's frame, in the second's; metres.
    pub points: Vec<(Point, Point)>,
    /// How much the pair counts, in `[0, 1]`.
    pub weight: f64,
}

/// Spreads contradictions around loops: poses that bring the matched points of all pairs together,
/// in the order of `poses`; the first keeps its pose.
///
/// Minimises Σ ρ(mean square distance of a pair's points) with the Geman–McClure kernel ρ, whose
/// scale falls from `10τ` to `2τ` (graduated non-convexity; Yang et al. 2020), so that pairs which
/// contradict all others lose their say.
pub fn close_loops(poses: &[RigidMotion], pairs: &[MatchedPair], radius_m: f64) -> Vec<RigidMotion> {
    let mut poses = poses.to_vec();
    let between: Vec<(usize, usize)> = pairs.iter().map(|p| p.scans).collect();
    for scale in [10.0, 10.0, 6.0, 6.0, 4.0, 4.0, 2.0, 2.0, 2.0] {
        let terms: Vec<PairTerm> =
            pairs.par_iter().map(|pair| matched_term(pair, &poses, scale * radius_m)).collect();
        if gauss_newton_step(&between, &terms, &mut poses, 5.0 * radius_m).is_none() {
            break;
        }
    }
    poses
}

/// Σ JᵀJ and Σ Jᵀr of r = Tᵢp − Tⱼq with J = [−[x]×, I], robustly weighted as one.
fn matched_term(pair: &MatchedPair, poses: &[RigidMotion], scale_m: f64) -> PairTerm {
    let mut term = PairTerm::new();
    let (first, second) = (poses[pair.scans.0], poses[pair.scans.1]);
    let mut squared = 0.0;
    for (p, q) in &pair.points {
        let (x, y) = (first * p.cast::<f64>(), second * q.cast::<f64>());
        let r = x - y;
        squared += r.norm_squared();
        let mut j = Matrix3x6::zeros();
        j.fixed_view_mut::<3, 3>(0, 0).copy_from(&-x.coords.cross_matrix());
        j.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
        term.information += j.transpose() * j;
        term.gradient += j.transpose() * r;
    }
    let mean = squared / pair.points.len().max(1) as f64;
    let w = pair.weight * (scale_m * scale_m / (scale_m * scale_m + mean)).powi(2);
    PairTerm { information: term.information * w, gradient: term.gradient * w, squared: mean * w, weight: w }
}
