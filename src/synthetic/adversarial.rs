//! Collections that a registration should see through: scans that are there twice, that belong nowhere, that
//! are mirrored, that come from rooms which are near copies of each other, that hold wild points, or of which
//! half is missing.

use super::ambiguous::{self, Place};
use super::{SynthConfig, SyntheticSet, generate};
use crate::Monitor;
use crate::Result;
use crate::geometry::RigidMotion;
use crate::scan::{Scan, ScanId};
use nalgebra::{Point3, Vector3};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What is the matter with a collection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trouble {
    /// Every scan is there twice, in other coordinates.
    Duplicates,
    /// As many scans of other buildings, one of each.
    Unrelated,
    /// Every scan is there mirrored too: two rooms, and no motion brings a scan of one onto the other.
    Mirrored,
    /// Two rooms of one shape with other furniture, and half of the scans of each.
    NearCopies,
    /// A tenth of the points of every scan lie anywhere within ten times its size.
    WildPoints,
    /// Of every scan one half, cut through its middle in a random direction.
    HalfEmpty,
}

impl Trouble {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Duplicates,
        Self::Unrelated,
        Self::Mirrored,
        Self::NearCopies,
        Self::WildPoints,
        Self::HalfEmpty,
    ];
}

/// Scans with what is true of them.
#[derive(Debug, Clone, Default)]
pub struct AdversarialSet {
    /// The scans, in an order that tells nothing.
    pub scans: Vec<Scan>,
    /// True `world_from_scan` of each, in the frame of its place.
    pub world_from_scan: Vec<RigidMotion>,
    /// The place of each: scans of different places have nothing to do with each other.
    pub place: Vec<usize>,
}

/// A collection of eight scans of a room with this trouble.
///
/// # Errors
/// Only when the monitor is cancelled.
pub fn adversarial_scans(trouble: Trouble, seed: u64, monitor: &dyn Monitor) -> Result<AdversarialSet> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut found = Vec::new();
    if trouble == Trouble::NearCopies {
        for copy in 0..2 {
            let set = ambiguous::ambiguous_scans(Place::FurnishedRoom, 2 * seed + copy);
            let half = set.scans.len().div_ceil(2);
            for (scan, pose) in set.scans.iter().zip(&set.world_from_scan).take(half) {
                found.push((points(scan), *pose, copy as usize));
            }
        }
        return Ok(shuffled(found, &mut rng));
    }
    let unrelated = if trouble == Trouble::Unrelated { 8 } else { 0 };
    let config = SynthConfig { seed, rooms: 1, scans: 8, unrelated, ..SynthConfig::default() };
    let SyntheticSet { scans, world_from_scan, building, .. } = generate(&config, monitor)?;
    for (k, scan) in scans.iter().enumerate() {
        let (points, pose) = (points(scan), world_from_scan[k]);
        match trouble {
            Trouble::Duplicates => {
                let other_from_scan = any_motion(&mut rng);
                let moved = points.iter().map(|p| other_from_scan * p).collect();
                found.push((moved, pose * other_from_scan.inverse(), 0));
                found.push((points, pose, 0));
            }
            Trouble::Mirrored => {
                let mirrored = points.iter().map(|p| Point3::new(-p.x, p.y, p.z)).collect();
                // Mirrored scans are those of a mirrored room.
                found.push((mirrored, mirror(&pose), 1));
                found.push((points, pose, 0));
            }
            Trouble::WildPoints => found.push((with_wild(points, &mut rng), pose, 0)),
            Trouble::HalfEmpty => found.push((half_of(&points, &mut rng), pose, 0)),
            Trouble::Unrelated | Trouble::NearCopies => found.push((points, pose, building[k])),
        }
    }
    Ok(shuffled(found, &mut rng))
}

/// Of x → −x in the scan's and in the world's frame: mirrored scans fit each other in a mirrored room.
fn mirror(pose: &RigidMotion) -> RigidMotion {
    let flip = nalgebra::Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
    let turn = flip * pose.rotation.to_rotation_matrix().matrix() * flip;
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(turn);
    RigidMotion::from_parts((flip * pose.translation.vector).into(), rotation.into())
}

fn points(scan: &Scan) -> Vec<Point3<f64>> {
    scan.cloud.points.iter().map(|p| p.cast()).collect()
}

