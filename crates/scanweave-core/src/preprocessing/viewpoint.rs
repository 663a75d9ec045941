//! Where a scan was taken from, as far as its points tell.
//!
//! A scan taken from one place does not hide its own points. The share of a surface that lies
//! hidden behind other parts of it, as seen from a presumed place, therefore says how well the place
//! goes with the scan, without any pose and in any coordinates. The place that hides least is
//! looked for; one that is presumed, because the file states it or because most sensors have their zero
//! in themselves, is kept unless it hides much more.

use crate::geometry::occupancy::size_for_occupancy;
use crate::geometry::voxel::VoxelGroups;
use crate::geometry::{Direction, Point};
use nalgebra::Vector3;

/// Elements whose side of a plane is looked at.
const PROBES: usize = 300;
/// Surface elements that are looked at.
const ELEMENTS: usize = 3000;
/// What is further behind an element than so many spacings of the elements is hidden by it.
const BEHIND: f32 = 3.0;
/// An element hides what lies so many spacings beside it, as seen from the place.
const ASIDE: f32 = 0.6;
/// Width of a direction cell, in spacings at the distance of the elements: wide enough that a closed
/// surface leaves no cell free.
const CELL: f32 = 1.0;
/// Least and greatest width of a direction cell, radians.
const CELL_RANGE: (f32, f32) = (0.02, 0.2);
/// Distances of the first candidates from the middle, in sizes of the scan.
const DISTANCES: [f32; 4] = [0.5, 1.0, 1.7, 3.0];
/// Best candidates that are improved.
const STARTS: usize = 4;
/// First and last step of the improvement, in sizes of the scan.
const STEPS: (f32, f32) = (0.3, 0.03);
/// Hidden share that a distance of one size counts as: of places that hide equally little the nearest.
const PER_DISTANCE: f32 = 0.005;
/// Hidden share that turning all elements to the side where least of the scan lies counts as: what lies
/// on the far side of a wall is hidden from most of its room.
const PER_OUTSIDE: f32 = 0.1;
/// A presumed viewpoint may hide so much more than the best one: fused scans, moving people and lenses
/// that see around edges do not make it wrong.
const PLAUSIBLE: f32 = 0.15;

/// A place that a surface was seen from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenFrom {
    /// The place, in the frame of the surface.
    pub viewpoint: Point,
    /// Share of the surface that is hidden from there, in `[0, 1]`.
    pub hidden_share: f32,
    /// How far the shape tells it from a place on the other side of the surface, in `[0, 1]`; 1 for a
    /// presumed place that goes with the shape.
    pub confidence: f32,
}

/// What the shape of one scan says of where it was seen from.
#[derive(Debug, Clone, Copy)]
pub struct ViewpointStudy {
    /// The place that the file states, and how much speaks against it.
    stated: Option<(f32, SeenFrom)>,
    /// The same for the zero of the file's coordinates.
    zero: (f32, SeenFrom),
    /// The same for the best place that was found.
    found: (f32, SeenFrom),
}

impl ViewpointStudy {
    /// Judges the place that the file may state and its zero, and searches for the best place.
    ///
    /// `normals` may point to either side. Depends on the shape and on what is presumed: a motion of
    /// both moves the answer.
    pub fn new(points: &[Point], normals: &[Direction], stated: Option<Point>, file_zero: Point) -> Self {
        let Some(elements) = Elements::new(points, normals) else {
            let nowhere = |viewpoint| (0.0, SeenFrom { viewpoint, hidden_share: 0.0, confidence: 0.0 });
            return Self { stated: stated.map(nowhere), zero: nowhere(file_zero), found: nowhere(file_zero) };
        };
        let mut scratch = Vec::new();
        let [mut found, opposite] = elements.best_of_either_side(&mut scratch);
        // By what is hidden alone: where most of the scan lies is a guess, which objects belie.
        let hides_more = opposite.1.hidden_share - found.1.hidden_share;
        found.1.confidence = (hides_more / PLAUSIBLE).clamp(0.0, 1.0);
        let mut presumed = |place: Point| {
            let (against, seen_from) = elements.judged(place, &mut scratch);
            (against, SeenFrom { confidence: 1.0, ..seen_from })
        };
        Self { stated: stated.map(&mut presumed), zero: presumed(file_zero), found }
    }

