//! What a registration must show before it is believed.
//!
//! Inlier counts alone cannot tell a right pose from a flip or a slide along repeated
//! structure. The support of a pose joins five measurements in one logistic score:
//! inlier matches, how far they lead the next distinct hypothesis, the share of the scan
//! that falls on known surface, whether normals agree there, and how far points lie off
//! the tangent planes.

use super::config::{EvidenceConfig, EvidenceWeights};
use super::incremental::ScanInput;
use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::rigid::PointMover;
use crate::geometry::{Point, RigidMotion};
use crate::scan::{DeclineReason, Support, Surface};
use nalgebra::{Matrix3, Vector3};

/// Points of a candidate's surface that are checked.
const CHECKED_POINTS: usize = 1000;
/// Normals within this agree: cosine of 45°.
const AGREEING: f32 = std::f32::consts::FRAC_1_SQRT_2;

/// A registered scan's surface, indexed with radius τ in its own frame, and its pose.
#[derive(Clone, Copy)]
pub struct PlacedSurface<'a> {
    /// Points and normals, scan frame.
    pub surface: &'a Surface,
    /// Index of the points.
    pub grid: &'a RadiusGrid<'a>,
    /// Pose.
    pub world_from_scan: RigidMotion,
}

/// How a candidate's surface sits on the surfaces of the registered scans.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SurfaceFit {
    /// Share of the checked points within τ of a registered surface, in `[0, 1]`.
    pub overlap: f64,
    /// Share of those whose normal agrees with the surface's within 45°, in `[0, 1]`.
    pub normal_agreement: f64,
    /// Root mean square distance to the tangent planes where normals agree, in units of τ.
    pub plane_residual: f64,
}

