//! The state of a growing registration and the mechanism of its steps.
//!
//! [`super::incremental`] says when each step happens; this file says how.

use super::config::RegistrationConfig;
use super::estimate::{Hypothesis, estimate};
use super::evidence;
use super::incremental::ScanInput;
use super::joint::{JointScan, refine_jointly};
use super::matching::{Matches, NearestCache};
use super::meta_shape::MetaShape;
use super::nearest::Columns;
use super::refinement::{Registered, average_observations};
use crate::error::Result;
use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::overlap::two_way_overlap;
use crate::geometry::rigid::PointMover;
use crate::geometry::{Point, RigidMotion};
use crate::monitor::Monitor;
use crate::scan::{
    DeclineReason, NeighbourEvidence, Outcome, Placement, Reconstruction, ScanId, SimilarityMatrix,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Keypoints below which a scan is not tried.
const MIN_KEYPOINTS: usize = 3;

/// The outcome of registering one candidate against the meta-shape.
#[derive(Debug, Clone)]
pub struct Attempt {
    /// The candidate.
    pub scan: ScanId,
    /// Its pose by the robust estimate; identity when there is none.
    pub world_from_scan: RigidMotion,
    /// Mutual matches with the meta-shape.
    pub matches: usize,
    /// Matches within τ.
    pub inliers: usize,
    /// Root mean square distance of the inlier matches, metres.
    pub residual_m: f64,
    /// Share of the candidate's keypoints near the meta-shape; 0 unless ordering needs it.
    pub overlap: f64,
    /// Registered scan that the largest part of the inliers comes from.
    pub parent: Option<ScanId>,
    /// Whether the evidence suffices, and if not why.
    pub accepted: bool,
    /// The reason when it does not.
    pub reason: DeclineReason,
}

/// A scan of the current component.
#[derive(Debug, Clone)]
struct Member {
    scan: ScanId,
    world_from_scan: RigidMotion,
    /// `None` for the pivot.
    attempt: Option<Attempt>,
}

/// What is remembered of a candidate between steps.
struct Candidate {
    nearest: NearestCache,
    matches: Matches,
    hypotheses: Vec<Hypothesis>,
}

/// State of the registration.
pub struct Growth<'a> {
    scans: &'a [ScanInput<'a>],
    similarity: &'a SimilarityMatrix,
    config: &'a RegistrationConfig,
    radius_m: f32,
    seed: u64,
    /// Keypoints of every scan, indexed in its own frame with radius τ.
    grids: Vec<RadiusGrid<'a>>,
    /// Descriptors of every scan, packed for matching.
    columns: Vec<Columns>,
    /// Scans without an outcome yet.
    remaining: Vec<ScanId>,
    meta: Option<MetaShape>,
    /// Highest similarity of each scan to a member of the component.
    meta_similarity: Vec<f32>,
    candidates: BTreeMap<ScanId, Candidate>,
    members: Vec<Member>,
    joined_since_refinement: usize,
    /// Finished components.
    components: Vec<Vec<Member>>,
    /// Why each scan was last refused.
    refusals: Vec<Option<DeclineReason>>,
}

