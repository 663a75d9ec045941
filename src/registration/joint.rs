//! Joint point-to-plane refinement of all poses of a component.
//!
//! Minimises Σ ρ(n·(Tᵢp − Tⱼq)) over all pairs of overlapping scans at once
//! (multi-view point-to-plane ICP; Chen & Medioni 1991 for the metric), by Gauss–Newton
//! with new correspondences each round and radii from coarse to fine. Growth joins scans
//! one after another, so small errors add up along the way; this step spreads them.

use super::config::JointConfig;
use super::scan_model::ScanModel;
use super::shade::{self, Touch};
use crate::error::Result;
use crate::geometry::nearest_map::NOBODY;
use crate::geometry::rigid::PointMover;
use crate::geometry::sparse::BlockMatrix;
use crate::geometry::{Direction, Point, RigidMotion};
use crate::monitor::Monitor;
use crate::scan::Surface;
use nalgebra::{Isometry3, Matrix3, Matrix3x6, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use rayon::prelude::*;

/// Steps shorter than this many radii are the last.
const SETTLED: f64 = 2e-3;

/// One scan of the component.
#[derive(Clone, Copy)]
pub struct JointScan<'a> {
    /// Its thinned surface with normals.
    pub model: &'a ScanModel<'a>,
    /// Its pose.
    pub world_from_scan: RigidMotion,
}

