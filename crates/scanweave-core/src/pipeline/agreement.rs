//! How well placed scans sit on each other at their final poses.

use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::rigid::PointMover;
use crate::monitor::Monitor;
use crate::registration::neighbours::neighbours;
use crate::scan::{Features, NeighbourEvidence, Outcome, Reconstruction, ScanId, Surface};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Points of each surface that are compared with the other.
const POINTS: usize = 500;

/// Compared points below which a median says little.
const LEAST_POINTS: usize = 20;

/// Cosine of 45°: the angle within which normals agree, so that the two sides of a wall are not compared.
const AGREEING: f32 = std::f32::consts::FRAC_1_SQRT_2;

/// Measures every pair of placed scans of one component that touch, at the poses of `local`, a
/// reconstruction of scans in their own frames: overlap and distance of keypoints within `radius_m` (τ), and
/// the distance of their surfaces. Replaces what was measured before the last refinement.
///
/// # Errors
/// Only when the monitor is cancelled.
pub(super) fn measure(
    local: &mut Reconstruction,
    features: &[Features],
    surfaces: &[Surface],
    radius_m: f64,
    monitor: &dyn Monitor,
) -> Result<()> {
    const STAGE: &str = "agreement";
    let keypoints: Vec<RadiusGrid<'_>> =
        features.par_iter().map(|f| RadiusGrid::new(&f.keypoints, radius_m as f32)).collect();
    let sides: Vec<Side<'_>> = surfaces.par_iter().map(|s| Side::new(s, radius_m as f32)).collect();
    for component in 0..local.components() {
        monitor.check(STAGE)?;
        let members = members_of(local, component);
        let mut found = neighbours(&members, &keypoints, &[]);
        let poses: BTreeMap<ScanId, RigidMotion> = members.iter().copied().collect();
        // Every pair is compared once, from the scan of the lower number.
        let distances = members.par_iter().zip(&found).map(|((scan, world_from_scan), near)| {
            monitor.check(STAGE)?;
            let later = near.iter().filter(|n| n.scan > *scan).filter_map(|n| {
                let scan_from_other = world_from_scan.inverse() * poses.get(&n.scan)?;
                let distance = plane_distance(&sides[scan.0], &sides[n.scan.0], &scan_from_other)?;
                Some(((*scan, n.scan), distance))
            });
            Ok(later.collect())
        });
        let distances: Vec<Vec<_>> = distances.collect::<Result<_>>()?;
        let distances: BTreeMap<(ScanId, ScanId), f64> = distances.into_iter().flatten().collect();
        for ((scan, _), near) in members.iter().zip(&mut found) {
            for n in near {
                n.plane_distance_m = distances.get(&(*scan.min(&n.scan), *scan.max(&n.scan))).copied();
            }
        }
        replace(local, &members, found);
    }
    Ok(())
}

/// Scans of a component with their poses.
fn members_of(local: &Reconstruction, component: usize) -> Vec<(ScanId, RigidMotion)> {
    let of = |(scan, outcome): (usize, &Outcome)| {
        let placement = outcome.placement().filter(|p| p.component == component)?;
        Some((ScanId(scan), placement.world_from_scan))
    };
    local.outcomes.iter().enumerate().filter_map(of).collect()
}

fn replace(
    local: &mut Reconstruction,
    members: &[(ScanId, RigidMotion)],
    found: Vec<Vec<NeighbourEvidence>>,
) {
    for ((scan, _), near) in members.iter().zip(found) {
        if let Outcome::Placed(placement) = &mut local.outcomes[scan.0] {
            placement.neighbours = near;
        }
    }
}

/// A surface and where its points lie.
struct Side<'a> {
    surface: &'a Surface,
    grid: RadiusGrid<'a>,
}

impl<'a> Side<'a> {
    fn new(surface: &'a Surface, radius_m: f32) -> Self {
        Self { surface, grid: RadiusGrid::new(&surface.points, radius_m) }
    }

    /// Distances of this surface's points from the tangent planes of the other where they touch.
    fn distances(&self, other: &Side<'_>, other_from_self: &RigidMotion, into: &mut Vec<f32>) {
        let mover = PointMover::new(other_from_self);
        let oriented = self.surface.is_oriented() && other.surface.is_oriented();
        let (points, normals) = (&self.surface.points, &self.surface.normals);
        // Spread over the surface, whose points are in the order of space.
        let step = points.len().div_ceil(POINTS).max(1);
        for (point, normal) in points.iter().zip(normals).step_by(step) {
            let moved = mover.point(point);
            let Some((nearest, _)) = other.grid.nearest(&moved) else { continue };
            let plane = other.surface.normals[nearest];
            let cosine = plane.dot(&mover.direction(normal));
            if (if oriented { cosine } else { cosine.abs() }) >= AGREEING {
                into.push(plane.dot(&(moved - other.surface.points[nearest])).abs());
            }
        }
    }
}