    /// As numbers, for files.
    pub(crate) fn to_numbers(self) -> Vec<f32> {
        let of = |(against, seen): (f32, SeenFrom)| {
            let SeenFrom { viewpoint: v, hidden_share, confidence } = seen;
            [against, v.x, v.y, v.z, hidden_share, confidence]
        };
        let all = [Some(self.zero), Some(self.found), self.stated];
        all.into_iter().flatten().flat_map(of).collect()
    }

    /// What [`Self::to_numbers`] gave.
    pub(crate) fn of_numbers(numbers: &[f32]) -> Option<Self> {
        let of = |&[against, x, y, z, hidden_share, confidence]: &[f32; 6]| {
            (against, SeenFrom { viewpoint: Point::new(x, y, z), hidden_share, confidence })
        };
        match numbers.as_chunks::<6>() {
            ([zero, found, stated @ ..], []) if stated.len() <= 1 => {
                Some(Self { stated: stated.first().map(of), zero: of(zero), found: of(found) })
            }
            _ => None,
        }
    }

    /// The stated place where it goes with the shape.
    fn stated(&self) -> Option<SeenFrom> {
        self.stated.filter(|s| s.0 <= self.found.0 + PLAUSIBLE).map(|s| s.1)
    }

    /// Whether the file's zero goes with the shape; `None` where the file states another place that does.
    fn is_zero_plausible(&self) -> Option<bool> {
        self.stated().is_none().then_some(self.zero.0 <= self.found.0 + PLAUSIBLE)
    }

    /// Where each of the scans of one collection was seen from: where its file states it and that goes
    /// with its shape, or else the file's zero, or what was found.
    ///
    /// Whether files have the sensor at their zero is a habit of who wrote them: where the zero goes with
    /// the shape of most scans it is taken for all that it does not go with very badly, and for none
    /// where it goes with few.
    pub fn decide(studies: &[Self]) -> Vec<SeenFrom> {
        let plausible: Vec<bool> = studies.iter().filter_map(Self::is_zero_plausible).collect();
        let most = 2 * plausible.iter().filter(|p| **p).count() > plausible.len();
        let margin = if most { 2.0 * PLAUSIBLE } else { f32::NEG_INFINITY };
        let of = |study: &Self| {
            let zero = (study.zero.0 <= study.found.0 + margin).then_some(study.zero.1);
            study.stated().or(zero).unwrap_or(study.found.1)
        };
        studies.iter().map(of).collect()
    }

    /// The best place that was found.
    pub fn found(&self) -> SeenFrom {
        self.found.1
    }
}

/// Small pieces of a surface.
struct Elements {
    points: Vec<Point>,
    normals: Vec<Direction>,
    /// Of every element how much more of the scan lies in front of its plane than behind, in
    /// `[−1, 1]`.
    in_front: Vec<f32>,
    spacing_m: f32,
    centre: Point,
    size_m: f32,
}

impl Elements {
    /// One element a cell of a grid that has about [`ELEMENTS`]; `None` for points at one place.
    fn new(points: &[Point], normals: &[Direction]) -> Option<Self> {
        if points.is_empty() {
            return None;
        }
        let middle =
            points.iter().map(|p| p.coords.cast::<f64>()).sum::<Vector3<f64>>() / points.len() as f64;
        let centre = Point::from(middle.cast::<f32>());
        let mut away: Vec<f32> = points.iter().map(|p| (p - centre).norm()).collect();
        let at = away.len() / 2;
        let size_m = *away.select_nth_unstable_by(at, f32::total_cmp).1;
        if !(size_m > 0.0 && size_m.is_finite()) {
            return None;
        }
        let cells = ELEMENTS.min(points.len());
        let first_guess = 2.0 * f64::from(size_m) / (cells as f64).sqrt();
        let spacing_m = size_for_occupancy(points, cells, first_guess) as f32;
        let nearest_to_mean = |group: &[u32]| {
            let sum: Vector3<f32> = group.iter().map(|&i| points[i as usize].coords).sum();
            let mean = Point::from(sum / group.len() as f32);
            let away = |&i: &u32| (points[i as usize] - mean).norm_squared();
            group.iter().copied().min_by(|a, b| away(a).total_cmp(&away(b)))
        };
        let groups = VoxelGroups::new(points, spacing_m);
        let chosen: Vec<usize> = groups.iter().filter_map(nearest_to_mean).map(|i| i as usize).collect();
        let points: Vec<Point> = chosen.iter().map(|&i| points[i]).collect();
        let normals: Vec<Direction> = chosen.iter().map(|&i| normals[i]).collect();
        let step = points.len().div_ceil(PROBES).max(1);
        let excess = |(p, n): (&Point, &Direction)| {
            let (mut front, mut behind) = (0u32, 0u32);
            for q in points.iter().step_by(step) {
                let off = n.dot(&(q - p));
                front += u32::from(off > 2.0 * spacing_m);
                behind += u32::from(off < -2.0 * spacing_m);
            }
            (front as f32 - behind as f32) / (front + behind).max(1) as f32
        };
        let in_front = points.iter().zip(&normals).map(excess).collect();
        Some(Self { points, normals, in_front, spacing_m, centre, size_m })
    }

