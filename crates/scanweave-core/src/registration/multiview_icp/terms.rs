//! What pairs of overlapping scans say of their relative poses: normal equations of point-to-plane
//! distances and, where both scans have colour, of intensities.

use super::PosedScan;
use super::intensity::{self, Touch};
use crate::geometry::nearest_map::NO_POINT;
use crate::geometry::rigid::PointMover;
use crate::geometry::{Direction, Point, RigidMotion};
use crate::scan::Surface;
use nalgebra::{Matrix6, Vector6};
use rayon::prelude::*;

/// Beyond which distances of points from planes count no more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Kernel {
    /// Tukey's biweight reaches as far as points look for counterparts.
    Radius,
    /// Tukey's biweight at [`TUKEY`] standard deviations of the distances as they are.
    Residuals,
}

/// Tukey's biweight at so many standard deviations is 95 % efficient for Gaussian errors (Holland & Welsch 1977).
const TUKEY: f64 = 4.685;
/// Standard deviation of a Gaussian in units of its median absolute value.
const DEVIATION_PER_MEDIAN: f64 = 1.4826;

impl Kernel {
    /// The distance, metres, at which weights become zero: at most `radius_m`.
    pub(super) fn cutoff_m(
        self,
        pairs: &[(usize, usize)],
        samples: &[Sample],
        scans: &[PosedScan<'_>],
        poses: &[RigidMotion],
        strides: &[usize],
        radius_m: f64,
    ) -> f64 {
        /// Every n-th of the points tells the spread well enough.
        const THINNED: usize = 3;
        if self == Self::Radius {
            return radius_m;
        }
        let thinned: Vec<usize> = strides.iter().map(|s| THINNED * s).collect();
        let reach = Reach::of_radius(radius_m);
        let distances_of = |&pair: &(usize, usize)| {
            let mut found = Vec::new();
            for_each_touch(pair, samples, scans, poses, &thinned, reach, |t| found.push(t.r.abs()));
            found
        };
        let distances: Vec<Vec<f64>> = pairs.par_iter().map(distances_of).collect();
        let mut distances = distances.concat();
        if distances.is_empty() {
            return radius_m;
        }
        let middle = distances.len() / 2;
        let (_, &mut median, _) = distances.select_nth_unstable_by(middle, f64::total_cmp);
        let cutoff_m = TUKEY * DEVIATION_PER_MEDIAN * median;
        // Points that lie on the planes of others to the last bit have no spread.
        if cutoff_m > 0.0 { cutoff_m.min(radius_m) } else { radius_m }
    }
}

/// How far points look for counterparts, and at which distance from their planes weights become zero, metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    pub(super) radius_m: f64,
    pub(super) cutoff_m: f64,
}

impl Reach {
    /// Weights reach as far as points look.
    pub(super) fn of_radius(radius_m: f64) -> Self {
        Self { radius_m, cutoff_m: radius_m }
    }
}

/// An evenly strided part of a surface, whose points look for counterparts.
pub(super) struct Sample {
    pub(super) points: Vec<Point>,
    pub(super) normals: Vec<Direction>,
    /// Empty where the scan has no colour.
    pub(super) intensities: Vec<f32>,
}

impl Sample {
    pub(super) fn new(surface: &Surface, at_most: usize) -> Self {
        let with_normal: Vec<usize> =
            (0..surface.len()).filter(|&i| surface.normals[i] != Direction::zeros()).collect();
        let count = with_normal.len().min(at_most);
        let chosen: Vec<usize> = (0..count).map(|k| with_normal[k * with_normal.len() / count]).collect();
        let (points, normals) = chosen.iter().map(|&i| (surface.points[i], surface.normals[i])).unzip();
        let intensities = chosen.iter().filter_map(|&i| surface.intensities.get(i).copied()).collect();
        Self { points, normals, intensities }
    }
}