fn any_motion(rng: &mut ChaCha8Rng) -> RigidMotion {
    let mut any = |size: f64| Vector3::from_fn(|_, _| rng.random_range(-size..size));
    RigidMotion::new(any(20.0), any(2.0))
}

/// Middle and half the extent of points along each axis.
fn bounds(points: &[Point3<f64>]) -> (Point3<f64>, Vector3<f64>) {
    let first = points.first().copied().unwrap_or_default();
    let (low, high) = points.iter().fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
    (nalgebra::center(&low, &high), (high - low) / 2.0)
}

fn with_wild(mut points: Vec<Point3<f64>>, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
    let (middle, half) = bounds(&points);
    for _ in 0..points.len() / 9 {
        points.push(middle + half.map(|h| 10.0 * h * rng.random_range(-1.0..1.0)));
    }
    points
}

fn half_of(points: &[Point3<f64>], rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
    let across = loop {
        let v = Vector3::from_fn(|_, _| rng.random_range(-1.0f64..1.0));
        if (0.1..1.0).contains(&v.norm()) {
            break v;
        }
    };
    let mut along: Vec<f64> = points.iter().map(|p| across.dot(&p.coords)).collect();
    let middle = along.len() / 2;
    along.sort_by(f64::total_cmp);
    let limit = along.get(middle).copied().unwrap_or(0.0);
    points.iter().filter(|p| across.dot(&p.coords) < limit).copied().collect()
}

fn shuffled(mut found: Vec<(Vec<Point3<f64>>, RigidMotion, usize)>, rng: &mut ChaCha8Rng) -> AdversarialSet {
    found.shuffle(rng);
    let mut set = AdversarialSet::default();
    for (k, (points, pose, place)) in found.into_iter().enumerate() {
        let rows: Vec<[f64; 3]> = points.iter().map(|p| p.coords.into()).collect();
        set.scans.push(Scan { id: ScanId(k), ..Scan::from_points(format!("scan_{k}"), &rows) });
        set.world_from_scan.push(pose);
        set.place.push(place);
    }
    set
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Silent;
    use crate::geometry::RadiusGrid;

    /// Share of the points of scan `b` within 5 cm of one of scan `a` at their true poses.
    fn overlap(set: &AdversarialSet, a: usize, b: usize) -> f64 {
        let world_from = |k: usize| set.world_from_scan[k] * set.scans[k].cloud.file_from_points();
        let a_from_b = world_from(a).inverse() * world_from(b);
        let grid = RadiusGrid::new(&set.scans[a].cloud.points, 0.05);
        let points = &set.scans[b].cloud.points;
        let near = points.iter().filter(|p| grid.any(&(a_from_b * p.cast::<f64>()).cast())).count();
        near as f64 / points.len() as f64
    }

    /// The largest overlap of every scan with another of its place.
    fn best(set: &AdversarialSet) -> Vec<f64> {
        let of = |b: usize| {
            let same = (0..set.scans.len()).filter(|&a| a != b && set.place[a] == set.place[b]);
            same.map(|a| overlap(set, a, b)).fold(0.0, f64::max)
        };
        (0..set.scans.len()).map(of).collect()
    }

    #[test]
    fn true_poses_bring_scans_of_one_place_onto_each_other() {
        for trouble in Trouble::ALL {
            let set = adversarial_scans(trouble, 3, &Silent).unwrap();
            let scans = set.scans.len();
            let expected = match trouble {
                Trouble::Duplicates => scans == 16 && best(&set).iter().all(|&o| o > 0.99),
                Trouble::Unrelated => {
                    let related = set.place.iter().filter(|&&p| p == 0).count();
                    (scans, related) == (16, 8)
                }
                // The mirrored room is as whole as the room.
                Trouble::Mirrored => scans == 16 && best(&set).iter().all(|&o| o > 0.2),
                Trouble::NearCopies => {
                    (0..2).all(|p| set.place.iter().filter(|&&q| q == p).count() == scans / 2)
                }
                Trouble::WildPoints => scans == 8 && best(&set).iter().all(|&o| o > 0.2 && o < 0.95),
                Trouble::HalfEmpty => scans == 8 && set.scans.iter().all(|s| s.cloud.len() > 1000),
            };
            assert!(expected, "{trouble:?}: {:?} {:?}", best(&set), set.place);
            let again = adversarial_scans(trouble, 3, &Silent).unwrap();
            assert!(set.scans.iter().zip(&again.scans).all(|(a, b)| a.cloud.points == b.cloud.points));
        }
    }
}