impl<'a> Growth<'a> {
    /// Nothing registered yet.
    pub fn new(
        scans: &'a [ScanInput<'a>],
        similarity: &'a SimilarityMatrix,
        config: &'a RegistrationConfig,
        radius_m: f32,
        seed: u64,
    ) -> Self {
        let mut refusals: Vec<Option<DeclineReason>> = vec![None; scans.len()];
        let mut remaining = Vec::new();
        for (i, scan) in scans.iter().enumerate() {
            match evidence::unusable(scan, MIN_KEYPOINTS) {
                Some(reason) => refusals[i] = Some(reason),
                None => remaining.push(ScanId(i)),
            }
        }
        let grids = scans.par_iter().map(|s| RadiusGrid::new(&s.features.keypoints, radius_m)).collect();
        let columns = scans.par_iter().map(|s| Columns::new(&s.features.descriptors)).collect();
        Self {
            scans,
            similarity,
            config,
            radius_m,
            seed,
            grids,
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
        for attempt in attempts.iter().filter(|a| !a.accepted) {
            self.refusals[attempt.scan.0] = Some(attempt.reason.clone());
        }
        attempts
    }

    /// The best hypothesis of a candidate with its evidence.
    fn judge(&self, scan: ScanId, candidate: &Candidate, meta: &MetaShape) -> Attempt {
        let matches = &candidate.matches;
        let best = candidate.hypotheses.first();
        let world_from_scan = best.map_or_else(RigidMotion::identity, |h| h.target_from_source);
        let mover = PointMover::new(&world_from_scan);
        let limit = self.radius_m * self.radius_m;
        let (mut squared, mut inliers) = (0.0f64, 0usize);
        let mut by_scan: BTreeMap<ScanId, usize> = BTreeMap::new();
        for (m, pair) in matches.pairs.iter().enumerate().take_while(|_| best.is_some()) {
            let d = (mover.point(&matches.source[m]) - matches.target[m]).norm_squared();
            if d <= limit {
                squared += f64::from(d);
                inliers += 1;
                *by_scan.entry(meta.origin(pair.1 as usize).0).or_default() += 1;
            }
        }
        let parent = by_scan.iter().max_by_key(|(s, n)| (**n, std::cmp::Reverse(**s))).map(|p| *p.0);
        let overlap = match self.config.ordering {
            super::config::Ordering::Overlap => self.share_near_meta_shape(scan, &mover, meta),
            _ => 0.0,
        };
        let needed = evidence::needed_inliers(&self.config.evidence, matches.len());
        let reason = DeclineReason::TooFewInliers { inliers, needed, matches: matches.len() };
        Attempt {
            scan,
            world_from_scan,
            matches: matches.len(),
            inliers,
            residual_m: if inliers == 0 { 0.0 } else { (squared / inliers as f64).sqrt() },
            overlap,
            parent,
            accepted: best.is_some() && inliers >= needed,
            reason,
        }
    }

    /// Share of a candidate's keypoints with a row of the meta-shape within τ.
    fn share_near_meta_shape(&self, scan: ScanId, mover: &PointMover, meta: &MetaShape) -> f64 {
        let grid = RadiusGrid::new(meta.points(), self.radius_m);
        let keypoints: &[Point] = &self.scans[scan.0].features.keypoints;
        let near = keypoints.iter().filter(|p| grid.any(&mover.point(p))).count();
        near as f64 / keypoints.len().max(1) as f64
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
        self.members.push(Member { scan, world_from_scan, attempt: Some(chosen.clone()) });
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
            .map(|m| JointScan { surface: self.scans[m.scan.0].surface, world_from_scan: m.world_from_scan })
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
            let nothing = DeclineReason::TooFewInliers {
                inliers: 0,
                needed: evidence::needed_inliers(&self.config.evidence, 0),
                matches: 0,
            };
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

    /// One outcome a scan; components ordered by size, then by their first scan.
    pub fn conclude(mut self) -> Reconstruction {
        let lowest = |c: &[Member]| c.iter().map(|m| m.scan).min();
        self.components.sort_by_key(|c| (std::cmp::Reverse(c.len()), lowest(c)));
        let unexplained = DeclineReason::TooFewInliers { inliers: 0, needed: MIN_KEYPOINTS, matches: 0 };
        let mut outcomes: Vec<Outcome> = std::mem::take(&mut self.refusals)
            .into_iter()
            .map(|r| Outcome::Declined(r.unwrap_or_else(|| unexplained.clone())))
            .collect();
        for (component, members) in self.components.iter().enumerate() {
            let neighbours: Vec<Vec<NeighbourEvidence>> =
                (0..members.len()).into_par_iter().map(|m| self.neighbours(members, m)).collect();
            for (step, (member, neighbours)) in members.iter().zip(neighbours).enumerate() {
                let attempt = member.attempt.as_ref();
                outcomes[member.scan.0] = Outcome::Placed(Placement {
                    world_from_scan: member.world_from_scan,
                    component,
                    step,
                    parent: attempt.and_then(|a| a.parent),
                    matches: attempt.map_or(0, |a| a.matches),
                    inliers: attempt.map_or(0, |a| a.inliers),
                    residual_m: attempt.map_or(0.0, |a| a.residual_m),
                    neighbours,
                });
            }
        }
        Reconstruction { outcomes }
    }

    /// Agreement of one member with all others it touches, at the final poses.
    fn neighbours(&self, members: &[Member], of: usize) -> Vec<NeighbourEvidence> {
        const LEAST: f64 = 0.01;
        let here = &members[of];
        let mut found: Vec<NeighbourEvidence> = members
            .iter()
            .filter(|there| there.scan != here.scan)
            .filter_map(|there| {
                let here_from_there = here.world_from_scan.inverse() * there.world_from_scan;
                let o =
                    two_way_overlap(&self.grids[here.scan.0], &self.grids[there.scan.0], &here_from_there);
                (o.ratio >= LEAST).then_some(NeighbourEvidence {
                    scan: there.scan,
                    overlap: o.ratio,
                    residual_m: o.residual_m,
                })
            })
            .collect();
        found.sort_by_key(|n| n.scan);
        found
    }
}

impl Candidate {
    fn new(columns: Columns) -> Self {
        Self { nearest: NearestCache::new(columns), matches: Matches::default(), hypotheses: Vec::new() }
    }

    /// Brings matches up to date, and the hypotheses where the matches changed.
    fn update(
        &mut self,
        scan: ScanInput<'_>,
        meta: &MetaShape,
        config: &RegistrationConfig,
        radius_m: f32,
        seed: u64,
        id: ScanId,
    ) {
        self.nearest.update(meta);
        let matches = self.nearest.mutual(&scan.features.keypoints, meta);
        if matches != self.matches {
            // One stream of random numbers a scan: the outcome depends on the matches alone.
            let seed = seed ^ (id.0 as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            self.hypotheses = estimate(&matches, &config.estimator, f64::from(radius_m), seed);
            self.matches = matches;
        }
    }
}
