//! The state of a growing registration and the mechanism of its steps.
//!
//! [`crate::registration::input`] says when each step happens; this file says how.

use super::candidate::Candidate;
use crate::registration::config::RegistrationConfig;
use crate::registration::pairwise::correspondences::Correspondences;
use crate::registration::verification::decline;
use crate::registration::verification::probability;
use crate::registration::input::{Lengths, MIN_KEYPOINTS, ScanInput};
use crate::registration::multiview_icp::{JointScan, refine_jointly};
use crate::registration::pairwise::matching::Matches;
use crate::registration::incremental::meta_shape::MetaShape;
use crate::registration::pairwise::nearest::Columns;
use crate::registration::incremental::transformation_averaging::{Registered, average_observations};
use crate::registration::scan_model::ScanModel;
use crate::registration::verification::surface_fit::{Posed, surface_fit};
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::rigid::PointMover;
use crate::monitor::Monitor;
use crate::scan::{DeclineReason, ScanId, SimilarityMatrix, Support};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The outcome of registering one candidate against the meta-shape.
#[derive(Debug, Clone)]
pub struct Attempt {
    /// The candidate.
    pub scan: ScanId,
    /// Its pose by the robust estimate; identity when there is none.
    pub world_from_scan: RigidMotion,
    /// What speaks for the pose.
    pub support: Support,
    /// Root mean square distance of the inlier matches, metres.
    pub residual_m: f64,
    /// Registered scan that the largest part of the inliers comes from.
    pub parent: Option<ScanId>,
    /// Why the evidence does not suffice; `None` when it does.
    pub refusal: Option<DeclineReason>,
}

/// A scan of the current component.
#[derive(Debug, Clone)]
pub(super) struct Member {
    pub(super) scan: ScanId,
    pub(super) world_from_scan: RigidMotion,
    /// `None` for the pivot.
    pub(super) attempt: Option<Attempt>,
}

/// State of the registration.
pub struct Growth<'a> {
    pub(super) scans: &'a [ScanInput<'a>],
    pub(super) similarity: &'a SimilarityMatrix,
    pub(super) config: &'a RegistrationConfig,
    pub(super) radius_m: f32,
    pub(super) seed: u64,
    /// Keypoints of every scan, indexed in its own frame with radius τ.
    pub(super) grids: Vec<RadiusGrid<'a>>,
    /// Surfaces of every scan; empty where surfaces are not checked.
    pub(super) models: Vec<ScanModel<'a>>,
    /// Descriptors of every scan, packed for matching.
    pub(super) columns: Vec<Columns>,
    /// Scans without an outcome yet.
    pub(super) remaining: Vec<ScanId>,
    pub(super) meta: Option<MetaShape>,
    /// Highest similarity of each scan to a member of the component.
    pub(super) meta_similarity: Vec<f32>,
    pub(super) candidates: BTreeMap<ScanId, Candidate>,
    pub(super) members: Vec<Member>,
    pub(super) joined_since_refinement: usize,
    /// Finished components.
    pub(super) components: Vec<Vec<Member>>,
    /// Why each scan was last refused.
    pub(super) refusals: Vec<Option<DeclineReason>>,
}

