//! The frame of each component: which of its scans, or what mean of them, stays where its file has it.
//!
//! - A scan that the user names as reference stays where it is.
//! - Where files have coordinates in common (they state poses, or lie far from zero as georeferenced
//!   ones do) and the result bears that out, the frame is that of the least motion: the sum of the
//!   distances by which scans are moved is as small as can be.
//! - Else the pivot stays where it is.

use crate::error::{Error, Result};
use crate::geometry::RigidMotion;
use crate::geometry::fit::fit_rigid;
use crate::scan::{Placement, Reconstruction, Scan, Surface};
use nalgebra::{Point3, Vector3};
use std::collections::BTreeMap;

/// What files say of the frame that their scans are in.
pub(super) struct StatedFrames {
    /// `stated_from_local` of every scan: its own frame in the coordinates that its file, or a list of
    /// rough poses, has for it.
    stated_from_local: Vec<RigidMotion>,
    /// Pose that a scan has if it stays where it is.
    stated: Vec<RigidMotion>,
    /// Root mean square distance of a scan's points from its centre, metres.
    sizes: Vec<f64>,
    /// Whether coordinates of different files may have anything to do with each other.
    in_common: bool,
    reference: Option<usize>,
}

/// `world_from_component` of one component, and the scan that exactly stays where it is.
pub(super) struct ComponentFrame {
    pub world_from_component: RigidMotion,
    /// A scan and its pose.
    pub kept: Option<(usize, RigidMotion)>,
}

impl StatedFrames {
    /// Frames of scans whose own frames are `scan_from_local`.
    ///
    /// # Errors
    /// [`Error::Setting`] when no scan has the name of the reference.
    pub fn new(
        scans: &[Scan],
        scan_from_local: &[RigidMotion],
        surfaces: &[Surface],
        reference: Option<&str>,
    ) -> Result<Self> {
        let named = |name: &str| {
            let place = scans.iter().position(|s| s.name == name);
            place.ok_or_else(|| {
                let some: Vec<&str> = scans.iter().take(3).map(|s| s.name.as_str()).collect();
                let expected = format!("the name of a scan, such as {}", some.join(", "));
                Error::setting("output.reference", name, expected, "see `scan` in the table of a run")
            })
        };
        let stated: Vec<RigidMotion> = scans.iter().map(|s| s.initial_pose.unwrap_or_default()).collect();
        let georeferenced = |s: &Scan| s.initial_pose.is_some() || s.cloud.origin_m != Vector3::zeros();
        Ok(Self {
            stated_from_local: stated.iter().zip(scan_from_local).map(|(s, l)| s * l).collect(),
            stated,
            sizes: surfaces.iter().map(size).collect(),
            in_common: scans.iter().any(georeferenced),
            reference: reference.map(named).transpose()?,
        })
    }

    /// Frames where nothing is known but the files' own coordinates: that of the pivot's file.
    pub fn of_pivots(scan_from_local: &[RigidMotion]) -> Self {
        Self {
            stated_from_local: scan_from_local.to_vec(),
            stated: vec![RigidMotion::identity(); scan_from_local.len()],
            sizes: vec![0.0; scan_from_local.len()],
            in_common: false,
            reference: None,
        }
    }

    /// The frame of every component of a result whose poses are `component_from_local`.
    pub fn choose(&self, local: &Reconstruction) -> BTreeMap<usize, ComponentFrame> {
        let mut members: BTreeMap<usize, Vec<(usize, &Placement)>> = BTreeMap::new();
        for (scan, outcome) in local.outcomes.iter().enumerate() {
            if let Some(placement) = outcome.placement() {
                members.entry(placement.component).or_default().push((scan, placement));
            }
        }
        members.into_iter().map(|(component, members)| (component, self.of_component(&members))).collect()
    }

    fn of_component(&self, members: &[(usize, &Placement)]) -> ComponentFrame {
        let staying = |&(scan, placement): &(usize, &Placement)| ComponentFrame {
            world_from_component: self.stated_from_local[scan] * placement.world_from_scan.inverse(),
            kept: Some((scan, self.stated[scan])),
        };
        if let Some(reference) = members.iter().find(|m| Some(m.0) == self.reference) {
            return staying(reference);
        }
        if let Some(world_from_component) = self.in_common.then(|| self.least_motion(members)).flatten() {
            return ComponentFrame { world_from_component, kept: None };
        }
        let pivot = members.iter().min_by_key(|(scan, placement)| (placement.step, *scan));
        pivot.map_or(ComponentFrame { world_from_component: RigidMotion::identity(), kept: None }, staying)
    }

    /// The frame that moves scans least; `None` for a single scan, and where most scans would move so far
    /// that scans which overlap in the files do not overlap: their coordinates have nothing in common.
    fn least_motion(&self, members: &[(usize, &Placement)]) -> Option<RigidMotion> {
        /// Steps of reweighting; each halves what is left, roughly.
        const STEPS: usize = 30;
        if members.len() < 2 {
            return None;
        }
        // Three points of every scan carry its position and its rotation.
        let corners = |&(scan, placement): &(usize, &Placement)| {
            [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| {
                let p = Point3::from(axis * self.sizes[scan]);
                (placement.world_from_scan * p, self.stated_from_local[scan] * p)
            })
        };
        let pairs: Vec<[(Point3<f64>, Point3<f64>); 3]> = members.iter().map(corners).collect();
        let moved = |world: &RigidMotion, three: &[(Point3<f64>, Point3<f64>); 3]| {
            (three.iter().map(|(s, t)| (world * s - t).norm_squared()).sum::<f64>() / 3.0).sqrt()
        };
        let fit = |weights: &[f64]| {
            let weighted = pairs.iter().zip(weights);
            fit_rigid(weighted.flat_map(|(three, w)| three.iter().map(move |(s, t)| (*s, *t, *w))))
        };
        // The sum of distances and not of squares: a scan that a file has in a wrong place must not drag
        // the others along.
        let mut world = fit(&vec![1.0; pairs.len()])?;
        for _ in 0..STEPS {
            let distances: Vec<f64> = pairs.iter().map(|three| moved(&world, three)).collect();
            let least = 1e-6 * distances.iter().copied().fold(f64::MIN_POSITIVE.sqrt(), f64::max);
            world = fit(&distances.iter().map(|d| 1.0 / d.max(least)).collect::<Vec<_>>())?;
        }
        let mut in_sizes: Vec<f64> =
            pairs.iter().zip(members).map(|(three, m)| moved(&world, three) / self.sizes[m.0]).collect();
        let middle = in_sizes.len() / 2;
        let median = *in_sizes.select_nth_unstable_by(middle, f64::total_cmp).1;
        (median < 1.0).then_some(world)
    }
}