/// Measures a candidate's surface at `world_from_scan` against the registered ones.
///
/// A point that lies near several surfaces counts once, with the best agreement it finds.
pub fn surface_fit(
    candidate: &Surface,
    world_from_scan: &RigidMotion,
    placed: &[PlacedSurface<'_>],
) -> SurfaceFit {
    let count = candidate.len().min(CHECKED_POINTS);
    if count == 0 {
        return SurfaceFit::default();
    }
    let checked: Vec<usize> = (0..count).map(|k| k * candidate.len() / count).collect();
    // Per point: distance to the nearest agreeing tangent plane; infinite where only disagreeing ones are near.
    let mut residual: Vec<Option<f32>> = vec![None; count];
    for other in placed {
        let mover = PointMover::new(&(other.world_from_scan.inverse() * world_from_scan));
        for (residual, &i) in residual.iter_mut().zip(&checked) {
            let moved = mover.point(&candidate.points[i]);
            let Some((near, _)) = other.grid.nearest(&moved) else { continue };
            let normal = other.surface.normals[near];
            let agrees = normal.dot(&mover.direction(&candidate.normals[i])) >= AGREEING;
            let off = normal.dot(&(moved - other.surface.points[near])).abs();
            let new = if agrees { off } else { f32::INFINITY };
            *residual = Some(residual.map_or(new, |old| old.min(new)));
        }
    }
    let near = residual.iter().flatten().count();
    let agreeing: Vec<f64> =
        residual.iter().flatten().filter(|r| r.is_finite()).map(|&r| f64::from(r)).collect();
    let squared: f64 = agreeing.iter().map(|r| r * r).sum();
    let radius_m = placed.first().map_or(1.0, |p| f64::from(p.grid.radius_m()));
    SurfaceFit {
        overlap: near as f64 / count as f64,
        normal_agreement: agreeing.len() as f64 / near.max(1) as f64,
        plane_residual: (squared / agreeing.len().max(1) as f64).sqrt() / radius_m,
    }
}

/// What the logistic model sees of a support, in the order of [`EvidenceWeights::as_array`]:
/// 1, ln inliers, ln(inliers / inliers of the next hypothesis), normal agreement,
/// plane residual, overlap.
///
/// Fewer than three inliers of the next hypothesis count as three: any three matches
/// agree on some motion.
pub fn predictors(support: &Support) -> [f64; 6] {
    let inliers = support.inliers.max(1) as f64;
    let lead = inliers / support.runner_up.max(3) as f64;
    [1.0, inliers.ln(), lead.ln(), support.normal_agreement, support.plane_residual, support.overlap]
}

/// Probability that a pose with this support is right, by the logistic model of the config.
pub fn probability(support: &Support, weights: &EvidenceWeights) -> f64 {
    let score: f64 = predictors(support).iter().zip(weights.as_array()).map(|(x, w)| x * w).sum();
    1.0 / (1.0 + (-score).exp())
}

/// Why a registration does not suffice, or `None` when it does.
pub fn refusal(support: &Support, config: &EvidenceConfig) -> Option<DeclineReason> {
    if support.inliers < config.min_inliers {
        return Some(DeclineReason::TooFewInliers {
            inliers: support.inliers,
            needed: config.min_inliers,
            matches: support.matches,
        });
    }
    match support.probability {
        Some(p) if p < config.accept => {
            Some(DeclineReason::WeakEvidence { support: *support, needed: config.accept })
        }
        _ => None,
    }
}

/// Why a scan cannot be registered at all, before anything is tried.
///
/// `voxel_m` is the working resolution: a scan thinner than a third of it is a plane.
pub fn unusable(scan: &ScanInput<'_>, min_keypoints: usize, voxel_m: f64) -> Option<DeclineReason> {
    let keypoints = scan.features.len();
    if keypoints < min_keypoints {
        return Some(DeclineReason::TooFewKeypoints { keypoints, needed: min_keypoints });
    }
    let points = if scan.surface.is_empty() { &scan.features.keypoints } else { &scan.surface.points };
    let [thickness, width, _] = principal_extents_m(points);
    let limit = voxel_m / 3.0;
    if width < limit {
        return Some(DeclineReason::Degenerate { detail: "all its points lie on one line".into() });
    }
    if thickness < limit {
        let detail = format!("all its points lie on one plane (spread across it {thickness:.2e} m)");
        return Some(DeclineReason::Degenerate { detail });
    }
    None
}

/// Standard deviations of a point set along its principal axes, ascending, metres.
fn principal_extents_m(points: &[Point]) -> [f64; 3] {
    let n = points.len().max(1) as f64;
    let mean = points.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords.cast::<f64>()) / n;
    let mut covariance = Matrix3::zeros();
    for p in points {
        let d = p.coords.cast::<f64>() - mean;
        covariance += d * d.transpose();
    }
    let mut extents: [f64; 3] = (covariance / n).symmetric_eigenvalues().map(|v| v.max(0.0).sqrt()).into();
    extents.sort_by(f64::total_cmp);
    extents
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Direction;
    use approx::assert_relative_eq;

    /// A 2 m square at z = 0, every 5 cm, normals up.
    fn floor() -> Surface {
        Surface {
            points: (0..1600)
                .map(|i| Point::new((i % 40) as f32 * 0.05, (i / 40) as f32 * 0.05, 0.0))
                .collect(),
            normals: vec![Direction::z(); 1600],
        }
    }

    fn fit(candidate: &Surface, pose: RigidMotion) -> SurfaceFit {
        let floor = floor();
        let grid = RadiusGrid::new(&floor.points, 0.07);
        let placed = PlacedSurface { surface: &floor, grid: &grid, world_from_scan: RigidMotion::identity() };
        surface_fit(candidate, &pose, &[placed])
    }

    #[test]
    fn half_a_floor_two_centimetres_up_has_half_the_overlap_and_that_residual() {
        let f = fit(&floor(), RigidMotion::translation(1.0, 0.0, 0.02));
        // Columns 0..=20 of 40 lie within τ: one column reaches over the edge by 5 cm.
        // The checked points are every 1.6th: they hit 25 of the 40 columns, not all alike.
        assert_relative_eq!(f.overlap, 21.0 / 40.0, epsilon = 0.04);
        assert_relative_eq!(f.normal_agreement, 1.0);
        assert_relative_eq!(f.plane_residual, 0.02 / 0.07, epsilon = 1e-4);
    }

    #[test]
    fn a_floor_upside_down_does_not_agree() {
        let turned = RigidMotion::rotation(Vector3::x() * std::f64::consts::PI);
        let f = fit(&floor(), RigidMotion::translation(0.0, 1.95, 0.0) * turned);
        assert_relative_eq!(f.overlap, 1.0, epsilon = 0.01);
        assert_eq!(f.normal_agreement, 0.0);
    }

    #[test]
    fn more_of_every_good_thing_is_more_probable() {
        let weights = EvidenceWeights::default();
        let base = Support {
            matches: 1000,
            inliers: 30,
            runner_up: 15,
            overlap: 0.4,
            normal_agreement: 0.8,
            plane_residual: 0.3,
            ..Support::default()
        };
        let p = probability(&base, &weights);
        assert!(probability(&Support { inliers: 60, ..base }, &weights) > p);
        assert!(probability(&Support { runner_up: 29, ..base }, &weights) < p);
        assert!(probability(&Support { normal_agreement: 0.5, ..base }, &weights) < p);
        assert!(probability(&Support { plane_residual: 0.6, ..base }, &weights) < p);
        assert!(probability(&Support { overlap: 0.1, ..base }, &weights) < p);
    }

    #[test]
    fn the_logistic_model_is_its_closed_form() {
        let weights = EvidenceWeights {
            constant: -1.0,
            ln_inliers: 1.0,
            ln_lead: 2.0,
            normal_agreement: 0.5,
            plane_residual: -1.0,
            overlap: 1.0,
        };
        let support = Support {
            matches: 100,
            inliers: 20,
            runner_up: 10,
            overlap: 0.5,
            normal_agreement: 0.8,
            plane_residual: 0.25,
            ..Support::default()
        };
        let score = -1.0 + 20f64.ln() + 2.0 * 2f64.ln() + 0.4 - 0.25 + 0.5;
        assert_relative_eq!(probability(&support, &weights), 1.0 / (1.0 + (-score).exp()), epsilon = 1e-12);
    }

    #[test]
    fn extents_of_a_box_are_its_closed_form() {
        // Uniform on [0, L]: standard deviation L/√12; a lattice of n points L·√((n+1)/(12(n−1))).
        let points: Vec<Point> = (0..1000)
            .map(|i| Point::new((i % 10) as f32, 2.0 * (i / 10 % 10) as f32, 3.0 * (i / 100) as f32))
            .collect();
        let unit = 9.0 * (11f64 / (12.0 * 9.0)).sqrt();
        let [a, b, c] = principal_extents_m(&points);
        for (found, expected) in [(a, unit), (b, 2.0 * unit), (c, 3.0 * unit)] {
            assert_relative_eq!(found, expected, epsilon = 1e-9);
        }
    }
}
