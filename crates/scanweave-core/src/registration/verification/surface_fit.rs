//! How the surfaces of two groups of posed scans sit on each other, and the small motion that
//! makes them sit better.
//!
//! One pass over sampled points gives everything: what touches, whether normals agree there,
//! the distance to tangent planes (with the normal equations that reduce it; Chen & Medioni
//! 1991), and how much of either side lies in space that the other saw to be empty.

use crate::geometry::nearest_map::NO_POINT;
use crate::geometry::rigid::PointMover;
use crate::geometry::{Point, RigidMotion};
use crate::registration::scan_model::ScanModel;
use crate::registration::verification::probability::USUAL_VIOLATION;
use nalgebra::{Matrix6, Point3, Vector3, Vector6};
use rayon::prelude::*;

/// Points further in front of a seen surface than this many radii contradict it.
const MARGIN: f32 = 3.0;
/// Two scans are compared only where every n-th point shows that they meet.
const COARSE_STRIDE: usize = 8;

/// A scan at a pose in the frame of its group.
#[derive(Clone, Copy)]
pub struct Posed<'a> {
    /// The scan's surface.
    pub model: &'a ScanModel<'a>,
    /// Its pose in the group's frame.
    pub group_from_scan: RigidMotion,
}

/// How two groups of surfaces sit on each other.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SurfaceFit {
    /// Touching points, in units of the points sampled from one scan: what a scan would have
    /// that lay on known surface altogether is 1. The smaller of the two sides.
    pub overlap: f64,
    /// Share of the touching points whose normals agree within 45°, in `[0, 1]`.
    pub normal_agreement: f64,
    /// Root mean square distance to the tangent planes where normals agree, in units of the radius.
    pub plane_residual: f64,
    /// Points in space that a scan of the other group saw to be empty, each as far as that scan's
    /// viewpoint is reliable, over these and the touching ones, in `[0, 1]`; of what is not reliable
    /// the usual violation of a correct pose.
    pub free_space_violation: f64,
    /// For points of either group those in space that the other saw to be empty, whatever the
    /// reliability, over the touching ones of both.
    pub seen_through: [f64; 2],
    /// Smallest eigenvalue of the information about the relative pose per touching point,
    /// lengths in units of the spread of these points: 0 where some motion is free.
    pub localizability: f64,
}

/// Sums over the sampled points of both groups.
#[derive(Debug, Clone)]
pub(super) struct Sums {
    touching: [usize; 2],
    pub(super) agreeing: usize,
    /// Points in space seen to be empty by side, and each as far as that is reliable.
    seen_through: [usize; 2],
    violating: f64,
    squared: f64,
    /// Σ w h hᵀ, lower part by columns, and Σ w r h of a left perturbation of group b, h = [x×n; n].
    information: [f64; 21],
    pub(super) gradient: Vector6<f64>,
    /// Whether w is Tukey's weight of the residual r, to align by, or 1, for the localizability.
    weighted: bool,
    /// Σ x and Σ |x|² over agreeing points, for the localizability.
    sum: Vector3<f64>,
    square: f64,
}

impl Sums {
    fn new(weighted: bool) -> Self {
        Self {
            touching: [0; 2],
            agreeing: 0,
            seen_through: [0; 2],
            violating: 0.0,
            squared: 0.0,
            information: [0.0; 21],
            gradient: Vector6::zeros(),
            weighted,
            sum: Vector3::zeros(),
            square: 0.0,
        }
    }

    /// Σ w h hᵀ.
    pub(super) fn information(&self) -> Matrix6<f64> {
        let mut full = Matrix6::zeros();
        let mut at = 0;
        for c in 0..6 {
            for r in c..6 {
                full[(r, c)] = self.information[at];
                full[(c, r)] = self.information[at];
                at += 1;
            }
        }
        full
    }
}

/// What the scans of the other group say of one point: distance to the nearest agreeing tangent
/// plane with the point and normal there, or that only disagreeing surface is near.
#[derive(Clone, Copy)]
enum Touch {
    Nothing,
    Disagreeing,
    Agreeing { off: f32, world: Point3<f64>, normal: Vector3<f64> },
}