/// Refined poses, in the order of `scans`; the first scan keeps its pose and so fixes the frame.
///
/// `radius_m` is τ. Scans without enough correspondences keep their relation to the rest
/// through a light damping.
///
/// # Errors
/// Only when the monitor is cancelled.
pub fn refine_jointly(
    scans: &[JointScan<'_>],
    config: &JointConfig,
    radius_m: f64,
    monitor: &dyn Monitor,
) -> Result<Vec<RigidMotion>> {
    let mut poses: Vec<RigidMotion> = scans.iter().map(|s| s.world_from_scan).collect();
    if scans.len() < 2 {
        return Ok(poses);
    }
    let samples: Vec<Sample> =
        scans.iter().map(|s| Sample::new(s.model.surface, config.points_per_scan)).collect();
    for (k, factor) in config.radii.iter().enumerate() {
        let radius = factor * radius_m;
        let colour_m = if k + 1 == config.radii.len() { config.colour * radius_m } else { 0.0 };
        let pairs = overlapping_pairs(&samples, scans, &poses, config.min_overlap, radius_m as f32);
        let strides = strides(&pairs, scans.len());
        for _ in 0..config.rounds {
            monitor.check("joint refinement")?;
            let terms: Vec<PairTerm> = pairs
                .par_iter()
                .map(|&(i, j)| term_of((i, j), &samples, scans, &poses, &strides, radius, colour_m))
                .collect();
            let Some(largest_step) = gauss_newton_step(&pairs, &terms, &mut poses, radius_m) else { break };
            if largest_step < SETTLED * radius_m {
                break;
            }
        }
    }
    Ok(poses)
}

/// Covariance of every pose relative to the first at refined poses, in the order of `scans`: of a
/// rotation vector (radians) and the displacement of the scan's centre (metres), in the frame of
/// the poses. Zero for the first; `None` where the system cannot be solved.
///
/// The inverse of the normal equations times the weighted mean square residual, twice: each pair is
/// looked at from both sides. Residuals are taken for independent, which those of points closer
/// than τ are not: scans denser than that, and sensors whose errors are systematic, are less certain.
pub fn pose_covariances(
    scans: &[JointScan<'_>],
    config: &JointConfig,
    radius_m: f64,
) -> Vec<Option<Matrix6<f64>>> {
    let poses: Vec<RigidMotion> = scans.iter().map(|s| s.world_from_scan).collect();
    let samples: Vec<Sample> =
        scans.iter().map(|s| Sample::new(s.model.surface, config.points_per_scan)).collect();
    let pairs = overlapping_pairs(&samples, scans, &poses, config.min_overlap, radius_m as f32);
    let finest = config.radii.last().copied().unwrap_or(1.0) * radius_m;
    let every = vec![1; scans.len()];
    let terms: Vec<PairTerm> =
        pairs.par_iter().map(|&pair| pair_term(pair, &samples, scans, &poses, &every, finest)).collect();
    let (squared, weight) = terms.iter().fold((0.0, 0.0), |s, t| (s.0 + t.squared, s.1 + t.weight));
    let (matrix, _) = normal_equations(&pairs, &terms, scans.len());
    let factor = matrix.cholesky();
    let variance = 2.0 * squared / f64::max(weight, 1.0);
    (0..scans.len())
        .into_par_iter()
        .map(|scan| {
            if scan == 0 {
                return Some(Matrix6::zeros());
            }
            let mut unit = vec![Matrix6::<f64>::zeros(); scans.len() - 1];
            unit[scan - 1] = Matrix6::identity();
            let about_origin = factor.as_ref()?.solve(&unit)[scan - 1] * variance;
            let centre = poses[scan] * scans[scan].model.centre.cast::<f64>();
            let mut at_centre = Matrix6::identity();
            at_centre.fixed_view_mut::<3, 3>(3, 0).copy_from(&-centre.coords.cross_matrix());
            Some(at_centre * about_origin * at_centre.transpose())
        })
        .collect()
}

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

/// An evenly strided part of a surface, whose points look for counterparts.
struct Sample {
    points: Vec<Point>,
    normals: Vec<Direction>,
    /// Empty where the scan has no colour.
    shades: Vec<f32>,
}

impl Sample {
    fn new(surface: &Surface, at_most: usize) -> Self {
        let with_normal: Vec<usize> =
            (0..surface.len()).filter(|&i| surface.normals[i] != Direction::zeros()).collect();
        let count = with_normal.len().min(at_most);
        let chosen: Vec<usize> = (0..count).map(|k| with_normal[k * with_normal.len() / count]).collect();
        let (points, normals) = chosen.iter().map(|&i| (surface.points[i], surface.normals[i])).unzip();
        let shades = chosen.iter().filter_map(|&i| surface.shades.get(i).copied()).collect();
        Self { points, normals, shades }
    }
}

/// Pairs (i < j) of which at least `min_overlap` of either's points, taken together, lie within
/// `radius_m` of the other's surface.
fn overlapping_pairs(
    samples: &[Sample],
    scans: &[JointScan<'_>],
    poses: &[RigidMotion],
    min_overlap: f64,
    radius_m: f32,
) -> Vec<(usize, usize)> {
    /// Points of a scan that are looked at.
    const PROBES: usize = 200;
    let near = |from: usize, to: usize| {
        let mover = PointMover::new(&(poses[to].inverse() * poses[from]));
        let points = &samples[from].points;
        let step = points.len().div_ceil(PROBES).max(1);
        let probes = points.iter().step_by(step);
        let count = probes.len();
        let moved: Vec<Point> = probes.map(|p| mover.point(p)).collect();
        let near = scans[to].model.near_each(&moved, radius_m);
        (near.iter().filter(|&&k| k != NOBODY).count(), count)
    };
    (0..scans.len())
        .into_par_iter()
        .flat_map_iter(|i| (i + 1..scans.len()).map(move |j| (i, j)))
        .filter(|&(i, j)| {
            let (a, b) = (scans[i].model, scans[j].model);
            let apart = (poses[i] * a.centre.cast::<f64>() - poses[j] * b.centre.cast::<f64>()).norm();
            if apart > f64::from(a.reach_m + b.reach_m + radius_m) {
                return false;
            }
            let ((of_i, all_i), (of_j, all_j)) = (near(i, j), near(j, i));
            of_i + of_j > 0 && (of_i + of_j) as f64 >= min_overlap * (all_i + all_j) as f64
        })
        .collect()
}

/// Normal equations of one pair: Σ w h hᵀ and Σ w r h with h = [x×n; n].
///
/// The residual r = n·(x − y) with x = Tᵢp, y = Tⱼq and n = Rⱼn_q has derivative h with
/// respect to a left perturbation (ω, v) of Tᵢ and exactly −h with respect to one of Tⱼ.
#[derive(Clone)]
struct PairTerm {
    information: Matrix6<f64>,
    gradient: Vector6<f64>,
    /// Σ w r² and Σ w.
    squared: f64,
    weight: f64,
}

impl PairTerm {
    fn new() -> Self {
        Self { information: Matrix6::zeros(), gradient: Vector6::zeros(), squared: 0.0, weight: 0.0 }
    }
}

/// Of how many of its sampled points one is compared with each of the scans that it overlaps: a scan
/// among many is held by so many points that some of them do.
fn strides(pairs: &[(usize, usize)], scans: usize) -> Vec<usize> {
    /// Scans with which all points are compared.
    const PARTNERS: usize = 8;
    let mut partners = vec![0usize; scans];
    pairs.iter().for_each(|&(i, j)| [i, j].into_iter().for_each(|s| partners[s] += 1));
    partners.into_iter().map(|n| n.div_ceil(PARTNERS).max(1)).collect()
}

/// Normal equations of a pair, by its surfaces and, where both scans have it, by their colour.
fn term_of(
    (i, j): (usize, usize),
    samples: &[Sample],
    scans: &[JointScan<'_>],
    poses: &[RigidMotion],
    strides: &[usize],
    radius_m: f64,
    colour_m: f64,
) -> PairTerm {
    let mut term = pair_term((i, j), samples, scans, poses, strides, radius_m);
    let coloured = [i, j].iter().all(|&s| !scans[s].model.surface.shades.is_empty());
    if colour_m > 0.0 && coloured {
        add_shades(&mut term, (i, j), samples, scans, poses, radius_m, colour_m);
    }
    term
}

/// By its surfaces alone: every `strides`-th sampled point of either scan stands for as many.
fn pair_term(
    (i, j): (usize, usize),
    samples: &[Sample],
    scans: &[JointScan<'_>],
    poses: &[RigidMotion],
    strides: &[usize],
    radius_m: f64,
) -> PairTerm {
    let mut term = PairTerm::new();
    // Points of i on the planes of j, and the other way round with the sign of h turned.
    for (from, to, sign) in [(i, j, 1.0), (j, i, -1.0)] {
        let to_from_from = poses[to].inverse() * poses[from];
        let mover = PointMover::new(&to_from_from);
        let model = scans[to].model;
        let stride = strides[from];
        let sampled = samples[from].points.iter().zip(&samples[from].normals);
        // Another share of the points for every partner.
        let sampled = sampled.skip(to % stride).step_by(stride);
        let moved: Vec<Point> = sampled.clone().map(|(p, _)| mover.point(p)).collect();
        let near = model.near_each(&moved, radius_m as f32);
        let touching = sampled.zip(&moved).zip(&near).filter(|found| *found.1 != NOBODY);
        for (((_, normal), moved), &k) in touching {
            let k = k as usize;
            let n = model.surface.normals[k];
            if mover.direction(normal).dot(&n) < MIN_NORMAL_COSINE {
                continue;
            }
            let r = f64::from(n.dot(&(moved - model.surface.points[k])));
            // Tukey's biweight
            let w = (1.0 - (r / radius_m).powi(2)).max(0.0).powi(2) * stride as f64;
            let x = poses[to] * moved.cast::<f64>();
            let n = poses[to].rotation * n.cast::<f64>();
            let m = x.coords.cross(&n);
            let h = Vector6::new(m.x, m.y, m.z, n.x, n.y, n.z) * sign;
            term.information += h * h.transpose() * w;
            term.gradient += h * (w * r);
            term.squared += w * r * r;
            term.weight += w;
        }
    }
    term
}

/// What colours say of a pair, added to its normal equations: each residual r of shades counts as a
/// distance of `colour_m`·r, whose derivative is that of a distance along the slope.
fn add_shades(
    term: &mut PairTerm,
    (i, j): (usize, usize),
    samples: &[Sample],
    scans: &[JointScan<'_>],
    poses: &[RigidMotion],
    radius_m: f64,
    colour_m: f64,
) {
    for (from, to, sign) in [(i, j, 1.0), (j, i, -1.0)] {
        let mover = PointMover::new(&(poses[to].inverse() * poses[from]));
        let (model, sample) = (scans[to].model, &samples[from]);
        let places = mover.points(&sample.points);
        let near = model.near_each(&places, radius_m as f32);
        let touch = |(((&place, &nearest), normal), &shade): (((&Point, &u32), &Direction), &f32)| {
            let nearest = Some(nearest).filter(|&k| k != NOBODY)? as usize;
            let facing = mover.direction(normal).dot(&model.surface.normals[nearest]);
            (facing >= MIN_NORMAL_COSINE).then_some(Touch { place, shade, nearest })
        };
        let points = places.iter().zip(&near).zip(&sample.normals).zip(&sample.shades);
        let touches: Vec<Touch> = points.filter_map(touch).collect();
        for (place, found) in shade::residuals(&touches, model) {
            let x = poses[to] * place.cast::<f64>();
            let g = poses[to].rotation * found.slope.cast::<f64>() * colour_m;
            let m = x.coords.cross(&g);
            let h = Vector6::new(m.x, m.y, m.z, g.x, g.y, g.z) * sign;
            let (r, w) = (f64::from(found.residual) * colour_m, f64::from(found.weight));
            term.information += h * h.transpose() * w;
            term.gradient += h * (w * r);
        }
    }
}

/// Normals further apart than 45° do not belong to the same surface.
pub(super) const MIN_NORMAL_COSINE: f32 = std::f32::consts::FRAC_1_SQRT_2;

/// The normal equations of all poses but the first, which is held.
fn normal_equations(
    pairs: &[(usize, usize)],
    terms: &[PairTerm],
    poses: usize,
) -> (BlockMatrix<6>, Vec<Vector6<f64>>) {
    let mut matrix = BlockMatrix::<6>::zeros(poses - 1);
    let mut right = vec![Vector6::zeros(); poses - 1];
    for (&(i, j), term) in pairs.iter().zip(terms) {
        // Scan 0 is held: its rows and columns are left out.
        for (scan, sign) in [(i, 1.0), (j, -1.0)] {
            if scan > 0 {
                matrix.add(scan - 1, scan - 1, &term.information);
                right[scan - 1] -= term.gradient * sign;
            }
        }
        if i > 0 {
            matrix.add(j - 1, i - 1, &-term.information);
        }
    }
    // A floor on the diagonal keeps directions that nothing holds where they are.
    for row in 0..right.len() {
        let floor = matrix.diagonal(row).diagonal().map(|v| 1e-6 * v + 1e-3);
        matrix.add(row, row, &Matrix6::from_diagonal(&floor));
    }
    (matrix, right)
}

/// Solves for all poses but the first and applies the step; returns the longest
/// translation of a pose, or `None` when the system cannot be solved.
fn gauss_newton_step(
    pairs: &[(usize, usize)],
    terms: &[PairTerm],
    poses: &mut [RigidMotion],
    radius_m: f64,
) -> Option<f64> {
    let (matrix, right) = normal_equations(pairs, terms, poses.len());
    let steps = matrix.solve(&right)?;
    let mut longest = 0.0f64;
    for (pose, delta) in poses.iter_mut().skip(1).zip(steps) {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(delta[0], delta[1], delta[2]));
        let shift = Translation3::new(delta[3], delta[4], delta[5]);
        let moved = Isometry3::from_parts(shift, turn) * *pose;
        let way = (moved.translation.vector - pose.translation.vector).norm();
        // A step beyond the radius of the correspondences is not supported by them.
        if way <= 3.0 * radius_m {
            *pose = moved;
        }
        longest = longest.max(way);
    }
    Some(longest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rigid::{rotation_error_rad, translation_error_m};
    use crate::monitor::Silent;
    use crate::registration::config::RegistrationConfig;
    use nalgebra::Point3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn model(surface: &Surface) -> ScanModel<'_> {
        ScanModel::new(surface, 0.07, &RegistrationConfig::default())
    }

    /// Three mutually perpendicular walls, 2 m wide, sampled every 2.5 cm, in a scan's own frame.
    fn corner(scan_from_world: &RigidMotion) -> Surface {
        let mover = PointMover::new(scan_from_world);
        let mut surface = Surface::default();
        for a in 0..80 {
            for b in 0..80 {
                let (u, v) = (a as f32 * 0.025, b as f32 * 0.025);
                for (p, n) in [
                    (Point::new(u, v, 0.0), Direction::z()),
                    (Point::new(u, 0.0, v), Direction::y()),
                    (Point::new(0.0, u, v), Direction::x()),
                ] {
                    surface.points.push(mover.point(&p));
                    surface.normals.push(mover.direction(&n));
                }
            }
        }
        surface
    }

    #[test]
    fn scans_with_many_partners_are_compared_by_a_share_of_their_points_that_stands_for_all() {
        // A hub that overlaps twenty scans, which overlap it alone.
        let hub: Vec<(usize, usize)> = (1..=20).map(|j| (0, j)).collect();
        let mut expected = vec![1; 21];
        expected[0] = 3;
        assert_eq!(strides(&hub, 21), expected);
        assert_eq!(strides(&[], 2), [1, 1]);

        let moved = RigidMotion::new(Vector3::new(0.01, -0.02, 0.015), Vector3::new(0.004, 0.0, -0.006));
        let surfaces = [corner(&RigidMotion::identity()), corner(&RigidMotion::identity())];
        let models = surfaces.each_ref().map(model);
        let poses = [RigidMotion::identity(), moved];
        let scans = [0, 1].map(|k| JointScan { model: &models[k], world_from_scan: poses[k] });
        let samples: Vec<Sample> = scans.iter().map(|s| Sample::new(s.model.surface, 1200)).collect();
        let of = |strides: [usize; 2]| pair_term((0, 1), &samples, &scans, &poses, &strides, 0.07);
        let (all, some) = (of([1, 1]), of([2, 5]));
        let difference = (all.information - some.information).norm() / all.information.norm();
        // Strides meet the walls' grid unevenly; a share that stood for itself alone would be 0.5 off or more.
        assert!(difference < 0.25, "{difference}");
        assert!((all.weight - some.weight).abs() < 0.25 * all.weight);
    }

    #[test]
    fn disturbed_poses_return_to_the_exact_ones() {
        // Every scan sees the same corner; the exact poses give zero residual.
        let truth: Vec<RigidMotion> = (0..5)
            .map(|k| {
                let k = f64::from(k);
                RigidMotion::new(Vector3::new(k, -0.3 * k, 0.1), Vector3::new(0.1 * k, 0.2, -0.3 * k))
            })
            .collect();
        let surfaces: Vec<Surface> = truth.iter().map(|t| corner(&t.inverse())).collect();
        let nudge = |k: usize| {
            let s = if k == 0 {
                0.0
            } else if k.is_multiple_of(2) {
                1.0
            } else {
                -1.0
            };
            RigidMotion::new(Vector3::new(0.03, -0.02, 0.025) * s, Vector3::new(0.01, -0.015, 0.01) * s)
        };
        let models: Vec<ScanModel<'_>> = surfaces.iter().map(model).collect();
        let scans: Vec<JointScan<'_>> = models
            .iter()
            .enumerate()
            .map(|(k, model)| JointScan { model, world_from_scan: nudge(k) * truth[k] })
            .collect();
        let refined = refine_jointly(&scans, &JointConfig::default(), 0.07, &Silent).unwrap();
        assert_eq!(refined[0], truth[0]);
        for (pose, truth) in refined.iter().zip(&truth) {
            assert!(translation_error_m(pose, truth) < 2e-4, "{}", translation_error_m(pose, truth));
            assert!(rotation_error_rad(pose, truth) < 2e-4);
        }
    }

    #[test]
    fn a_loop_that_drifted_closes_and_a_false_pair_is_outvoted() {
        // Twelve poses on a circle; neighbours see 20 common points, exactly. The start drifts by
        // 8 cm a step. Across the circle one pair claims points that are 1.5 m apart to be one.
        let truth: Vec<RigidMotion> = (0..12)
            .map(|k| {
                let a = f64::from(k) * std::f64::consts::TAU / 12.0;
                RigidMotion::new(
                    Vector3::new(3.0 * a.cos(), 3.0 * a.sin(), 0.1 * a),
                    Vector3::new(0.0, 0.1, a),
                )
            })
            .collect();
        let seen = |k: usize, shift: f64| -> Vec<Point> {
            (0..20)
                .map(|m| {
                    let m = f64::from(m);
                    let p = nalgebra::Point3::new((1.7 * m).sin() + shift, (2.3 * m).cos(), (0.9 * m).sin());
                    (truth[k].inverse() * p).cast::<f32>()
                })
                .collect()
        };
        let pair = |i: usize, j: usize, shift: f64| MatchedPair {
            scans: (i.min(j), i.max(j)),
            points: seen(i.min(j), 0.0).into_iter().zip(seen(i.max(j), shift)).collect(),
            weight: 1.0,
        };
        let mut pairs: Vec<MatchedPair> = (0..12).map(|k| pair(k, (k + 1) % 12, 0.0)).collect();
        pairs.extend((0..12).map(|k| pair(k, (k + 2) % 12, 0.0)));
        pairs.push(pair(0, 6, 1.5));
        let start: Vec<RigidMotion> = truth
            .iter()
            .enumerate()
            .map(|(k, t)| RigidMotion::translation(0.08 * k as f64, 0.0, -0.02 * k as f64) * t)
            .collect();
        let closed = close_loops(&start, &pairs, 0.07);
        for (pose, truth) in closed.iter().zip(&truth) {
            assert!(translation_error_m(pose, truth) < 5e-3, "{}", translation_error_m(pose, truth));
            assert!(rotation_error_rad(pose, truth) < 5e-3);
        }
    }

    #[test]
    fn covariances_are_the_spread_of_poses_over_many_draws_of_the_noise() {
        // Three views of a corner with 5 mm noise across the surfaces; the exact poses are known.
        let truth: Vec<RigidMotion> = (0..3)
            .map(|k| {
                let k = f64::from(k);
                RigidMotion::new(Vector3::new(0.5 * k, -0.3 * k, 0.1), Vector3::new(0.1 * k, 0.2, -0.3 * k))
            })
            .collect();
        let config = JointConfig { radii: vec![1.0], ..JointConfig::default() };
        let draws = 60;
        let (mut seen, mut stated) = (Matrix6::<f64>::zeros(), Matrix6::<f64>::zeros());
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for _ in 0..draws {
            let mut surfaces: Vec<Surface> = truth.iter().map(|t| corner(&t.inverse())).collect();
            for surface in &mut surfaces {
                for (p, n) in surface.points.iter_mut().zip(&surface.normals) {
                    // Uniform on ±a has the standard deviation a/√3.
                    *p += n * rng.random_range(-0.00866f32..0.00866);
                }
            }
            let models: Vec<ScanModel<'_>> = surfaces.iter().map(model).collect();
            let posed = |poses: &[RigidMotion]| -> Vec<JointScan<'_>> {
                let scans = models.iter().zip(poses);
                scans.map(|(model, &world_from_scan)| JointScan { model, world_from_scan }).collect()
            };
            let refined = refine_jointly(&posed(&truth), &config, 0.07, &Silent).unwrap();
            let covariances = pose_covariances(&posed(&refined), &config, 0.07);
            assert_eq!(covariances[0], Some(Matrix6::zeros()));
            stated += covariances[2].unwrap() / f64::from(draws);
            let centre = models[2].centre.cast::<f64>();
            let moved = refined[2] * centre - truth[2] * centre;
            let turned = (refined[2].rotation * truth[2].rotation.inverse()).scaled_axis();
            let off = Vector6::new(turned.x, turned.y, turned.z, moved.x, moved.y, moved.z);
            seen += off * off.transpose() / f64::from(draws);
        }
        for d in 0..6 {
            let ratio = (stated[(d, d)] / seen[(d, d)]).sqrt();
            assert!((0.6..1.7).contains(&ratio), "{d}: stated over seen deviation {ratio}");
        }
    }

    /// Two views of one painted wall, the second 2 cm and half a degree off along it and more brightly
    /// exposed: only the paint tells.
    #[test]
    fn paint_holds_what_a_flat_wall_does_not() {
        let paint = |x: f32, y: f32| 0.5 + 0.2 * (9.0 * x).sin() + 0.2 * (7.0 * y + 3.0 * x).cos();
        let wall = |shift: f32, brighter: f32| {
            let points: Vec<Point> = (0..6400)
                .map(|i| Point::new((i % 80) as f32 * 0.025 + shift, (i / 80) as f32 * 0.025 + shift, 0.0))
                .collect();
            let shades = points.iter().map(|p| paint(p.x, p.y) + brighter).collect();
            Surface { normals: vec![Direction::z(); 6400], points, shades, ..Surface::default() }
        };
        let (first, second) = (wall(0.0, 0.0), wall(0.011, 0.08));
        let (first, second) = (model(&first), model(&second));
        let off = RigidMotion::new(Vector3::new(0.02, -0.015, 0.01), Vector3::new(0.0, 0.0, 0.009));
        let scans = [
            JointScan { model: &first, world_from_scan: RigidMotion::identity() },
            JointScan { model: &second, world_from_scan: off },
        ];
        let error = |colour: f64| {
            let config = JointConfig { colour, rounds: 8, ..JointConfig::default() };
            let refined = refine_jointly(&scans, &config, 0.07, &Silent).unwrap()[1];
            let corner = Point3::new(0.0, 0.0, 0.0);
            (refined * corner - corner).norm()
        };
        assert!(error(0.0) > 0.015, "{}", error(0.0));
        assert!(error(1.0) < 0.002, "{}", error(1.0));
    }

    #[test]
    fn what_nothing_holds_stays_where_it_was() {
        // Two views of one plane: sliding along it is free, only the distance is corrected.
        let flat = Surface {
            points: (0..6400)
                .map(|i| Point::new((i % 80) as f32 * 0.025, (i / 80) as f32 * 0.025, 0.0))
                .collect(),
            normals: vec![Direction::z(); 6400],
            ..Surface::default()
        };
        let flat = model(&flat);
        let start = RigidMotion::translation(0.1, 0.0, 0.03);
        let scans = [
            JointScan { model: &flat, world_from_scan: RigidMotion::identity() },
            JointScan { model: &flat, world_from_scan: start },
        ];
        let refined = refine_jointly(&scans, &JointConfig::default(), 0.07, &Silent).unwrap();
        assert!(refined[1].translation.vector.z.abs() < 1e-4);
        assert!((refined[1].translation.vector.x - 0.1).abs() < 1e-3);
    }
}