impl<'a> Growth<'a> {
    /// Nothing registered yet.
    pub fn new(
        scans: &'a [ScanInput<'a>],
        similarity: &'a SimilarityMatrix,
        config: &'a RegistrationConfig,
        lengths: Lengths,
        seed: u64,
    ) -> Self {
        let radius_m = lengths.inlier_radius_m as f32;
        let mut refusals: Vec<Option<DeclineReason>> = vec![None; scans.len()];
        let mut remaining = Vec::new();
        for (i, scan) in scans.iter().enumerate() {
            match decline::unusable(scan, MIN_KEYPOINTS, lengths.voxel_m) {
                Some(reason) => refusals[i] = Some(reason),
                None => remaining.push(ScanId(i)),
            }
        }
        let grids = scans.par_iter().map(|s| RadiusGrid::new(&s.features.keypoints, radius_m)).collect();
        let checked = if config.checks_surfaces() || config.joint.enabled { scans } else { &[] };
        let models = checked.par_iter().map(|s| ScanModel::new(s.surface, radius_m, config)).collect();
        let columns = scans.par_iter().map(|s| Columns::new(&s.features.descriptors)).collect();
        Self {
            scans,
            similarity,
            config,
            radius_m,
            seed,
            grids,
            models,
            columns,
            remaining,
            meta: None,
            meta_similarity: Vec::new(),
            candidates: BTreeMap::new(),
            members: Vec::new(),
            joined_since_refinement: 0,
            components: Vec::new(),
            refusals,
        }
    }

    /// The pivot: argmax over the scans left of the sum of their similarities to one another.
    pub fn most_connected_scan(&self) -> Option<ScanId> {
        let sum = |i: ScanId| -> f64 {
            self.remaining.iter().map(|j| f64::from(self.similarity.get(i.0, j.0))).sum()
        };
        // Strictly greater: a tie keeps the lower index.
        self.remaining.iter().map(|&i| (i, sum(i))).reduce(|a, b| if b.1 > a.1 { b } else { a }).map(|p| p.0)
    }

    /// Makes `pivot` the meta-shape; its frame is the component's.
    pub fn start_meta_shape(&mut self, pivot: ScanId) {
        self.remaining.retain(|&s| s != pivot);
        self.meta = Some(MetaShape::new(pivot, self.scans[pivot.0].features));
        self.meta_similarity = self.similarity.row(pivot.0).to_vec();
        self.candidates.clear();
        self.joined_since_refinement = 0;
        self.members = vec![Member { scan: pivot, world_from_scan: RigidMotion::identity(), attempt: None }];
    }

    /// The scans left, most similar to the meta-shape first; ties by index.
    pub fn by_similarity_to_meta_shape(&self) -> Vec<ScanId> {
        let mut order = self.remaining.clone();
        order.sort_by(|a, b| self.meta_similarity[b.0].total_cmp(&self.meta_similarity[a.0]).then(a.cmp(b)));
        order
    }

    /// Registers each scan of the shortlist against the meta-shape, in the given order:
    /// match, robust estimate, refinement, evidence.
    pub fn register_pairwise(&mut self, shortlist: &[ScanId]) -> Vec<Attempt> {
        let Some(meta) = &self.meta else { return Vec::new() };
        let mut tried: Vec<(ScanId, Candidate)> = shortlist
            .iter()
            .map(|&scan| {
                let known = self.candidates.remove(&scan);
                (scan, known.unwrap_or_else(|| Candidate::new(self.columns[scan.0].clone())))
            })
            .collect();
        let attempts: Vec<Attempt> = tried
            .par_iter_mut()
            .map(|(scan, candidate)| {
                candidate.update(self.scans[scan.0], meta, self.config, self.radius_m, self.seed, *scan);
                self.judge(*scan, candidate, meta)
            })
            .collect();
        self.candidates.extend(tried);
        for attempt in &attempts {
            if let Some(reason) = &attempt.refusal {
                self.refusals[attempt.scan.0] = Some(reason.clone());
            }
        }
        attempts
    }

    /// The best-supported hypothesis of a candidate, with its evidence.
    fn judge(&self, scan: ScanId, candidate: &Candidate, meta: &MetaShape) -> Attempt {
        let placed = self.placed_surfaces();
        let considered = if placed.is_empty() { 1 } else { self.config.evidence.hypotheses };
        let assessed = (0..candidate.hypotheses.len().min(considered))
            .map(|h| (h, self.assess(scan, candidate, h, &placed)))
            .reduce(|best, next| if next.1.probability > best.1.probability { next } else { best });
        let Some((chosen, support)) = assessed else {
            let support = Support { matches: candidate.matches.len(), ..Support::default() };
            return self.attempt(scan, RigidMotion::identity(), support, 0.0, None);
        };
        let world_from_scan = candidate.hypotheses[chosen].target_from_source;
        let (residual_m, parent) = self.inlier_summary(&candidate.matches, &world_from_scan, meta);
        self.attempt(scan, world_from_scan, support, residual_m, parent)
    }

    fn attempt(
        &self,
        scan: ScanId,
        world_from_scan: RigidMotion,
        support: Support,
        residual_m: f64,
        parent: Option<ScanId>,
    ) -> Attempt {
        // Fewer inliers than a motion has are no registration under any settings.
        let refusal = if support.inliers < MIN_KEYPOINTS {
            Some(DeclineReason::TooFewInliers {
                inliers: support.inliers,
                needed: self.config.evidence.min_inliers.max(MIN_KEYPOINTS),
                matches: support.matches,
            })
        } else {
            decline::refusal(&support, &self.config.evidence)
        };
        Attempt { scan, world_from_scan, support, residual_m, parent, refusal }
    }

    /// Surfaces of the members; none where surfaces are not checked.
    fn placed_surfaces(&self) -> Vec<Posed<'_>> {
        let members = self.members.iter().filter(|m| m.scan.0 < self.models.len());
        members.map(|m| Posed { model: &self.models[m.scan.0], group_from_scan: m.world_from_scan }).collect()
    }

    /// Support of hypothesis `h` of a candidate.
    fn assess(&self, scan: ScanId, candidate: &Candidate, h: usize, placed: &[Posed<'_>]) -> Support {
        let hypothesis = &candidate.hypotheses[h];
        let others = candidate.hypotheses.iter().enumerate().filter(|o| o.0 != h);
        let mut support = Support {
            matches: candidate.matches.len(),
            inliers: hypothesis.inliers,
            runner_up: others.map(|o| o.1.inliers).max().unwrap_or(0),
            ..Support::default()
        };
        if placed.is_empty() {
            return support;
        }
        let pose = &hypothesis.target_from_source;
        let matches = Correspondences::new(&candidate.matches.source, &candidate.matches.target);
        support.chance = matches.count_by_chance(pose, self.radius_m.into());
        let alone = Posed { model: &self.models[scan.0], group_from_scan: RigidMotion::identity() };
        let fit = surface_fit(placed, &[alone], pose, 1);
        support.overlap = fit.overlap;
        support.normal_agreement = fit.normal_agreement;
        support.plane_residual = fit.plane_residual;
        support.violation = fit.violation;
        support.stiffness = fit.stiffness;
        if self.config.evidence.surfaces {
            support.probability = Some(probability::probability(&support, &self.config.evidence.weights, false));
        }
        support
    }

    /// RMS distance of the inlier matches, and the member that most of them come from.
    fn inlier_summary(
        &self,
        matches: &Matches,
        world_from_scan: &RigidMotion,
        meta: &MetaShape,
    ) -> (f64, Option<ScanId>) {
        let mover = PointMover::new(world_from_scan);
        let limit = self.radius_m * self.radius_m;
        let (mut squared, mut inliers) = (0.0f64, 0usize);
        let mut by_scan: BTreeMap<ScanId, usize> = BTreeMap::new();
        for (m, pair) in matches.pairs.iter().enumerate() {
            let d = (mover.point(&matches.source[m]) - matches.target[m]).norm_squared();
            if d <= limit {
                squared += f64::from(d);
                inliers += 1;
                *by_scan.entry(meta.origin(pair.1 as usize).0).or_default() += 1;
            }
        }
        let parent = by_scan.iter().max_by_key(|(s, n)| (**n, std::cmp::Reverse(**s))).map(|p| *p.0);
        ((squared / inliers.max(1) as f64).sqrt(), parent)
    }

    /// The selected scan's pose averaged over what its registered neighbours say.
    pub fn average_transformation(&self, chosen: &Attempt) -> RigidMotion {
        if !self.config.averaging.enabled {
            return chosen.world_from_scan;
        }
        let registered: Vec<Registered<'_>> = self
            .members
            .iter()
            .map(|m| Registered { keypoints: &self.grids[m.scan.0], world_from_scan: m.world_from_scan })
            .collect();
        let keypoints = &self.grids[chosen.scan.0];
        average_observations(keypoints, &chosen.world_from_scan, &registered, &self.config.averaging)
    }

    /// Adds the scan to the meta-shape and updates the meta-shape's row of S.
    pub fn merge(&mut self, chosen: &Attempt, world_from_scan: RigidMotion) {
        let Some(meta) = &mut self.meta else { return };
        let scan = chosen.scan;
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(scan.0 as u64);
        let features = self.scans[scan.0].features;
        meta.merge(scan, features, &world_from_scan, self.config.merge, self.radius_m, &mut rng);
        for (best, &new) in self.meta_similarity.iter_mut().zip(self.similarity.row(scan.0)) {
            *best = best.max(new);
        }
        self.remaining.retain(|&s| s != scan);
        self.candidates.remove(&scan);
        let parent = self.members.iter().find(|m| Some(m.scan) == chosen.parent);
        let mut attempt = chosen.clone();
        attempt.support.parent_from_scan = parent.map(|p| p.world_from_scan.inverse() * world_from_scan);
        self.members.push(Member { scan, world_from_scan, attempt: Some(attempt) });
        self.joined_since_refinement += 1;
    }

    /// Refines all poses of the component together when enough scans have joined.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn refine_if_due(&mut self, monitor: &dyn Monitor) -> Result<()> {
        let every = self.config.joint.every;
        if self.config.joint.enabled && every > 0 && self.joined_since_refinement >= every {
            self.refine_members(monitor)?;
        }
        Ok(())
    }

    fn refine_members(&mut self, monitor: &dyn Monitor) -> Result<()> {
        let scans: Vec<JointScan<'_>> = self
            .members
            .iter()
            .map(|m| JointScan { model: &self.models[m.scan.0], world_from_scan: m.world_from_scan })
            .collect();
        let refined = refine_jointly(&scans, &self.config.joint, f64::from(self.radius_m), monitor)?;
        let mut new_from_old: BTreeMap<ScanId, RigidMotion> = BTreeMap::new();
        for (member, pose) in self.members.iter_mut().zip(refined) {
            new_from_old.insert(member.scan, pose * member.world_from_scan.inverse());
            member.world_from_scan = pose;
        }
        if let Some(meta) = &mut self.meta {
            meta.repose(|scan| new_from_old.get(&scan).copied().unwrap_or_else(RigidMotion::identity));
        }
        self.joined_since_refinement = 0;
        Ok(())
    }

    /// Ends the component: a last joint refinement, or a refusal where the pivot stayed alone.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn close_component(&mut self, monitor: &dyn Monitor) -> Result<()> {
        if let [alone] = self.members.as_slice() {
            let scan = alone.scan;
            let needed = self.config.evidence.min_inliers.max(MIN_KEYPOINTS);
            let nothing = DeclineReason::TooFewInliers { inliers: 0, needed, matches: 0 };
            self.refusals[scan.0].get_or_insert(nothing);
            self.members.clear();
            return Ok(());
        }
        if self.config.joint.enabled {
            self.refine_members(monitor)?;
        }
        self.components.push(std::mem::take(&mut self.members));
        Ok(())
    }
}
