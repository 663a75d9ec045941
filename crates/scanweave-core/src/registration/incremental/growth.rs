//! The state of a growing registration and the mechanism of its steps.
//!
//! [`crate::registration::input`] says when each step happens; this file says how.

use super::candidate::Candidate;
use crate::error::Result;
use crate::geometry::RigidMotion;
use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::rigid::PointMover;
use crate::monitor::Monitor;
use crate::random::generator;
use crate::registration::config::{IncrementalConfig, Ordering, RegistrationConfig, SurfaceVerification};
use crate::registration::incremental::meta_shape::MetaShape;
use crate::registration::incremental::transformation_averaging::{Registered, average_observations};
use crate::registration::input::{ContentDigest, Lengths, MIN_KEYPOINTS, ScanInput};
use crate::registration::multiview_icp::{PosedScan, refine_poses};
use crate::registration::pairwise::correspondences::Correspondences;
use crate::registration::pairwise::matching::Matches;
use crate::registration::pairwise::nearest::Columns;
use crate::registration::pairwise::registrar::PairRegistrar;
use crate::registration::scan_model::ScanModel;
use crate::registration::usability;
use crate::registration::verification::decline;
use crate::registration::verification::probability;
use crate::registration::verification::surface_fit::{Posed, surface_fit};
use crate::registration::verification::verifier::{ScoredHypothesis, Verifier};
use crate::scan::{DeclineReason, Evidence, ScanId, SimilarityMatrix};
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
    pub evidence: Evidence,
    /// Root mean square distance of the inlier matches, metres.
    pub residual_m: f64,
    /// Registered scan that the largest part of the inliers comes from.
    pub parent: Option<ScanId>,
    /// Why the evidence does not suffice; `None` when it does.
    pub refusal: Option<DeclineReason>,
    /// What the component saw through of the scan, and the scan of it.
    pub seen_through: [f64; 2],
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
    settings: &'a IncrementalConfig,
    pub(super) radius_m: f32,
    pub(super) seed: u64,
    /// Keypoints of every scan, indexed in its own frame with radius τ.
    pub(super) grids: Vec<RadiusGrid<'a>>,
    /// Surfaces of every scan; empty where surfaces are not checked.
    pub(super) models: Vec<ScanModel<'a>>,
    /// What every scan is, for its random numbers.
    digests: Vec<ContentDigest>,
    /// What was seen through at the joins made so far that are sure without it.
    sure: Vec<probability::SurePair>,
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
        settings: &'a IncrementalConfig,
        lengths: Lengths,
        seed: u64,
    ) -> Self {
        let radius_m = lengths.inlier_radius_m as f32;
        let mut refusals: Vec<Option<DeclineReason>> = vec![None; scans.len()];
        let mut remaining = Vec::new();
        for (i, scan) in scans.iter().enumerate() {
            match usability::unusable(scan, MIN_KEYPOINTS, lengths.voxel_m) {
                Some(reason) => refusals[i] = Some(reason),
                None => remaining.push(ScanId(i)),
            }
        }
        let grids = scans.par_iter().map(|s| RadiusGrid::new(&s.features.keypoints, radius_m)).collect();
        let compared = config.verification.surfaces().is_some()
            || settings.ordering == Ordering::Overlap
            || config.multiview_icp.enabled;
        let checked = if compared { scans } else { &[] };
        let models = checked.par_iter().map(|s| ScanModel::new(s.surface, radius_m, config)).collect();
        let columns = scans.par_iter().map(|s| Columns::new(&s.features.descriptors)).collect();
        Self {
            scans,
            similarity,
            config,
            settings,
            digests: scans.par_iter().map(ContentDigest::of).collect(),
            sure: Vec::new(),
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
        let (target, registrar) = (meta.as_target(), self.registrar());
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
                let features = self.scans[scan.0].features;
                candidate.update(features, self.digests[scan.0], &target, &registrar);
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

    fn registrar(&self) -> PairRegistrar<'a> {
        let config = &self.config.estimator;
        PairRegistrar { config, radius_m: f64::from(self.radius_m), seed: self.seed }
    }

    /// The most probable hypothesis of a candidate, or without surfaces the one with most inliers.
    fn judge(&self, scan: ScanId, candidate: &Candidate, meta: &MetaShape) -> Attempt {
        let scored = match self.config.verification.surfaces() {
            Some(settings) => self.score(settings, scan, candidate),
            None => self.count_inliers(scan, candidate),
        };
        let Some(ScoredHypothesis { a_from_b: world_from_scan, evidence, seen_through }) = scored else {
            let evidence = Evidence { matches: candidate.matches.len(), ..Evidence::default() };
            return self.attempt(scan, RigidMotion::identity(), evidence, 0.0, None);
        };
        let (residual_m, parent) = self.inlier_summary(&candidate.matches, &world_from_scan, meta);
        Attempt { seen_through, ..self.attempt(scan, world_from_scan, evidence, residual_m, parent) }
    }

    /// Scores the hypotheses of a candidate against the component.
    fn score(
        &self,
        settings: &SurfaceVerification,
        scan: ScanId,
        candidate: &Candidate,
    ) -> Option<ScoredHypothesis> {
        let verifier = Verifier::new(&self.models, settings, f64::from(self.radius_m));
        let motions: Vec<RigidMotion> = candidate.hypotheses.iter().map(|h| h.target_from_source).collect();
        let matches = Correspondences::new(&candidate.matches.source, &candidate.matches.target);
        verifier.score(&self.placed_surfaces(), &[self.alone(scan)], &motions, &matches).into_iter().next()
    }

    /// The hypothesis with most inliers (IC), and where the order needs it the overlap.
    fn count_inliers(&self, scan: ScanId, candidate: &Candidate) -> Option<ScoredHypothesis> {
        let best = candidate.hypotheses.first()?;
        let a_from_b = best.target_from_source;
        let overlap = if self.settings.ordering == Ordering::Overlap {
            surface_fit(&self.placed_surfaces(), &[self.alone(scan)], &a_from_b, 1).overlap
        } else {
            0.0
        };
        let evidence = Evidence {
            matches: candidate.matches.len(),
            inliers: best.inliers,
            second_best_inliers: candidate.hypotheses.iter().skip(1).map(|h| h.inliers).max().unwrap_or(0),
            overlap,
            ..Evidence::default()
        };
        Some(ScoredHypothesis { a_from_b, evidence, seen_through: [0.0; 2] })
    }

    fn alone(&self, scan: ScanId) -> Posed<'_> {
        Posed { model: &self.models[scan.0], group_from_scan: RigidMotion::identity() }
    }

    fn attempt(
        &self,
        scan: ScanId,
        world_from_scan: RigidMotion,
        evidence: Evidence,
        residual_m: f64,
        parent: Option<ScanId>,
    ) -> Attempt {
        // Fewer inliers than a motion has are no registration under any settings.
        let refusal = if evidence.inliers < MIN_KEYPOINTS {
            Some(DeclineReason::TooFewInliers {
                inliers: evidence.inliers,
                needed: self.config.verification.min_inliers().max(MIN_KEYPOINTS),
                matches: evidence.matches,
            })
        } else {
            decline::refusal(&evidence, &self.config.verification)
        };
        Attempt { scan, world_from_scan, evidence, residual_m, parent, refusal, seen_through: [0.0; 2] }
    }

    /// Surfaces of the members.
    fn placed_surfaces(&self) -> Vec<Posed<'_>> {
        self.members
            .iter()
            .map(|m| Posed { model: &self.models[m.scan.0], group_from_scan: m.world_from_scan })
            .collect()
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
        if !self.settings.averaging.enabled {
            return chosen.world_from_scan;
        }
        let registered: Vec<Registered<'_>> = self
            .members
            .iter()
            .map(|m| Registered { keypoints: &self.grids[m.scan.0], world_from_scan: m.world_from_scan })
            .collect();
        let keypoints = &self.grids[chosen.scan.0];
        average_observations(keypoints, &chosen.world_from_scan, &registered, &self.settings.averaging)
    }

    /// Adds the scan to the meta-shape and updates the meta-shape's row of S.
    pub fn merge(&mut self, chosen: &Attempt, world_from_scan: RigidMotion) {
        let Some(meta) = &mut self.meta else { return };
        let scan = chosen.scan;
        let content = u128::from_le_bytes(self.digests[scan.0].0);
        let mut rng = generator(self.seed, "reservoir", content as u64);
        let features = self.scans[scan.0].features;
        meta.merge(scan, features, &world_from_scan, self.settings.merge, self.radius_m, &mut rng);
        for (best, &new) in self.meta_similarity.iter_mut().zip(self.similarity.row(scan.0)) {
            *best = best.max(new);
        }
        self.remaining.retain(|&s| s != scan);
        self.candidates.remove(&scan);
        let parent = self.members.iter().find(|m| Some(m.scan) == chosen.parent);
        let mut attempt = chosen.clone();
        attempt.evidence.parent_from_scan = parent.map(|p| p.world_from_scan.inverse() * world_from_scan);
        self.members.push(Member { scan, world_from_scan, attempt: Some(attempt) });
        self.joined_since_refinement += 1;
        self.learn_reliability(scan, chosen);
    }

    /// Takes in what a join shows of the viewpoints: of its scan's own, and of its parent's for the rest.
    fn learn_reliability(&mut self, scan: ScanId, chosen: &Attempt) {
        let (Some(settings), Some(parent)) = (self.config.verification.surfaces(), chosen.parent) else {
            return;
        };
        if probability::is_sure_without_free_space(&chosen.evidence, settings) {
            self.sure.push(((parent.0, scan.0), chosen.seen_through));
            let reliability = probability::viewpoint_reliability(self.scans.len(), &self.sure, settings);
            self.models.iter_mut().zip(reliability).for_each(|(model, r)| model.set_borne_out(r));
        }
    }

    /// Refines all poses of the component together when enough scans have joined.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn refine_if_due(&mut self, monitor: &dyn Monitor) -> Result<()> {
        let every = self.settings.refine_every;
        if self.config.multiview_icp.enabled && every > 0 && self.joined_since_refinement >= every {
            self.refine_members(monitor)?;
        }
        Ok(())
    }

    fn refine_members(&mut self, monitor: &dyn Monitor) -> Result<()> {
        let scans: Vec<PosedScan<'_>> = self
            .members
            .iter()
            .map(|m| PosedScan { model: &self.models[m.scan.0], world_from_scan: m.world_from_scan })
            .collect();
        let refined = refine_poses(&scans, &self.config.multiview_icp, f64::from(self.radius_m), monitor)?;
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

    /// Ends the component: a last multiview ICP, or a refusal where the pivot stayed alone.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn close_component(&mut self, monitor: &dyn Monitor) -> Result<()> {
        if let [alone] = self.members.as_slice() {
            let scan = alone.scan;
            let needed = self.config.verification.min_inliers().max(MIN_KEYPOINTS);
            let nothing = DeclineReason::TooFewInliers { inliers: 0, needed, matches: 0 };
            self.refusals[scan.0].get_or_insert(nothing);
            self.members.clear();
            return Ok(());
        }
        if self.config.multiview_icp.enabled {
            self.refine_members(monitor)?;
        }
        self.components.push(std::mem::take(&mut self.members));
        Ok(())
    }
}