fn size(surface: &Surface) -> f64 {
    let sum: f64 = surface.points.iter().map(|p| f64::from(p.coords.norm_squared())).sum();
    (sum / surface.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use crate::scan::{Outcome, PointCloud, ScanId};

    fn placed(world_from_scan: RigidMotion, step: usize) -> Outcome {
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
            pose_uncertainty: None,
        })
    }

    /// Scans whose points lie a metre from their centres.
    fn surfaces(n: usize) -> Vec<Surface> {
        let points = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]];
        vec![Surface { points: points.map(Point::from).to_vec(), ..Surface::default() }; n]
    }

    /// Scans of a georeferenced set, whose frames of their own are turned.
    fn georeferenced(n: usize) -> (Vec<Scan>, Vec<RigidMotion>) {
        let scan = |k: usize| Scan {
            name: format!("s{k}"),
            cloud: PointCloud { origin_m: Vector3::new(4e5, 5e6, 0.0), ..PointCloud::default() },
            ..Scan::default()
        };
        let frame = |k: usize| {
            RigidMotion::new(Vector3::new(4e5 + k as f64, 5e6, 100.0), Vector3::new(0.0, 0.0, k as f64))
        };
        ((0..n).map(scan).collect(), (0..n).map(frame).collect())
    }

    #[test]
    fn georeferenced_scans_stay_together_where_they_are_and_one_that_is_not_does_not_drag_them() {
        let (scans, frames) = georeferenced(7);
        // The component's frame is anywhere; scans are where their files have them, but for small errors
        // that cancel, and one 300 m away.
        let component_from_world =
            RigidMotion::new(Vector3::new(-4e5, 3.0, 8.0), Vector3::new(0.4, 1.0, 0.2))
                * RigidMotion::translation(0.0, -5e6, 0.0);
        let error = |k: usize| match k {
            1 => RigidMotion::translation(0.05, 0.0, 0.0),
            2 => RigidMotion::translation(-0.05, 0.0, 0.0),
            3 => RigidMotion::translation(300.0, 0.0, 20.0),
            _ => RigidMotion::identity(),
        };
        let pose = |k: usize| component_from_world * error(k) * frames[k];
        let local = Reconstruction { outcomes: (0..7).map(|k| placed(pose(k), k)).collect() };
        let stated = StatedFrames::new(&scans, &frames, &surfaces(7), None).unwrap();
        let frame = &stated.choose(&local)[&0];
        let world = frame.world_from_component * component_from_world;
        let at = Point3::new(4e5 + 3.0, 5e6, 100.0);
        assert!((world * at - at).norm() < 1e-3, "{}", (world * at - at).norm());
        assert!(frame.kept.is_none());

        let stated = StatedFrames::new(&scans, &frames, &surfaces(7), Some("s1")).unwrap();
        let frame = &stated.choose(&local)[&0];
        let expected = error(1).inverse() * component_from_world.inverse();
        assert!((frame.world_from_component.inverse() * at - expected.inverse() * at).norm() < 1e-6);
        assert_eq!(frame.kept, Some((1, RigidMotion::identity())));
        let unknown = StatedFrames::new(&scans, &frames, &surfaces(7), Some("s9")).err().unwrap();
        assert!(unknown.to_string().contains("output.reference: found s9"), "{unknown}");
    }

    #[test]
    fn scans_whose_coordinates_have_nothing_in_common_have_the_frame_of_the_pivot() {
        let (mut scans, frames) = georeferenced(4);
        // Where scans lie 200 m apart in the files and on top of each other in the result.
        let apart = |k: usize| RigidMotion::translation(200.0 * k as f64, 0.0, 0.0) * frames[k];
        let away: Vec<RigidMotion> = (0..4).map(apart).collect();
        let outcomes = (0..4).map(|k| placed(frames[k], 3 - k)).collect();
        let local = Reconstruction { outcomes };
        let chosen = StatedFrames::new(&scans, &away, &surfaces(4), None).unwrap();
        assert_eq!(chosen.choose(&local)[&0].kept, Some((3, RigidMotion::identity())));
        // A pose that the file of the pivot states is where that stays.
        let stated = RigidMotion::translation(0.0, 7.0, 0.0);
        scans[3].initial_pose = Some(stated);
        let chosen = StatedFrames::new(&scans, &away, &surfaces(4), None).unwrap();
        let frame = &chosen.choose(&local)[&0];
        assert_eq!(frame.kept, Some((3, stated)));
        let expected = stated * away[3] * frames[3].inverse();
        let at = Point3::new(4e5, 5e6, 0.0);
        assert!((frame.world_from_component * at - expected * at).norm() < 1e-6);
    }
}
