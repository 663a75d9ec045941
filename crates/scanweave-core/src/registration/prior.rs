//! What is known of poses before any scan is compared: rough poses, and which way is up.
//!
//! A prior changes the odds of a hypothesis and never makes one right by itself. What agrees with it
//! keeps the odds that surfaces and matches give; what disagrees loses, at most as much as the share of
//! priors that are wrong allows, so that scans that contradict a prior clearly enough overrule it.

use super::config::PriorConfig;
use super::input::ScanInput;
use super::pairwise::matching::Matches;
use super::verification::surface_fit::Posed;
use crate::geometry::{Point, RigidMotion};
use crate::scan::ScanId;
use nalgebra::{Point3, Vector3};

/// What is known of the pose of one scan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PosePrior {
    /// Its rough pose.
    pub rough: Option<RoughPose>,
    /// The direction up in its frame.
    pub up: Option<Upright>,
}

/// A rough pose with its standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoughPose {
    /// Takes coordinates of the scan to a world that all rough poses share.
    pub world_from_scan: RigidMotion,
    /// Deviation of the position along each axis, metres.
    pub position_deviation_m: f64,
    /// Deviation of the rotation about each axis, radians.
    pub rotation_deviation_rad: f64,
}

/// A direction with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Upright {
    /// Unit vector.
    pub direction: Vector3<f64>,
    /// Deviation about each horizontal axis, radians.
    pub tilt_deviation_rad: f64,
}

/// Share of priors that are taken to be altogether wrong: a scan under another name, a scanner on its
/// side. It bounds what a prior can cost, ln 100 of the log odds, about as much as tells a sure pair
/// (odds of 10 000 and more) from one that is open.
const WRONG_SHARE: f64 = 0.01;
/// Pairs of scans between two groups that are looked at, at most by so many of either.
const MOST_OF_GROUP: usize = 8;
/// A rough pose is consistent with what lies within so many deviations.
const GATE: f64 = 3.0;

/// By how much the priors of two groups lower the log odds of a relative pose, from 0 to ln 100.
pub fn penalty(a: &[Posed<'_>], b: &[Posed<'_>], a_from_b: &RigidMotion) -> f64 {
    tilt_penalty(a, b, a_from_b).unwrap_or(0.0) + rough_penalty(a, b, a_from_b).unwrap_or(0.0)
}

/// −ln((1 − w) exp(−x/2) + w) of an excess x of the squared deviation over its expectation.
fn cost(squared: f64, expected: f64) -> f64 {
    let excess = (squared - expected).max(0.0);
    -((1.0 - WRONG_SHARE) * (-0.5 * excess).exp() + WRONG_SHARE).ln()
}

fn tilt_penalty(a: &[Posed<'_>], b: &[Posed<'_>], a_from_b: &RigidMotion) -> Option<f64> {
    // The mean direction of a group, and its deviation: errors of different scans are independent.
    let up = |group: &[Posed<'_>]| {
        let ups = group.iter().filter_map(|p| Some((p.group_from_scan, p.model.prior.up?)));
        let (sum, variance, n) =
            ups.fold((Vector3::zeros(), 0.0, 0usize), |(sum, variance, n), (pose, up)| {
                (sum + pose * up.direction, variance + up.tilt_deviation_rad.powi(2), n + 1)
            });
        (n > 0).then(|| (sum, variance / (n * n) as f64))
    };
    let ((up_a, of_a), (up_b, of_b)) = (up(a)?, up(b)?);
    let tilt = up_a.angle(&(a_from_b * up_b));
    Some(cost(tilt * tilt / (of_a + of_b), 2.0))
}