    /// Share of the elements that turn the side to a place which most of the scan lies behind, by how
    /// much more that is.
    fn outside_share(&self, viewpoint: &Point) -> f32 {
        let (mut outside, mut all) = (0.0, 0.0);
        for ((p, n), m) in self.points.iter().zip(&self.normals).zip(&self.in_front) {
            let weight = m * m;
            all += weight;
            if n.dot(&(viewpoint - p)) * m < 0.0 {
                outside += weight;
            }
        }
        if all > 0.0 { outside / all } else { 0.0 }
    }

    /// How much speaks against a place, as a hidden share.
    fn judged(&self, viewpoint: Point, scratch: &mut Vec<Seen>) -> (f32, SeenFrom) {
        let hidden_share = self.hidden_share(&viewpoint, scratch);
        let distance = (viewpoint - self.centre).norm() / self.size_m;
        let against = hidden_share + PER_DISTANCE * distance + PER_OUTSIDE * self.outside_share(&viewpoint);
        (against, SeenFrom { viewpoint, hidden_share, confidence: 0.0 })
    }

    /// The place that least speaks against, and of those that see most elements from the other side the
    /// one that least does: around the surface and inside it, the best ones improved.
    fn best_of_either_side(&self, scratch: &mut Vec<Seen>) -> [(f32, SeenFrom); 2] {
        let directions = directions();
        let around = DISTANCES.iter().flat_map(|d| directions.iter().map(move |u| u * *d));
        let places = std::iter::once(Vector3::zeros()).chain(around);
        let mut candidates: Vec<(f32, SeenFrom)> =
            places.map(|away| self.judged(self.centre + away * self.size_m, scratch)).collect();
        candidates.sort_by(|x, y| x.0.total_cmp(&y.0));
        let best = self.best_near(candidates.iter().take(STARTS), &directions, |_| true, scratch);
        let opposite = |place: &Point| self.on_other_side(&best.1.viewpoint, place);
        let others = candidates.iter().filter(|c| opposite(&c.1.viewpoint)).take(STARTS / 2);
        [best, self.best_near(others, &directions, opposite, scratch)]
    }