/// Measures group `b` moved by `a_from_b` against group `a`, within the radius of the models' grids.
///
/// Every `stride`-th sampled point is looked at.
pub fn surface_fit(a: &[Posed<'_>], b: &[Posed<'_>], a_from_b: &RigidMotion, stride: usize) -> SurfaceFit {
    let sums = pass(a, b, a_from_b, stride, None);
    let Some(first) = a.first().or(b.first()) else { return SurfaceFit::default() };
    let radius_m = f64::from(first.model.radius_m);
    let touching = (sums.touching[0] + sums.touching[1]) as f64;
    let per_scan = |group: &[Posed<'_>]| {
        group.iter().map(|p| p.model.sample.len().div_ceil(stride)).max().unwrap_or(0).max(1) as f64
    };
    SurfaceFit {
        overlap: (sums.touching[0] as f64 / per_scan(a)).min(sums.touching[1] as f64 / per_scan(b)),
        normal_agreement: sums.agreeing as f64 / touching.max(1.0),
        plane_residual: (sums.squared / sums.agreeing.max(1) as f64).sqrt() / radius_m,
        free_space_violation: violation(sums.violating / touching.max(1.0), mean_reliability(a, b)),
        seen_through: sums.seen_through.map(|n| n as f64 / touching.max(1.0)),
        localizability: localizability(&sums),
    }
}

/// The free-space violation of so many violating points a touching one, each counted as far as it is
/// reliable, where so much is on the whole.
pub(crate) fn violation(violating_per_touching: f64, reliability: f64) -> f64 {
    let judged = violating_per_touching / (violating_per_touching + 1.0);
    (judged + (1.0 - reliability) * USUAL_VIOLATION).min(1.0)
}

/// Mean reliability of the viewpoints of two groups.
fn mean_reliability(a: &[Posed<'_>], b: &[Posed<'_>]) -> f64 {
    let of = |group: &[Posed<'_>]| {
        let sum: f64 = group.iter().map(|p| p.model.viewpoint_reliability).sum();
        sum / group.len().max(1) as f64
    };
    0.5 * (of(a) + of(b))
}

/// Who is compared with whom: side, place of the scan in its group, place in the other group.
pub(super) type Contact = (usize, usize, usize);