/// Pairs (i < j) of which at least `min_overlap` of either's points, taken together, lie within
/// `radius_m` of the other's surface.
pub(super) fn overlapping_pairs(
    samples: &[Sample],
    scans: &[PosedScan<'_>],
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
        (near.iter().filter(|&&k| k != NO_POINT).count(), count)
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
pub(super) struct PairTerm {
    pub(super) information: Matrix6<f64>,
    pub(super) gradient: Vector6<f64>,
    /// Σ w r² and Σ w.
    pub(super) squared: f64,
    pub(super) weight: f64,
}

impl PairTerm {
    pub(super) fn new() -> Self {
        Self { information: Matrix6::zeros(), gradient: Vector6::zeros(), squared: 0.0, weight: 0.0 }
    }
}

/// Of how many of its sampled points one is compared with each of the scans that it overlaps: a scan
/// among many is held by so many points that some of them do.
pub(super) fn strides(pairs: &[(usize, usize)], scans: usize) -> Vec<usize> {
    /// Scans with which all points are compared.
    const PARTNERS: usize = 8;
    let mut partners = vec![0usize; scans];
    pairs.iter().for_each(|&(i, j)| [i, j].into_iter().for_each(|s| partners[s] += 1));
    partners.into_iter().map(|n| n.div_ceil(PARTNERS).max(1)).collect()
}

/// Normal equations of a pair, by its surfaces and, where both scans have it, by their colour.
pub(super) fn term_of(
    (i, j): (usize, usize),
    samples: &[Sample],
    scans: &[PosedScan<'_>],
    poses: &[RigidMotion],
    strides: &[usize],
    reach: Reach,
    colour_m: f64,
) -> PairTerm {
    let mut term = pair_term((i, j), samples, scans, poses, strides, reach);
    let coloured = [i, j].iter().all(|&s| !scans[s].model.surface.intensities.is_empty());
    if colour_m > 0.0 && coloured {
        add_intensities(&mut term, (i, j), samples, scans, poses, reach.radius_m, colour_m);
    }
    term
}

/// By its surfaces alone: every `strides`-th sampled point of either scan stands for as many.
pub(super) fn pair_term(
    pair: (usize, usize),
    samples: &[Sample],
    scans: &[PosedScan<'_>],
    poses: &[RigidMotion],
    strides: &[usize],
    reach: Reach,
) -> PairTerm {
    let mut term = PairTerm::new();
    for_each_touch(pair, samples, scans, poses, strides, reach, |Touching { h, r, w, .. }| {
        term.information += h * h.transpose() * w;
        term.gradient += h * (w * r);
        term.squared += w * r * r;
        term.weight += w;
    });
    term
}

/// A point of one scan on the tangent plane of another.
pub(super) struct Touching {
    /// Where it lies, in the frame of the poses.
    pub(super) place: nalgebra::Point3<f64>,
    /// Derivative of its distance from the plane by a left perturbation of the pose of the pair's first.
    pub(super) h: Vector6<f64>,
    /// Its distance from the plane, metres, and Tukey's weight of that.
    pub(super) r: f64,
    pub(super) w: f64,
}

/// Goes through what touches within a pair, points of the first scan first.
pub(super) fn for_each_touch(
    (i, j): (usize, usize),
    samples: &[Sample],
    scans: &[PosedScan<'_>],
    poses: &[RigidMotion],
    strides: &[usize],
    Reach { radius_m, cutoff_m }: Reach,
    mut touching: impl FnMut(Touching),
) {
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
        let near = sampled.zip(&moved).zip(&near).filter(|found| *found.1 != NO_POINT);
        for (((_, normal), moved), &k) in near {
            let k = k as usize;
            let n = model.surface.normals[k];
            if !scans[from].model.same_side(model, mover.direction(normal).dot(&n)) {
                continue;
            }
            let r = f64::from(n.dot(&(moved - model.surface.points[k])));
            // Tukey's biweight
            let w = (1.0 - (r / cutoff_m).powi(2)).max(0.0).powi(2) * stride as f64;
            let x = poses[to] * moved.cast::<f64>();
            let n = poses[to].rotation * n.cast::<f64>();
            let m = x.coords.cross(&n);
            let h = Vector6::new(m.x, m.y, m.z, n.x, n.y, n.z) * sign;
            touching(Touching { place: x, h, r, w });
        }
    }
}

/// What colours say of a pair, added to its normal equations: each residual r of intensities counts as a
/// distance of `colour_m`·r, whose derivative is that of a distance along the slope.
pub(super) fn add_intensities(
    term: &mut PairTerm,
    (i, j): (usize, usize),
    samples: &[Sample],
    scans: &[PosedScan<'_>],
    poses: &[RigidMotion],
    radius_m: f64,
    colour_m: f64,
) {
    for (from, to, sign) in [(i, j, 1.0), (j, i, -1.0)] {
        let mover = PointMover::new(&(poses[to].inverse() * poses[from]));
        let (model, sample) = (scans[to].model, &samples[from]);
        let places = mover.points(&sample.points);
        let near = model.near_each(&places, radius_m as f32);
        let touch = |(((&place, &nearest), normal), &intensity): (((&Point, &u32), &Direction), &f32)| {
            let nearest = Some(nearest).filter(|&k| k != NO_POINT)? as usize;
            let facing = mover.direction(normal).dot(&model.surface.normals[nearest]);
            scans[from].model.same_side(model, facing).then_some(Touch { place, intensity, nearest })
        };
        let points = places.iter().zip(&near).zip(&sample.normals).zip(&sample.intensities);
        let touches: Vec<Touch> = points.filter_map(touch).collect();
        for (place, found) in intensity::residuals(&touches, model) {
            let x = poses[to] * place.cast::<f64>();
            let g = poses[to].rotation * found.gradient.cast::<f64>() * colour_m;
            let m = x.coords.cross(&g);
            let h = Vector6::new(m.x, m.y, m.z, g.x, g.y, g.z) * sign;
            let (r, w) = (f64::from(found.residual) * colour_m, f64::from(found.weight));
            term.information += h * h.transpose() * w;
            term.gradient += h * (w * r);
        }
    }
}