    /// The best of the allowed places that small steps from these lead to.
    fn best_near<'c>(
        &self,
        starts: impl Iterator<Item = &'c (f32, SeenFrom)>,
        directions: &[Vector3<f32>],
        allowed: impl Fn(&Point) -> bool,
        scratch: &mut Vec<Seen>,
    ) -> (f32, SeenFrom) {
        let improved = starts.map(|start| {
            let (mut best, mut step) = (*start, STEPS.0);
            while step > STEPS.1 {
                let around = directions.iter().map(|u| best.1.viewpoint + u * (step * self.size_m));
                let around = around.filter(|place| allowed(place)).map(|place| self.judged(place, scratch));
                match around.min_by(|x, y| x.0.total_cmp(&y.0)) {
                    Some(better) if better.0 < best.0 => best = better,
                    _ => step /= 2.0,
                }
            }
            best
        });
        let nowhere = SeenFrom { viewpoint: self.centre, hidden_share: 1.0, confidence: 0.0 };
        improved.min_by(|x, y| x.0.total_cmp(&y.0)).unwrap_or((f32::INFINITY, nowhere))
    }

    /// Whether most elements turn different sides to two places.
    fn on_other_side(&self, one: &Point, other: &Point) -> bool {
        let turned = |(p, n): (&Point, &Direction)| n.dot(&(one - p)) * n.dot(&(other - p)) < 0.0;
        let turned = self.points.iter().zip(&self.normals).filter(|e| turned(*e)).count();
        2 * turned > self.points.len()
    }

    /// Share of the elements that are hidden from a place by others.
    fn hidden_share(&self, viewpoint: &Point, scratch: &mut Vec<Seen>) -> f32 {
        let distance = ((viewpoint - self.centre).norm_squared() + self.size_m.powi(2)).sqrt();
        let width = (CELL * self.spacing_m / distance).clamp(CELL_RANGE.0, CELL_RANGE.1);
        let cells = (2.0 / width).ceil() as usize;
        // The nearest element of every direction cell, on the faces of a cube.
        let mut nearest = vec![(f32::INFINITY, u32::MAX); 6 * cells * cells];
        scratch.clear();
        for (i, p) in self.points.iter().enumerate() {
            let away = p - viewpoint;
            let distance = away.norm().max(f32::MIN_POSITIVE);
            let cell = cell_of(&away, cells);
            scratch.push(Seen { direction: away / distance, distance, cell });
            if distance < nearest[cell].0 {
                nearest[cell] = (distance, i as u32);
            }
        }
        let behind = BEHIND * self.spacing_m;
        let is_hidden = |seen: &&Seen| {
            let (first, at) = nearest[seen.cell];
            if first >= seen.distance - behind {
                return false;
            }
            // Beside the line of sight nothing hides.
            let ahead = self.points[at as usize] - viewpoint;
            let aside = (ahead - seen.direction * ahead.dot(&seen.direction)).norm_squared();
            if aside > (ASIDE * self.spacing_m).powi(2) {
                return false;
            }
            // Where the line of sight meets the plane of the element in front: a floor seen at a low
            // angle does not hide itself.
            let normal = &self.normals[at as usize];
            let (along, off) =
                (normal.dot(&seen.direction), normal.dot(&(self.points[at as usize] - viewpoint)));
            let met = if along == 0.0 { first } else { off / along };
            met.clamp(first - behind, first + behind) < seen.distance - behind
        };
        let hidden = scratch.iter().filter(is_hidden).count();
        hidden as f32 / self.points.len() as f32
    }
}

/// An element as seen from a place.
struct Seen {
    direction: Direction,
    distance: f32,
    cell: usize,
}

/// Cell of a direction on the faces of a cube with `cells`² each.
fn cell_of(away: &Vector3<f32>, cells: usize) -> usize {
    let face = away.iamax();
    let largest = away[face].abs().max(f32::MIN_POSITIVE);
    let on_face = |axis: usize| {
        let share = 0.5 * (away[(face + axis) % 3] / largest + 1.0);
        ((share * cells as f32) as usize).min(cells - 1)
    };
    let side = 2 * face + usize::from(away[face] > 0.0);
    (side * cells + on_face(1)) * cells + on_face(2)
}