/// Median distance of the points of two surfaces from the tangent planes of the other, both ways; `None`
/// where too few touch. The median, so that what moved between the scans does not count.
fn plane_distance(a: &Side<'_>, b: &Side<'_>, a_from_b: &RigidMotion) -> Option<f64> {
    let mut distances = Vec::new();
    b.distances(a, a_from_b, &mut distances);
    a.distances(b, &a_from_b.inverse(), &mut distances);
    if distances.len() < LEAST_POINTS {
        return None;
    }
    let middle = distances.len() / 2;
    let (_, median, _) = distances.select_nth_unstable_by(middle, f32::total_cmp);
    Some(f64::from(*median))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Direction, Point};
    use crate::monitor::Silent;
    use crate::scan::{Descriptors, Placement};
    use nalgebra::Vector3;

    /// A plane z = 0 of 1 m × 1 m, points every 2 cm, seen from above; `raised` of 100 points lie 5 cm higher.
    fn plane(raised: usize) -> Surface {
        let height = |i: usize| if (i * 37) % 100 < raised { 0.05 } else { 0.0 };
        let point = |i: usize| Point::new(0.02 * (i % 50) as f32, 0.02 * (i / 50) as f32, height(i));
        let points: Vec<Point> = (0..2500).map(point).collect();
        let normals = vec![Direction::z(); points.len()];
        let viewpoint = Point::new(0.5, 0.5, 2.0);
        Surface { points, normals, viewpoint, viewpoint_confidence: 1.0, intensities: Vec::new() }
    }

    fn placed(world_from_scan: RigidMotion, component: usize) -> Outcome {
        Outcome::Placed(Placement::at(world_from_scan, component))
    }

    fn distances(surfaces: &[Surface], poses: &[(RigidMotion, usize)]) -> Vec<Vec<Option<f64>>> {
        let of = |s: &Surface| {
            let descriptors = Descriptors::new(1, vec![0.0; s.len()]).unwrap();
            Features::new(s.points.clone(), None, descriptors).unwrap()
        };
        let features: Vec<Features> = surfaces.iter().map(of).collect();
        let outcomes = poses.iter().map(|&(pose, component)| placed(pose, component)).collect();
        let mut local = Reconstruction { outcomes };
        measure(&mut local, &features, surfaces, 0.07, &Silent).unwrap();
        let of = |o: &Outcome| o.placement().unwrap().neighbours.iter().map(|n| n.plane_distance_m).collect();
        local.outcomes.iter().map(of).collect()
    }

    #[test]
    fn two_planes_are_as_far_apart_as_their_poses_put_them_whatever_a_few_points_do() {
        // 12 mm along the normal and 3 cm along the plane, which does not count; the third is elsewhere.
        let shift = |x, z| RigidMotion::translation(x, 0.0, z);
        let poses = [(shift(0.0, 0.0), 0), (shift(0.03, 0.012), 0), (shift(0.0, 0.0), 1)];
        for raised in [0, 20] {
            let found = distances(&[plane(0), plane(raised), plane(0)], &poses);
            assert_eq!(found[2], []);
            for of in &found[..2] {
                assert!(matches!(of[..], [Some(d)] if (d - 0.012).abs() < 1e-5), "{raised}: {found:?}");
            }
        }
    }

    #[test]
    fn the_two_sides_of_a_wall_are_no_pair_of_surfaces() {
        // The second looks at the other side, 5 cm behind: within the radius, normals opposed.
        let behind = RigidMotion::new(Vector3::new(0.0, 1.0, -0.05), Vector3::x() * std::f64::consts::PI);
        let found = distances(&[plane(0), plane(0)], &[(RigidMotion::identity(), 0), (behind, 0)]);
        assert_eq!(found, [[None], [None]]);
        // Where it is not known from where the second was seen, its normals may turn either way.
        let doubtful = Surface { viewpoint_confidence: 0.0, ..plane(0) };
        let found = distances(&[plane(0), doubtful], &[(RigidMotion::identity(), 0), (behind, 0)]);
        assert!(matches!(found[0][..], [Some(d)] if (d - 0.05).abs() < 1e-5), "{found:?}");
    }
}