/// Sums over the points of both groups. With `contacts`, only those scans are compared, and
/// free space is not judged; an empty list is filled with all scans that touch.
pub(super) fn pass(
    a: &[Posed<'_>],
    b: &[Posed<'_>],
    a_from_b: &RigidMotion,
    stride: usize,
    mut contacts: Option<&mut Vec<Contact>>,
) -> Sums {
    let mut sums = Sums::new(contacts.is_some());
    let known = contacts.as_deref().filter(|c| !c.is_empty()).cloned();
    let identity = RigidMotion::identity();
    // Points of a on b's surfaces, then the other way round; world is the frame of a.
    for (side, (from, from_motion, to, to_motion)) in
        [(a, &identity, b, a_from_b), (b, a_from_b, a, &identity)].into_iter().enumerate()
    {
        let to_poses: Vec<RigidMotion> = to.iter().map(|t| to_motion * t.group_from_scan).collect();
        let check_free_space = contacts.is_none();
        // Scans side by side; summed up in their order, so that the sums are the same to the bit.
        let compared: Vec<(Touches<'_>, Vec<Contact>)> = from
            .par_iter()
            .enumerate()
            .map(|(f, scan)| {
                let mut points = Touches::new(scan.model, from_motion * scan.group_from_scan, stride);
                let mut touching = Vec::new();
                for (t, (other, world_from_other)) in to.iter().zip(&to_poses).enumerate() {
                    if known.as_ref().is_some_and(|k| k.binary_search(&(side, f, t)).is_err()) {
                        continue;
                    }
                    if points.compare(other.model, world_from_other, check_free_space) {
                        touching.push((side, f, t));
                    }
                }
                (points, touching)
            })
            .collect();
        for (points, touching) in compared {
            points.add_to(&mut sums, side);
            if let (None, Some(found)) = (&known, contacts.as_deref_mut()) {
                found.extend(touching);
            }
        }
    }
    sums
}

/// The sampled points of one scan while the scans of the other group are gone through.
struct Touches<'a> {
    model: &'a ScanModel<'a>,
    world_from_scan: RigidMotion,
    rows: Vec<usize>,
    touches: Vec<Touch>,
    /// Reliability of the most reliable scan that saw the space there to be empty.
    violated: Vec<Option<f64>>,
}

impl<'a> Touches<'a> {
    fn new(model: &'a ScanModel<'a>, world_from_scan: RigidMotion, stride: usize) -> Self {
        let rows: Vec<usize> = model.sample.iter().step_by(stride).map(|&i| i as usize).collect();
        let (touches, violated) = (vec![Touch::Nothing; rows.len()], vec![None; rows.len()]);
        Self { model, world_from_scan, rows, touches, violated }
    }

    /// Takes in one scan of the other group; whether any point touches it.
    fn compare(
        &mut self,
        other: &ScanModel<'_>,
        world_from_other: &RigidMotion,
        check_free_space: bool,
    ) -> bool {
        let model = self.model;
        let other_from_scan = world_from_other.inverse() * self.world_from_scan;
        let centre = other_from_scan * model.centre.cast::<f64>();
        let apart = (centre - other.centre.cast::<f64>()).norm();
        let radius_m = other.radius_m;
        // What a scan saw lies within its sphere, and so does the space that it saw through.
        if apart > f64::from(model.reach_m + other.reach_m + radius_m) {
            return false;
        }
        let mover = PointMover::new(&other_from_scan);
        let meets = |row: &usize| {
            let moved = mover.point(&model.surface.points[*row]);
            other.near(&moved, radius_m).is_some() || (check_free_space && violates_free_space(other, &moved))
        };
        if !self.rows.iter().step_by(COARSE_STRIDE).any(meets) {
            return false;
        }
        let mut touched = false;
        let moved: Vec<Point> =
            self.rows.iter().map(|&row| mover.point(&model.surface.points[row])).collect();
        let near = other.near_each(&moved, radius_m);
        let state = self.touches.iter_mut().zip(&mut self.violated);
        for (((&row, moved), near), (touch, violated)) in self.rows.iter().zip(moved).zip(near).zip(state) {
            if near != NO_POINT {
                let near = near as usize;
                touched = true;
                let n = other.surface.normals[near];
                let off = n.dot(&(moved - other.surface.points[near]));
                if !model.same_side(other, n.dot(&mover.direction(&model.surface.normals[row]))) {
                    if matches!(touch, Touch::Nothing) {
                        *touch = Touch::Disagreeing;
                    }
                } else if !matches!(touch, Touch::Agreeing { off: old, .. } if old.abs() <= off.abs()) {
                    let world = world_from_other * moved.cast::<f64>();
                    let normal = world_from_other.rotation * n.cast::<f64>();
                    *touch = Touch::Agreeing { off, world, normal };
                }
            } else if check_free_space
                && violated.is_none_or(|r| r < other.viewpoint_reliability)
                && violates_free_space(other, &moved)
            {
                *violated = Some(other.viewpoint_reliability);
            }
        }
        touched
    }

    fn add_to(&self, sums: &mut Sums, side: usize) {
        let radius_m = f64::from(self.model.radius_m);
        for (touch, &violated) in self.touches.iter().zip(&self.violated) {
            add(sums, side, touch, violated, radius_m);
        }
    }
}

/// Whether a place in a scan's frame lies in space that the scan saw to be empty.
#[inline]
fn violates_free_space(other: &ScanModel<'_>, place: &Point) -> bool {
    other.free_space.in_front_m(place).is_some_and(|m| m > MARGIN * other.radius_m)
}

fn add(sums: &mut Sums, side: usize, touch: &Touch, violated: Option<f64>, radius_m: f64) {
    match *touch {
        Touch::Nothing => {
            sums.seen_through[side] += usize::from(violated.is_some());
            sums.violating += violated.unwrap_or(0.0);
        }
        Touch::Disagreeing => sums.touching[side] += 1,
        Touch::Agreeing { off, world, normal } => {
            sums.touching[side] += 1;
            sums.agreeing += 1;
            let r = f64::from(off);
            sums.squared += r * r;
            let m = world.coords.cross(&normal);
            let h = Vector6::new(m.x, m.y, m.z, normal.x, normal.y, normal.z);
            let w = if sums.weighted { (1.0 - (r / radius_m).powi(2)).max(0.0).powi(2) } else { 1.0 };
            let mut at = 0;
            for c in 0..6 {
                let wh = w * h[c];
                for r in c..6 {
                    sums.information[at] += wh * h[r];
                    at += 1;
                }
            }
            // The residual n·(x − y) grows with a motion of x: b's points move along h, and
            // where a's points lie on b's planes the planes move instead.
            let sign = if side == 1 { 1.0 } else { -1.0 };
            sums.gradient += h * (sign * w * r);
            sums.sum += world.coords;
            sums.square += world.coords.norm_squared();
        }
    }
}

/// Smallest eigenvalue of Σ g gᵀ / n with g = [(x − c)×n / s; n], c the centroid and s the spread
/// (root mean square distance from it) of the agreeing points (Gelfand et al. 2003).
fn localizability(sums: &Sums) -> f64 {
    let n = sums.agreeing as f64;
    if n < 6.0 {
        return 0.0;
    }
    let c = sums.sum / n;
    let spread = (sums.square / n - c.norm_squared()).max(0.0).sqrt();
    if spread <= 0.0 {
        return 0.0;
    }
    let mut m = Matrix6::identity();
    m.fixed_view_mut::<3, 3>(0, 3).copy_from(&-c.cross_matrix());
    let mut h = m * sums.information() * m.transpose() / n;
    let scale = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, spread, spread, spread)) / spread;
    h = scale * h * scale;
    h.symmetric_eigenvalues().min().max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Direction;
    use crate::scan::Surface;
    use approx::assert_relative_eq;

    /// A 2 m square at z = 0, every 5 cm, normals up, seen from 1.5 m above its corner.
    fn floor() -> Surface {
        Surface {
            points: (0..1600)
                .map(|i| Point::new((i % 40) as f32 * 0.05, (i / 40) as f32 * 0.05, 0.0))
                .collect(),
            normals: vec![Direction::z(); 1600],
            viewpoint: Point::new(0.0, 0.0, 1.5),
            viewpoint_confidence: 1.0,
            ..Surface::default()
        }
    }

    /// Three mutually perpendicular walls, 2 m wide, every 2.5 cm, seen from inside.
    fn corner() -> Surface {
        let mut surface =
            Surface { viewpoint: Point::new(1.5, 1.5, 1.5), viewpoint_confidence: 1.0, ..Surface::default() };
        for i in 0..6400 {
            let (u, v) = ((i % 80) as f32 * 0.025, (i / 80) as f32 * 0.025);
            surface.points.extend([[u, v, 0.0], [u, 0.0, v], [0.0, u, v]].map(Point::from));
            surface.normals.extend([Direction::z(), Direction::y(), Direction::x()]);
        }
        surface
    }

    fn between(a: &Surface, b: &Surface, a_from_b: &RigidMotion) -> SurfaceFit {
        fn model(surface: &Surface) -> ScanModel<'_> {
            let mut model = ScanModel::with_sizes(surface, 0.07, 10_000, 0.14);
            model.viewpoint_reliability = 1.0;
            model
        }
        let (a, b) = (model(a), model(b));
        let posed = |model| Posed { model, group_from_scan: RigidMotion::identity() };
        surface_fit(&[posed(&a)], &[posed(&b)], a_from_b, 1)
    }

    #[test]
    fn half_a_floor_two_centimetres_up_has_half_the_overlap_and_that_residual() {
        let fit = between(&floor(), &floor(), &RigidMotion::translation(1.0, 0.0, 0.02));
        // 20 of 40 columns lie on columns; one more reaches over the edge by 5 cm.
        assert_relative_eq!(fit.overlap, 21.0 / 40.0, epsilon = 1e-9);
        assert_relative_eq!(fit.normal_agreement, 1.0);
        assert_relative_eq!(fit.plane_residual, 0.02 / 0.07, epsilon = 1e-4);
        // A plane can slide two ways and spin: nothing holds it.
        assert_relative_eq!(fit.localizability, 0.0, epsilon = 1e-9);
    }

    #[test]
    fn a_floor_upside_down_does_not_agree() {
        let turned = RigidMotion::rotation(Vector3::x() * std::f64::consts::PI);
        let fit = between(&floor(), &floor(), &(RigidMotion::translation(0.0, 1.95, 0.0) * turned));
        assert_relative_eq!(fit.overlap, 1.0, epsilon = 0.01);
        assert_eq!(fit.normal_agreement, 0.0);
    }

    #[test]
    fn a_floor_hanging_in_the_air_lies_in_space_seen_to_be_empty() {
        // 40 cm above the floor and below the viewpoint: nearly all of it is in front of the other
        // floor (all but what lies beyond its edge as seen from above); the lower one lies behind.
        let fit = between(&floor(), &floor(), &RigidMotion::translation(0.0, 0.0, 0.4));
        assert_eq!(fit.overlap, 0.0);
        // Nothing touches: one point that did would be the rest.
        assert!(fit.free_space_violation > 0.998, "{fit:?}");
        let apart = between(&floor(), &floor(), &RigidMotion::translation(0.0, 0.0, -20.0));
        assert_eq!(apart.free_space_violation, 0.0);
    }

    #[test]
    fn three_perpendicular_planes_are_as_localizable_as_their_closed_form_says() {
        // Squares of side L: the centroid is L/3 in every coordinate, the spread L/√3. With A the
        // rotational block, B the mixed one and I/3 the translational one, A = I/4 − J/36 (J all
        // ones) and B = √3/18·[(1,1,1)]×. Across (1,1,1) that is [[1/4, 1/6], [1/6, 1/3]], whose
        // least eigenvalue is (7 − √17)/24; along it the eigenvalues are 1/6 and 1/3.
        let fit = between(&corner(), &corner(), &RigidMotion::identity());
        let expected = (7.0 - 17f64.sqrt()) / 24.0;
        assert_relative_eq!(fit.localizability, expected, max_relative = 0.02);
    }
}
