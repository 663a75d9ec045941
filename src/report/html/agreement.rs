//! How far the points of a scan lie from the surfaces of the scans it touches.

use super::points::Shown;
use crate::geometry::PointIndex;
use crate::geometry::{PointMover, RigidMotion, motion_from_matrix};
use crate::result::{Document, EntryOutcome, Pose};
use crate::scan::Surface;
use nalgebra::{Matrix4, Vector3};
use rayon::prelude::*;

/// Value of a point where no other scan has a surface within the inlier radius.
const ALONE: u8 = 255;
/// A scan is compared with so many others, those it overlaps most.
const MOST_NEIGHBOURS: usize = 4;

/// For every shown point of every placed scan its mean distance to the tangent planes of the
/// surfaces of other scans within `radius_m`: 0 for none, 254 for `radius_m`, 255 where there
/// is no such surface. `None` for scans that touch no other, or that have no surface themselves.
///
/// `surfaces` are in frames of their own, of which `frames` holds `scan_from_local`;
/// `local_from_points` takes the shown points there.
pub(super) fn residuals(
    document: &Document,
    (surfaces, frames, local_from_points): (&[Surface], &[RigidMotion], &[RigidMotion]),
    shown: &[Shown],
    radius_m: f32,
) -> Vec<Option<Vec<u8>>> {
    let poses: Vec<Option<&Pose>> = document
        .scans
        .iter()
        .map(|e| match &e.outcome {
            EntryOutcome::Placed(pose) => Some(pose.as_ref()),
            EntryOutcome::Declined { .. } => None,
        })
        .collect();
    let motions: Vec<Option<RigidMotion>> = poses.iter().map(|p| p.and_then(motion_of)).collect();
    let trees: Vec<PointIndex> = surfaces.par_iter().map(|s| PointIndex::new(&s.points)).collect();
    let one = |i: usize| {
        let (pose, world_from_i) = (poses[i]?, motions[i]? * frames[i] * local_from_points[i]);
        let mut near: Vec<_> = pose.neighbours.iter().filter(|n| n.scan.0 != i).collect();
        near.sort_by(|a, b| b.overlap.total_cmp(&a.overlap).then(a.scan.cmp(&b.scan)));
        let others: Vec<(PointMover, usize)> = near
            .iter()
            .take(MOST_NEIGHBOURS)
            .filter_map(|n| {
                let world_from_j = motions.get(n.scan.0).copied().flatten()? * frames[n.scan.0];
                Some((PointMover::new(&(world_from_j.inverse() * world_from_i)), n.scan.0))
            })
            .filter(|&(_, j)| !surfaces[j].is_empty())
            .collect();
        if others.is_empty() || surfaces[i].is_empty() {
            return None;
        }
        let value = |p| {
            let distances: Vec<f32> = others
                .iter()
                .filter_map(|(mover, j)| {
                    let q = mover.point(p);
                    let (k, squared) = trees[*j].nearest(&q).filter(|n| n.1 <= radius_m * radius_m)?;
                    let normal = surfaces[*j].normals.get(k).copied().unwrap_or_default();
                    let flat = normal != Vector3::zeros();
                    let off = q - surfaces[*j].points[k];
                    Some(if flat { normal.dot(&off).abs() } else { squared.sqrt() })
                })
                .collect();
            if distances.is_empty() {
                return ALONE;
            }
            let mean = distances.iter().sum::<f32>() / distances.len() as f32;
            (254.0 * (mean / radius_m).min(1.0)).round() as u8
        };
        Some(shown[i].points.iter().map(value).collect())
    };
    (0..document.scans.len()).into_par_iter().map(one).collect()
}

fn motion_of(pose: &Pose) -> Option<RigidMotion> {
    motion_from_matrix(&Matrix4::from_fn(|r, c| pose.world_from_scan[r][c]), 1e-6).map(|m| m.0)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{document, placed};
    use super::*;
    use crate::geometry::Point;
    use crate::scan::{NeighbourEvidence, Outcome};

    #[test]
    fn a_shifted_copy_is_off_by_its_shift_across_the_surface_only() {
        // Two floors of 1 m²; the second scan is placed 2 cm too high and half a metre to the side.
        let points: Vec<Point> =
            (0..400).map(|i| Point::new((i % 20) as f32 * 0.05, (i / 20) as f32 * 0.05, 0.0)).collect();
        let floor = Surface {
            normals: vec![Vector3::z(); points.len()],
            points: points.clone(),
            viewpoint: Point::new(0.0, 0.0, 1.0),
            ..Surface::default()
        };
        let touching = |scan| NeighbourEvidence::new(crate::scan::ScanId(scan), 0.5, 0.02);
        let mut first = placed(RigidMotion::identity(), 0, None);
        let mut second = placed(RigidMotion::translation(0.5, 0.0, 0.02), 1, Some(0));
        (first.neighbours, second.neighbours) = (vec![touching(1)], vec![touching(0)]);
        let lone = placed(RigidMotion::identity(), 2, Some(0));
        let document = document([first, second, lone].map(Outcome::Placed).to_vec());
        let shown = vec![Shown { points, colors: None }; 3];
        let floors = vec![floor; 3];
        let own = [RigidMotion::identity(); 3];
        let found = residuals(&document, (&floors, &own, &own), &shown, 0.1);
        assert_eq!(found[2], None);
        // A scan without a surface of its own is compared with nothing, nor is anything with it.
        let first_gone = [Surface::default(), floors[1].clone(), floors[2].clone()];
        assert_eq!(residuals(&document, (&first_gone, &own, &own), &shown, 0.1), [None, None, None]);
        let first = found[0].as_ref().unwrap();
        // 2 cm of 10 cm: 254 · 0.2 = 51. Left of x = 0.4 nothing of the second is within 10 cm.
        for (p, &value) in shown[0].points.iter().zip(first) {
            let expected = if p.x > 0.41 { 51 } else { ALONE };
            assert_eq!(value, expected, "at {p}");
        }
    }
}