fn rough_penalty(a: &[Posed<'_>], b: &[Posed<'_>], a_from_b: &RigidMotion) -> Option<f64> {
    let some = |group: &[Posed<'_>]| {
        let rough =
            group.iter().filter_map(|p| Some((p.group_from_scan, p.model.centre, p.model.prior.rough?)));
        let rough: Vec<_> = rough.collect();
        let step = rough.len().div_ceil(MOST_OF_GROUP).max(1);
        rough.into_iter().step_by(step).collect::<Vec<_>>()
    };
    let (of_a, of_b) = (some(a), some(b));
    let mut costs: Vec<f64> = of_a
        .iter()
        .flat_map(|(a_from_p, centre_p, p)| {
            of_b.iter().map(move |(b_from_q, centre_q, q)| {
                let p_from_q = a_from_p.inverse() * a_from_b * b_from_q;
                cost(squared_deviation((p, centre_p), (q, centre_q), &p_from_q), 6.0)
            })
        })
        .collect();
    // The median: one scan with a wrong prior must not speak for its group.
    let middle = costs.len() / 2;
    (!costs.is_empty()).then(|| *costs.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Squared deviation of a relative pose from that of two rough poses, in units of its variance.
fn squared_deviation(
    (p, centre_p): (&RoughPose, &Point),
    (q, centre_q): (&RoughPose, &Point),
    p_from_q: &RigidMotion,
) -> f64 {
    let stated = p.world_from_scan.inverse() * q.world_from_scan;
    let centre = centre_q.cast::<f64>();
    let turned_away = (stated.rotation.inverse() * p_from_q.rotation).angle();
    let moved = stated * centre - p_from_q * centre;
    let variance = position_variance(p, q, (stated * centre - centre_p.cast::<f64>()).norm());
    let of_rotation = p.rotation_deviation_rad.powi(2) + q.rotation_deviation_rad.powi(2);
    moved.norm_squared() / variance + turned_away * turned_away / of_rotation
}

/// Variance along an axis of where a point of q lies in p, at a distance from the centre of p: a rotation
/// of p moves it by as much as it is away.
fn position_variance(p: &RoughPose, q: &RoughPose, distance_m: f64) -> f64 {
    p.position_deviation_m.powi(2)
        + q.position_deviation_m.powi(2)
        + (p.rotation_deviation_rad * distance_m).powi(2)
}

/// The matches between a target and a source that their rough poses allow; `None` where not both have one.
pub fn allowed(target: &PosePrior, source: &PosePrior, matches: &Matches, radius_m: f64) -> Option<Matches> {
    let (p, q) = (target.rough?, source.rough?);
    let stated = p.world_from_scan.inverse() * q.world_from_scan;
    let allowed = |i: &usize| {
        let (at, s) = (matches.target[*i].cast::<f64>(), matches.source[*i].cast::<f64>());
        // Rotations turn a scan about its zero, which lies amid its points.
        let turned = (p.rotation_deviation_rad * at.coords.norm()).powi(2)
            + (q.rotation_deviation_rad * s.coords.norm()).powi(2);
        let variance = p.position_deviation_m.powi(2) + q.position_deviation_m.powi(2) + turned;
        (stated * s - at).norm() <= GATE * variance.sqrt() + radius_m
    };
    let kept: Vec<usize> = (0..matches.len()).filter(allowed).collect();
    Some(Matches {
        pairs: kept.iter().map(|&i| matches.pairs[i]).collect(),
        source: kept.iter().map(|&i| matches.source[i]).collect(),
        target: kept.iter().map(|&i| matches.target[i]).collect(),
        scores: kept.iter().map(|&i| matches.scores[i]).collect(),
    })
}

/// Pairs whose rough poses say that they may see the same: every scan with at most `neighbours` others,
/// the nearest; ordered, i < j.
pub fn near_pairs(scans: &[ScanInput<'_>], usable: &[ScanId], neighbours: usize) -> Vec<(ScanId, ScanId)> {
    let sphere = |scan: &ScanId| {
        let rough = scans[scan.0].prior.rough?;
        let points = &scans[scan.0].surface.points;
        let reach = points.iter().map(|p| p.coords.norm()).fold(0.0, f32::max);
        let centre: Point3<f64> = rough.world_from_scan * Point3::origin();
        Some((*scan, centre, f64::from(reach) + GATE * rough.position_deviation_m))
    };
    let spheres: Vec<_> = usable.iter().filter_map(sphere).collect();
    let mut pairs = Vec::new();
    for (i, centre, reach) in &spheres {
        let mut near: Vec<(f64, ScanId)> = spheres
            .iter()
            .filter(|(j, other, of_other)| j != i && (other - centre).norm() <= reach + of_other)
            .map(|(j, other, _)| ((other - centre).norm(), *j))
            .collect();
        near.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        pairs.extend(near.iter().take(neighbours).map(|&(_, j)| (*i.min(&j), j.max(*i))));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Priors of scans from the settings, rough poses `world_from_local` and rotations `file_from_local`.
pub fn priors(
    config: &PriorConfig,
    inlier_radius_m: f64,
    scans: impl Iterator<Item = (Option<RigidMotion>, RigidMotion)>,
) -> Vec<PosePrior> {
    /// Deviation of a rough position where nothing is said, in inlier radii: 0.7 m in a room.
    const USUAL_DEVIATION: f64 = 10.0;
    let position_deviation_m = config.position_deviation_m.unwrap_or(USUAL_DEVIATION * inlier_radius_m);
    let rotation_deviation_rad = config.rotation_deviation_deg.to_radians();
    let prior = |(world_from_local, file_from_local): (Option<RigidMotion>, RigidMotion)| {
        let known = world_from_local.filter(|_| config.initial_poses);
        let rough = known.map(|world_from_scan| RoughPose {
            world_from_scan,
            position_deviation_m,
            rotation_deviation_rad,
        });
        let up = config.up.map(|axis| Upright {
            direction: file_from_local.rotation.inverse() * axis.direction(),
            tilt_deviation_rad: config.tilt_deviation_deg.to_radians(),
        });
        PosePrior { rough, up }
    };
    scans.map(prior).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::RegistrationConfig;
    use crate::registration::config::Axis;
    use crate::registration::scan_model::ScanModel;
    use crate::scan::{Descriptors, Features, Surface};
    use approx::assert_relative_eq;

    const WORST: f64 = 4.605_170_185_988_091; // ln 100

    /// A ball of points about zero.
    fn surface() -> Surface {
        let points: Vec<Point> = (0..200)
            .map(|k| {
                let (z, turn) = (k as f32 / 100.0 - 0.995, 2.4 * k as f32);
                let r = (1.0 - z * z).sqrt();
                Point::new(r * turn.cos(), r * turn.sin(), z)
            })
            .collect();
        let normals = points.iter().map(|p| p.coords).collect();
        Surface { points, normals, ..Surface::default() }
    }

    fn rough(world_from_scan: RigidMotion) -> PosePrior {
        let rough = RoughPose { world_from_scan, position_deviation_m: 0.3, rotation_deviation_rad: 0.1 };
        PosePrior { rough: Some(rough), up: None }
    }

    fn upright(direction: Vector3<f64>) -> PosePrior {
        PosePrior { rough: None, up: Some(Upright { direction, tilt_deviation_rad: 0.1 }) }
    }

    /// Penalty of a relative pose of two groups, each of scans with these priors and poses.
    fn of_groups(
        a: &[(PosePrior, RigidMotion)],
        b: &[(PosePrior, RigidMotion)],
        a_from_b: &RigidMotion,
    ) -> f64 {
        let (surface, config) = (surface(), RegistrationConfig::default());
        let model = |p: &(PosePrior, RigidMotion)| {
            let mut model = ScanModel::new(&surface, 0.1, &config);
            model.centre = Point::origin();
            model.prior = p.0;
            model
        };
        let models: Vec<Vec<ScanModel<'_>>> = [a, b].iter().map(|g| g.iter().map(model).collect()).collect();
        let posed = |models: &'_ [ScanModel<'_>], group: &[(PosePrior, RigidMotion)]| -> Vec<RigidMotion> {
            assert_eq!(models.len(), group.len());
            group.iter().map(|p| p.1).collect()
        };
        let [poses_a, poses_b] = [posed(&models[0], a), posed(&models[1], b)];
        let group = |k: usize, poses: &[RigidMotion]| -> Vec<Posed<'_>> {
            let pairs = models[k].iter().zip(poses);
            pairs.map(|(model, pose)| Posed { model, group_from_scan: *pose }).collect()
        };
        penalty(&group(0, &poses_a), &group(1, &poses_b), a_from_b)
    }

    #[test]
    fn a_pose_within_the_stated_deviation_costs_nothing_and_a_wrong_one_ln_100() {
        let here = RigidMotion::identity();
        let there = RigidMotion::translation(2.0, 0.0, 0.0);
        let of =
            |a_from_b: RigidMotion| of_groups(&[(rough(here), here)], &[(rough(there), here)], &a_from_b);
        assert_eq!(of(there), 0.0);
        // Variance of a position along an axis: 2 · 0.3² and (0.1 · 2)².
        let sigma = 0.22f64.sqrt();
        assert_eq!(of(RigidMotion::translation(2.0, 2.4 * sigma, 0.0)), 0.0);
        // Four deviations: 16 beyond an expectation of 6.
        let four = of(RigidMotion::translation(2.0, 4.0 * sigma, 0.0));
        assert_relative_eq!(four, -(0.99 * (-5.0f64).exp() + 0.01).ln(), epsilon = 1e-9);
        assert_relative_eq!(of(RigidMotion::translation(30.0, 0.0, 0.0)), WORST, epsilon = 1e-9);
        // Half a turn about the middle between the two.
        let turn = RigidMotion::new(Vector3::new(2.0, 0.0, 0.0), Vector3::z() * std::f64::consts::PI);
        assert_relative_eq!(of(turn), WORST, epsilon = 1e-9);
        // Nothing is known of one of the two.
        let unknown = PosePrior::default();
        assert_eq!(of_groups(&[(rough(here), here)], &[(unknown, here)], &turn), 0.0);
    }

    #[test]
    fn one_wrong_prior_does_not_speak_for_its_group() {
        let here = RigidMotion::identity();
        let shifted = |x: f64| RigidMotion::translation(x, 0.0, 0.0);
        // The second scan of the first group is stated 50 m off.
        let a =
            [(rough(here), here), (rough(shifted(50.0)), shifted(1.0)), (rough(shifted(2.0)), shifted(2.0))];
        let b = [(rough(shifted(3.0)), here)];
        assert_eq!(of_groups(&a, &b, &shifted(3.0)), 0.0);
        assert_relative_eq!(of_groups(&a, &b, &shifted(40.0)), WORST, epsilon = 1e-9);
    }

    #[test]
    fn what_turns_the_vertical_over_costs_ln_100_and_what_turns_about_it_nothing() {
        let here = RigidMotion::identity();
        let z = upright(Vector3::z());
        let of = |axis: Vector3<f64>| of_groups(&[(z, here)], &[(z, here)], &RigidMotion::rotation(axis));
        assert_eq!(of(Vector3::z() * 3.0), 0.0);
        assert_relative_eq!(of(Vector3::x() * std::f64::consts::PI), WORST, epsilon = 1e-9);
        // A tilt of 0.4: 0.16 / 0.02 is 6 beyond an expectation of 2.
        assert_relative_eq!(of(Vector3::y() * 0.4), -(0.99 * (-3.0f64).exp() + 0.01).ln(), epsilon = 1e-9);
        // The vertical of a scan that lies on its side is what its own prior says.
        let lying = upright(Vector3::x());
        let quarter = RigidMotion::rotation(Vector3::y() * -std::f64::consts::FRAC_PI_2);
        assert_relative_eq!(of_groups(&[(z, here)], &[(lying, here)], &quarter), 0.0, epsilon = 1e-9);
        assert!(of_groups(&[(z, here)], &[(lying, here)], &here) > 4.0);
    }

    #[test]
    fn matches_that_rough_poses_rule_out_are_left_out() {
        let (target, source) =
            (rough(RigidMotion::identity()), rough(RigidMotion::translation(1.0, 0.0, 0.0)));
        let point = |x: f32| Point::new(x, 0.0, 0.0);
        // Three deviations of sqrt(2 · 0.3² + (0.1 · x)² + …) and τ: about 1.5 m.
        let matches = Matches {
            pairs: vec![(0, 7), (1, 8), (2, 9)],
            source: vec![point(0.0), point(1.0), point(2.0)],
            target: vec![point(1.2), point(9.0), point(2.0)],
            scores: vec![0.1, 0.2, 0.3],
        };
        let kept = allowed(&target, &source, &matches, 0.1).unwrap();
        assert_eq!(kept.pairs, [(0, 7), (2, 9)]);
        assert_eq!((kept.scores, kept.source[1], kept.target[1]), (vec![0.1, 0.3], point(2.0), point(2.0)));
        assert_eq!(allowed(&target, &PosePrior::default(), &matches, 0.1), None);
    }

    #[test]
    fn scans_that_rough_poses_put_beside_each_other_are_compared() {
        let (surface, features) =
            (surface(), Features::new(Vec::new(), None, Descriptors::new(1, Vec::new()).unwrap()).unwrap());
        let at = |x: Option<f64>| {
            let prior = x.map_or(PosePrior::default(), |x| rough(RigidMotion::translation(x, 0.0, 0.0)));
            ScanInput { prior, ..ScanInput::new(&features, &surface) }
        };
        // Radius 1 m and three deviations of 0.3 m each: up to 3.8 m.
        let scans = [at(Some(0.0)), at(Some(3.5)), at(None), at(Some(7.5)), at(Some(0.5))];
        let all: Vec<ScanId> = (0..5).map(ScanId).collect();
        let pairs = |k: usize| -> Vec<(usize, usize)> {
            near_pairs(&scans, &all, k).into_iter().map(|(i, j)| (i.0, j.0)).collect()
        };
        assert_eq!(pairs(4), [(0, 1), (0, 4), (1, 4)]);
        assert_eq!(pairs(1), [(0, 4), (1, 4)]);
    }

    #[test]
    fn settings_make_priors_in_the_frames_of_the_scans() {
        let config = PriorConfig {
            initial_poses: true,
            up: Some(Axis::MinusY),
            rotation_deviation_deg: 180.0 / std::f64::consts::PI,
            ..PriorConfig::default()
        };
        // A quarter turn about z takes local x to y of the file: −y of the file is −x of the scan.
        let file_from_local = RigidMotion::rotation(Vector3::z() * std::f64::consts::FRAC_PI_2);
        let pose = RigidMotion::translation(1.0, 2.0, 3.0);
        let found =
            priors(&config, 0.07, [(Some(pose), file_from_local), (None, file_from_local)].into_iter());
        let rough = found[0].rough.unwrap();
        assert_relative_eq!(rough.position_deviation_m, 0.7);
        assert_relative_eq!(rough.rotation_deviation_rad, 1.0);
        assert_eq!((rough.world_from_scan, found[1].rough), (pose, None));
        assert_relative_eq!(found[1].up.unwrap().direction, -Vector3::x(), epsilon = 1e-12);
        let unused = priors(&PriorConfig::default(), 0.07, [(Some(pose), file_from_local)].into_iter());
        assert_eq!(unused, [PosePrior::default()]);
    }
}