/// Unit vectors to the faces, edges and corners of a cube.
fn directions() -> Vec<Vector3<f32>> {
    let grid =
        (0..27).map(|k| Vector3::new((k % 3) as f32, (k / 3 % 3) as f32, (k / 9) as f32).add_scalar(-1.0));
    grid.filter_map(|d| d.try_normalize(0.5)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rigid::{PointMover, RigidMotion};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// What a camera at `eye` sees of a room 6 × 5 × 3 m with a table and two boxes in it: the
    /// nearest wall or face in each of many directions, with its normal.
    fn room(eye: Point) -> (Vec<Point>, Vec<Direction>) {
        let boxes: [([f32; 3], [f32; 3]); 4] = [
            ([0.0, 0.0, 0.0], [6.0, 5.0, 3.0]),
            ([2.0, 1.0, 0.7], [3.5, 2.0, 0.8]),
            ([4.5, 3.5, 0.0], [5.5, 4.5, 2.0]),
            ([0.5, 3.5, 0.0], [1.2, 4.6, 1.2]),
        ];
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut seen = (Vec::new(), Vec::new());
        for _ in 0..20_000 {
            let u = Vector3::from_fn(|_, _| rng.random_range(-1.0f32..1.0)).normalize();
            let mut best = (f32::INFINITY, Direction::zeros());
            for (k, (low, high)) in boxes.iter().enumerate() {
                for axis in 0..3 {
                    for face in [low[axis], high[axis]] {
                        let t = (face - eye[axis]) / u[axis];
                        let p = eye + u * t;
                        let inside = |a: usize| a == axis || (low[a] - 1e-4..=high[a] + 1e-4).contains(&p[a]);
                        if t > 1e-3 && t < best.0 && (0..3).all(inside) && (k > 0 || t.is_finite()) {
                            best = (t, Direction::ith(axis, 1.0));
                        }
                    }
                }
            }
            if best.0.is_finite() {
                seen.0.push(eye + u * best.0);
                seen.1.push(best.1);
            }
        }
        seen
    }

    fn found(points: &[Point], normals: &[Direction]) -> SeenFrom {
        ViewpointStudy::new(points, normals, None, Point::new(1e3, 0.0, 0.0)).found()
    }

    #[test]
    fn a_room_is_seen_from_where_it_hides_nothing() {
        let eye = Point::new(3.2, 3.0, 1.6);
        let (points, normals) = room(eye);
        let elements = Elements::new(&points, &normals).unwrap();
        let true_share = elements.hidden_share(&eye, &mut Vec::new());
        assert!(true_share < 0.02, "{true_share}");
        let found = found(&points, &normals);
        assert!(found.hidden_share < 0.02, "{found:?}");
        // All but a few normals turn to the same side from there as from where the camera stood.
        let side = |v: &Point, i: usize| normals[i].dot(&(v - points[i])) > 0.0;
        let same = (0..points.len()).filter(|&i| side(&found.viewpoint, i) == side(&eye, i)).count();
        assert!(same as f32 > 0.97 * points.len() as f32, "{same} of {}", points.len());
    }

    #[test]
    fn a_stated_place_is_kept_where_it_can_be_and_dropped_where_it_cannot() {
        let eye = Point::new(3.2, 3.0, 1.6);
        let (points, normals) = room(eye);
        let outside = Point::new(-4.0, 9.0, -3.0);
        let decided = |stated: Option<Point>, zero: Point| {
            ViewpointStudy::decide(&[ViewpointStudy::new(&points, &normals, stated, zero)])[0]
        };
        assert_eq!(decided(Some(eye), outside).viewpoint, eye);
        assert_eq!(decided(Some(outside), outside), found(&points, &normals));
        assert_eq!(decided(None, eye).viewpoint, eye);
    }

    #[test]
    fn whether_the_zero_is_the_sensor_is_decided_for_a_collection() {
        let eye = Point::new(3.2, 3.0, 1.6);
        let (points, normals) = room(eye);
        let outside = Point::new(-4.0, 9.0, -3.0);
        let study = |zero: Point| ViewpointStudy::new(&points, &normals, None, zero);
        let (good, bad) = (study(eye), study(outside));
        let places = |studies: &[ViewpointStudy]| -> Vec<Point> {
            ViewpointStudy::decide(studies).iter().map(|s| s.viewpoint).collect()
        };
        assert_eq!(places(&[good, good, bad]), [eye, eye, good.found().viewpoint]);
        assert_eq!(places(&[good, bad, bad]), [good.found().viewpoint; 3]);
    }

    #[test]
    fn the_place_moves_with_the_surface() {
        let (points, normals) = room(Point::new(1.8, 2.5, 1.4));
        let here = found(&points, &normals);
        let shift = RigidMotion::translation(0.5, -0.25, 2.0);
        let mover = PointMover::new(&shift);
        let there = found(&mover.points(&points), &normals);
        // Another grid of elements: the same place to a fraction of the room, and as little hidden.
        assert!((there.viewpoint - mover.point(&here.viewpoint)).norm() < 1.0, "{there:?} {here:?}");
        assert!((there.hidden_share - here.hidden_share).abs() < 0.01);
    }

    #[test]
    fn points_at_one_place_are_seen_from_anywhere() {
        let points = vec![Point::new(1.0, 2.0, 3.0); 4];
        let zero = Point::origin();
        let study = ViewpointStudy::new(&points, &[Direction::z(); 4], None, zero);
        assert_eq!(ViewpointStudy::decide(&[study])[0].viewpoint, zero);
        assert_eq!(ViewpointStudy::decide(&[ViewpointStudy::new(&[], &[], None, zero)])[0].hidden_share, 0.0);
    }
}
