//! Between the frames that scans are worked on in and those of their files.
//!
//! `scan_from_local` of every scan is what [`localize`](crate::preprocessing::localize) gives:
//! `local` is the scan's own frame, `scan` are the coordinates of its file.

use crate::geometry::RigidMotion;
use crate::geometry::rigid::PointMover;
use crate::scan::{Features, Outcome, PoseGraph, Reconstruction, Scan};
use nalgebra::Matrix6;
use std::collections::BTreeMap;

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

/// A result in the coordinates of the files; the frame of a component is that of its pivot's file.
pub(super) fn reconstruction(local: Reconstruction, scan_from_local: &[RigidMotion]) -> Reconstruction {
    let mut outcomes = local.outcomes;
    // Takes a component's frame as it came out to that of its pivot's file.
    let mut world_from_component: BTreeMap<usize, (usize, RigidMotion)> = BTreeMap::new();
    for (scan, outcome) in outcomes.iter().enumerate() {
        let Some(placement) = outcome.placement() else { continue };
        let (component, step) = (placement.component, placement.step);
        if world_from_component.get(&component).is_none_or(|known| step < known.0) {
            let world = scan_from_local[scan] * placement.world_from_scan.inverse();
            world_from_component.insert(component, (step, world));
        }
    }
    for (scan, outcome) in outcomes.iter_mut().enumerate() {
        let Outcome::Placed(placement) = outcome else { continue };
        let Some((step, world)) = world_from_component.get(&placement.component) else { continue };
        let local_from_scan = scan_from_local[scan].inverse();
        placement.world_from_scan = match placement.step == *step {
            // Exactly, not up to rounding.
            true => RigidMotion::identity(),
            false => world * placement.world_from_scan * local_from_scan,
        };
        if let (Some(parent), Some(evidence)) = (placement.parent, placement.evidence.as_mut()) {
            let joined = evidence.parent_from_scan.as_mut();
            joined.into_iter().for_each(|x| *x = scan_from_local[parent.0] * *x * local_from_scan);
        }
        if let Some(covariance) = placement.pose_uncertainty.as_mut().and_then(|u| u.covariance.as_mut()) {
            *covariance = turned(covariance, world);
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
