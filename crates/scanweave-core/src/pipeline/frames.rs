//! Between the frames that scans are worked on in and those of their files.
//!
//! `scan_from_local` of every scan is what [`localize`](crate::preprocessing::localize) gives:
//! `local` is the scan's own frame, `scan` are the coordinates of its file.

use super::component_frames::StatedFrames;
use crate::geometry::RigidMotion;
use crate::geometry::rigid::PointMover;
use crate::scan::{Features, Outcome, PoseGraph, Reconstruction, Scan};
use nalgebra::Matrix6;

/// Features of a scan whose keypoints are relative to its cloud's origin, in its own frame.
pub(super) fn to_local(features: &Features, scan: &Scan, scan_from_local: &RigidMotion) -> Features {
    moved(features, &(scan_from_local.inverse() * scan.cloud.file_from_points()))
}

/// Features in the scan's own frame, relative to its cloud's origin.
pub(super) fn from_local(features: &Features, scan: &Scan, scan_from_local: &RigidMotion) -> Features {
    moved(features, &(scan.cloud.file_from_points().inverse() * scan_from_local))
}

fn moved(features: &Features, motion: &RigidMotion) -> Features {
    let mover = PointMover::new(motion);
    Features {
        keypoints: features.keypoints.iter().map(|p| (motion * p.cast::<f64>()).cast()).collect(),
        normals: features.normals.as_ref().map(|all| all.iter().map(|n| mover.direction(n)).collect()),
        descriptors: features.descriptors.clone(),
    }
}

/// A result in the coordinates of the files, each component in the frame that `stated` chooses.
pub(super) fn reconstruction(
    local: Reconstruction,
    scan_from_local: &[RigidMotion],
    stated: &StatedFrames,
) -> Reconstruction {
    let chosen = stated.choose(&local);
    let mut outcomes = local.outcomes;
    for (scan, outcome) in outcomes.iter_mut().enumerate() {
        let Outcome::Placed(placement) = outcome else { continue };
        let Some(frame) = chosen.get(&placement.component) else { continue };
        let world = &frame.world_from_component;
        let local_from_scan = scan_from_local[scan].inverse();
        placement.world_from_scan = match frame.kept {
            // Exactly, not up to rounding.
            Some((kept, pose)) if kept == scan => pose,
            _ => world * placement.world_from_scan * local_from_scan,
        };
        if let (Some(parent), Some(evidence)) = (placement.parent, placement.evidence.as_mut()) {
            let joined = evidence.parent_from_scan.as_mut();
            joined.into_iter().for_each(|x| *x = scan_from_local[parent.0] * *x * local_from_scan);
        }
        if let Some(uncertainty) = placement.pose_uncertainty.as_mut() {
            uncertainty.covariance.iter_mut().for_each(|c| *c = turned(c, world));
            uncertainty.centre.iter_mut().for_each(|c| *c = scan_from_local[scan] * *c);
        }
    }
    Reconstruction { outcomes }
}

/// Covariance of a rotation vector and a displacement in a frame that is turned.
fn turned(covariance: &Matrix6<f64>, motion: &RigidMotion) -> Matrix6<f64> {
    let turn = motion.rotation.to_rotation_matrix().into_inner();
    let mut both = Matrix6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
    both.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
    both * covariance * both.transpose()
}

/// A pose graph in the coordinates of the files.
pub(super) fn pose_graph(mut local: PoseGraph, scan_from_local: &[RigidMotion]) -> PoseGraph {
    for edge in local.edges.iter_mut().filter(|edge| edge.pair.inliers > 0) {
        let motion = edge.pair.target_from_source;
        edge.pair.target_from_source =
            scan_from_local[edge.i.0] * motion * scan_from_local[edge.j.0].inverse();
    }
    local
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{Placement, PoseUncertainty, ScanId};
    use nalgebra::{Point3, Vector3, Vector6};

    #[test]
    fn centre_and_covariance_follow_the_scan_into_the_coordinates_of_the_files() {
        let turn = |axis: Vector3<f64>| axis * std::f64::consts::FRAC_PI_2;
        // The pivot's file is its own frame turned by a quarter turn about z: x becomes y.
        let scan_from_local = [
            RigidMotion::new(Vector3::new(10.0, 0.0, 0.0), turn(Vector3::z())),
            RigidMotion::new(Vector3::new(0.0, 0.0, 5e5), turn(Vector3::x())),
        ];
        let local_from_other = RigidMotion::translation(1.0, 2.0, 3.0);
        let covariance = Matrix6::from_diagonal(&Vector6::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0));
        let placed = |step: usize, world_from_scan: RigidMotion| {
            let centre = Some(Point3::new(0.25, 0.5, 1.0));
            let uncertainty = PoseUncertainty { weakest_edge: None, covariance: Some(covariance), centre };
            Outcome::Placed(Placement {
                world_from_scan,
                component: 0,
                step,
                parent: (step > 0).then_some(ScanId(0)),
                matches: 0,
                inliers: 0,
                residual_m: 0.0,
                evidence: None,
                neighbours: Vec::new(),
                pose_uncertainty: Some(Box::new(uncertainty)),
            })
        };
        let outcomes = vec![placed(0, RigidMotion::identity()), placed(1, local_from_other)];
        let found = reconstruction(
            Reconstruction { outcomes },
            &scan_from_local,
            &StatedFrames::of_pivots(&scan_from_local),
        );
        let of = |scan: usize| found.outcomes[scan].placement().unwrap();
        let uncertainty = |scan: usize| of(scan).pose_uncertainty.as_deref().unwrap();
        // (x, y, z) → (10 − y, x, z) and (x, −z, 5e5 + y).
        for (scan, expected) in [(0, [9.5, 0.25, 1.0]), (1, [0.25, -1.0, 500_000.5])] {
            let centre = uncertainty(scan).centre.unwrap();
            assert!((centre - Point3::from(expected)).norm() < 1e-9, "{centre}");
        }
        // In the component it is where it was: (1.25, 2.5, 4) of the pivot's own frame.
        let centre = of(1).world_from_scan * uncertainty(1).centre.unwrap();
        assert!((centre - Point3::new(7.5, 1.25, 4.0)).norm() < 1e-8, "{centre}");
        // Variances along x and y of the component change places.
        let expected = Vector6::new(2.0, 1.0, 3.0, 5.0, 4.0, 6.0);
        assert!((uncertainty(1).covariance.unwrap().diagonal() - expected).norm() < 1e-9);
    }
}
