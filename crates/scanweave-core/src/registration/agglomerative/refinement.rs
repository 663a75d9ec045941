//! Poses of a component refined together, and joins that are judged after that.

use super::agglomeration::{Agglomeration, Component, ComponentId};
use crate::error::Result;
use crate::geometry::{Point, RigidMotion};
use crate::monitor::Monitor;
use crate::registration::agglomerative::pairs::ScanPair;
use crate::registration::config::MultiviewIcpConfig;
use crate::registration::multiview_icp::{MatchedPair, PosedScan, close_loops, refine_poses};
use crate::registration::pairwise::correspondences::Correspondences;
use crate::scan::ScanId;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

impl Agglomeration<'_> {
    /// Refines components that grew enough since the last time, with a coarse setting.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn refine_grown(&mut self, monitor: &dyn Monitor) -> Result<()> {
        let multiview_icp = self.multiview_icp;
        if !multiview_icp.enabled || self.settings.refine_growth <= 1.0 {
            return Ok(());
        }
        let coarse = self.coarse();
        let due: Vec<ComponentId> = self
            .components
            .iter()
            .filter(|(_, c)| {
                c.members.len() > 2
                    && c.members.len() as f64 >= self.settings.refine_growth * c.refined_at as f64
            })
            .map(|c| *c.0)
            .collect();
        self.refine(&due, &coarse, monitor)
    }

    /// The multiview ICP as it is made while components still grow.
    pub(super) fn coarse(&self) -> MultiviewIcpConfig {
        let multiview_icp = self.multiview_icp;
        MultiviewIcpConfig {
            points_per_scan: (multiview_icp.points_per_scan / 4).max(1),
            radii: multiview_icp.radii.iter().copied().filter(|&r| r >= 1.0).collect(),
            rounds: 2,
            colour: 0.0,
            ..multiview_icp.clone()
        }
    }

    /// Refines every component of at least two scans with the full setting, unless it was and has not
    /// changed since.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn refine_all(&mut self, monitor: &dyn Monitor) -> Result<()> {
        if !self.multiview_icp.enabled {
            return Ok(());
        }
        let full = self.multiview_icp.clone();
        let unsettled = |id: &ComponentId| !self.settled.contains(id);
        let due: Vec<ComponentId> = self.components.keys().copied().filter(unsettled).collect();
        self.refine(&due, &full, monitor)?;
        self.settled.extend(due);
        Ok(())
    }

    /// Refines components side by side; then what is known of their edges is measured anew where that
    /// moved anything.
    pub(super) fn refine(
        &mut self,
        due: &[ComponentId],
        config: &MultiviewIcpConfig,
        monitor: &dyn Monitor,
    ) -> Result<()> {
        let refined: Result<Vec<Component>> = due
            .par_iter()
            .map(|id| {
                let mut component = self.components[id].clone();
                self.refine_component(&mut component, &BTreeSet::new(), config, monitor)?;
                Ok(component)
            })
            .collect();
        let mut moved = Vec::new();
        for (&id, component) in due.iter().zip(refined?) {
            moved.push((id, self.moved(&self.components[&id].members, &component.members)));
            self.components.insert(id, component);
        }
        // Most of thousands of scans alone, and their edges are not gone through for nothing.
        let moved = moved.iter().filter(|(_, scans)| !scans.is_empty());
        moved.for_each(|(id, scans)| self.rescore_edges(*id, scans));
        Ok(())
    }

    /// Members that moved so far that it matters to evidence, at either pose.
    pub(super) fn moved(
        &self,
        before: &[(ScanId, RigidMotion)],
        after: &[(ScanId, RigidMotion)],
    ) -> Vec<(ScanId, RigidMotion)> {
        /// A shift of this many radii does not.
        const UNFELT: f64 = 0.1;
        let far = |&(old, new): &(&(ScanId, RigidMotion), &(ScanId, RigidMotion))| {
            let model = &self.verifier.models[old.0.0];
            let centre = model.centre.cast::<f64>();
            let turned = old.1.rotation.angle_to(&new.1.rotation) * f64::from(model.reach_m);
            (old.1 * centre - new.1 * centre).norm() + turned > UNFELT * self.verifier.radius_m
        };
        before.iter().zip(after).filter(far).flat_map(|(old, new)| [*old, *new]).collect()
    }

    /// Refines the poses of a component, of which `newcomers` stand where a trial puts them.
    pub(super) fn refine_component(
        &self,
        component: &mut Component,
        newcomers: &BTreeSet<ScanId>,
        config: &MultiviewIcpConfig,
        monitor: &dyn Monitor,
    ) -> Result<()> {
        let models = self.verifier.models;
        let poses: Vec<RigidMotion> = component.members.iter().map(|m| m.1).collect();
        let poses = if self.settings.close_loops {
            close_loops(&poses, &self.matched_pairs(component, newcomers), self.verifier.radius_m)
        } else {
            poses
        };
        let scans: Vec<PosedScan<'_>> = component
            .members
            .iter()
            .zip(poses)
            .map(|(m, world_from_scan)| PosedScan { model: &models[m.0.0], world_from_scan })
            .collect();
        let refined = refine_poses(&scans, config, self.verifier.radius_m, monitor)?;
        for (member, pose) in component.members.iter_mut().zip(refined) {
            member.1 = pose;
        }
        component.refined_at = component.members.len();
        Ok(())
    }

    /// What the registered pairs within a component say of their relative poses; pairs that
    /// contradict these by far more than what adds up along the way say nothing.
    pub(super) fn matched_pairs(
        &self,
        component: &Component,
        newcomers: &BTreeSet<ScanId>,
    ) -> Vec<MatchedPair> {
        let place: BTreeMap<ScanId, usize> =
            component.members.iter().enumerate().map(|(m, member)| (member.0, m)).collect();
        self.pairs_within(component)
            .into_par_iter()
            .filter_map(|pair| {
                let (&i, &j) = (place.get(&pair.i)?, place.get(&pair.j)?);
                let i_from_j = component.members[i].1.inverse() * component.members[j].1;
                let on_trial = newcomers.contains(&pair.i) != newcomers.contains(&pair.j);
                let (points, weight) = self.matched_points(pair, &i_from_j, on_trial)?;
                let (scans, points) = if i < j {
                    ((i, j), points)
                } else {
                    ((j, i), points.into_iter().map(|(p, q)| (q, p)).collect())
                };
                Some(MatchedPair { scans, points, weight })
            })
            .collect()
    }

    /// Inlier matches of the most probable hypothesis of a pair, or while the two are `on_trial` of
    /// that probable one which is nearest to their relative pose, as points of i and of j; and its
    /// probability.
    pub(super) fn matched_points(
        &self,
        pair: &ScanPair,
        i_from_j: &RigidMotion,
        on_trial: bool,
    ) -> Option<(Vec<(Point, Point)>, f64)> {
        /// Points of a pair at most.
        const POINTS: usize = 40;
        /// Distance between a pair's points in radii, root mean square, beyond which it is wrong.
        const FAR: f64 = 15.0;
        let mut probable = pair.hypotheses.iter().filter(|h| h.probability() >= 0.5).peekable();
        probable.peek()?;
        let (in_i, in_j) = self.matched_keypoints(pair);
        let all = Correspondences::new(&in_j, &in_i);
        let (apart, points, probability) = probable
            .take(if on_trial { usize::MAX } else { 1 })
            .map(|h| {
                let inliers = all.inliers(&h.a_from_b, self.verifier.radius_m);
                let step = inliers.len().div_ceil(POINTS).max(1);
                let points: Vec<(Point, Point)> =
                    inliers.iter().step_by(step).map(|&k| (in_i[k], in_j[k])).collect();
                let apart =
                    |(p, q): &(Point, Point)| (p.cast::<f64>() - i_from_j * q.cast::<f64>()).norm_squared();
                let mean = points.iter().map(apart).sum::<f64>() / points.len().max(1) as f64;
                (mean, points, h.probability())
            })
            .min_by(|x, y| x.0.total_cmp(&y.0))?;
        (apart <= (FAR * self.verifier.radius_m).powi(2)).then_some((points, probability))
    }
}
