//! State of a registration that joins components, strongest evidence first, and the mechanism
//! of its steps; [`crate::registration::agglomerative`] says when each happens.

use super::edge::ComponentEdge;
use crate::error::Result;
use crate::geometry::rigid::PointMover;
use crate::geometry::{Point, RigidMotion};
use crate::monitor::Monitor;
use crate::registration::agglomerative::pairs::ScanPair;
use crate::registration::config::{AgglomerativeConfig, MultiviewIcpConfig, RegistrationConfig};
use crate::registration::pairwise::correspondences::Correspondences;
use crate::registration::verification::surface_fit::Posed;
use crate::registration::verification::verifier::{ScoredHypothesis, Verifier, centre_of};
use crate::scan::{Evidence, ScanId};
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

/// Pairs of components that are scored at a time: few among the most promising ones, of which one
/// mostly suffices, and many among the rest, which then all have to be known.
const BATCH: usize = 2;
const FIRST_EDGES: usize = 16;
const LATER_BATCH: usize = 16;
/// Edges with a lower prior score than one of these are looked at only when none of more is certain enough to be
/// joined by, and those of less than the last not at all: none of their pairs of scans gives any
/// proposal a chance.
const PRIOR_SCORES: [f64; 3] = [1.0, 0.1, 1e-3];

/// An edge that joined two components.
#[derive(Debug, Clone, Copy)]
pub struct Join {
    /// The two scans whose registration spoke for it most, one of either component.
    pub scans: (ScanId, ScanId),
    /// Pose of the second relative to the first when they joined.
    pub first_from_second: RigidMotion,
    /// The evidence between the components.
    pub evidence: Evidence,
}

/// Scans posed relative to each other.
#[derive(Debug, Clone)]
pub struct Component {
    /// Scans with their poses in the frame of the first, which is the pivot.
    pub members: Vec<(ScanId, RigidMotion)>,
    /// The joins that made it: a spanning tree of its scans, in order.
    pub joins: Vec<Join>,
    /// Members at the time of the last multiview ICP.
    pub(super) refined_at: usize,
}

/// Names a component; every join makes a new one.
pub(super) type ComponentId = usize;

/// State of the registration.
pub struct Agglomeration<'a> {
    pub(super) verifier: &'a Verifier<'a>,
    pub(super) settings: AgglomerativeConfig,
    pub(super) multiview_icp: &'a MultiviewIcpConfig,
    /// Keypoints of every scan, in its frame.
    pub(super) keypoints: Vec<&'a [Point]>,
    pub(super) pairs: Vec<ScanPair>,
    /// The pairs that a scan is in, ascending.
    pub(super) pairs_by_scan: BTreeMap<ScanId, Vec<usize>>,
    pub(super) components: BTreeMap<ComponentId, Component>,
    pub(super) edges: BTreeMap<(ComponentId, ComponentId), ComponentEdge>,
    pub(super) next: ComponentId,
    /// Components refined with the full setting, and unchanged since.
    pub(super) settled: BTreeSet<ComponentId>,
    /// Scans that joined alone by a trial, which refuted their rivals.
    pub(super) tried_out: BTreeSet<ScanId>,
}

/// A join that may be made.
#[derive(Debug, Clone, Copy)]
pub struct Proposal {
    pub(super) a: ComponentId,
    pub(super) b: ComponentId,
    pub(super) scored: ScoredHypothesis,
    pub(super) pair: usize,
}

impl Proposal {
    /// Probability that it is right.
    pub fn probability(&self) -> f64 {
        self.scored.probability()
    }

    /// The evidence for it.
    pub fn evidence(&self) -> Evidence {
        self.scored.evidence
    }
}

impl<'a> Agglomeration<'a> {
    /// Every one of `scans` a component of its own; `keypoints` are those of all scans of the verifier.
    pub fn new(
        verifier: &'a Verifier<'a>,
        config: &'a RegistrationConfig,
        keypoints: Vec<&'a [Point]>,
        scans: &[ScanId],
    ) -> Self {
        let alone = |&s: &ScanId| Component {
            members: vec![(s, RigidMotion::identity())],
            joins: Vec::new(),
            refined_at: 1,
        };
        let components = scans.iter().map(|s| (s.0, alone(s))).collect();
        let next = scans.iter().map(|s| s.0 + 1).max().unwrap_or(0);
        Self {
            verifier,
            settings: config.agglomerative().cloned().unwrap_or_default(),
            multiview_icp: &config.multiview_icp,
            keypoints,
            pairs: Vec::new(),
            pairs_by_scan: BTreeMap::new(),
            components,
            edges: BTreeMap::new(),
            next,
            settled: BTreeSet::new(),
            tried_out: BTreeSet::new(),
        }
    }

    /// Components of scans at given poses, for measuring how evidence relates to truth.
    pub fn of_groups(
        verifier: &'a Verifier<'a>,
        config: &'a RegistrationConfig,
        keypoints: Vec<&'a [Point]>,
        groups: Vec<Vec<(ScanId, RigidMotion)>>,
    ) -> Self {
        let mut agglomeration = Self::new(verifier, config, keypoints, &[]);
        for members in groups.into_iter().filter(|g| !g.is_empty()) {
            let refined_at = members.len();
            agglomeration
                .components
                .insert(agglomeration.next, Component { members, joins: Vec::new(), refined_at });
            agglomeration.next += 1;
        }
        agglomeration
    }

    /// Centre of a component's scans, in its frame; the origin where there is no such component.
    pub fn centre(&self, component: usize) -> nalgebra::Point3<f64> {
        self.components
            .get(&component)
            .map_or_else(nalgebra::Point3::origin, |c| centre_of(&self.posed(&c.members)))
    }

    /// Scans of a component; 0 where there is no such component.
    pub fn size(&self, component: usize) -> usize {
        self.components.get(&component).map_or(0, |c| c.members.len())
    }

    /// All scored proposals between any two components, as `(a, b, proposals)` with the
    /// components' places in [`Self::of_groups`].
    pub fn scored_hypotheses(&self) -> Vec<(usize, usize, Vec<ScoredHypothesis>)> {
        let edges: Vec<_> = self.edges.iter().collect();
        edges.into_par_iter().map(|(&(a, b), edge)| (a, b, self.score_all((a, b), edge))).collect()
    }

    /// Takes in more registered pairs.
    pub fn add_pairs(&mut self, pairs: Vec<ScanPair>) {
        for (p, pair) in (self.pairs.len()..).zip(&pairs) {
            for scan in [pair.i, pair.j] {
                self.pairs_by_scan.entry(scan).or_default().push(p);
            }
        }
        self.pairs.extend(pairs);
        self.rebuild_edges();
    }

    /// The pairs that a scan is in, each with its other scan.
    pub(super) fn pairs_of(&self, scan: ScanId) -> Vec<(usize, ScanId)> {
        let of_scan = self.pairs_by_scan.get(&scan).into_iter().flatten();
        let other = |pair: &ScanPair| if scan == pair.j { pair.i } else { pair.j };
        of_scan.map(|&p| (p, other(&self.pairs[p]))).collect()
    }

    /// The pairs of two scans of a component, in their order.
    pub(super) fn pairs_within(&self, component: &Component) -> Vec<&ScanPair> {
        let members: BTreeSet<ScanId> = component.members.iter().map(|m| m.0).collect();
        let of = |scan: &ScanId| self.pairs_by_scan.get(scan).into_iter().flatten().copied();
        let is_within = |&p: &usize| members.contains(&self.pairs[p].j);
        let from = |scan: &ScanId| -> Vec<usize> {
            of(scan).filter(|&p| self.pairs[p].i == *scan).filter(is_within).collect()
        };
        let mut within: Vec<usize> = members.iter().flat_map(from).collect();
        within.sort_unstable();
        within.into_iter().map(|p| &self.pairs[p]).collect()
    }

    pub(super) fn posed(&self, members: &[(ScanId, RigidMotion)]) -> Vec<Posed<'a>> {
        let models = self.verifier.models;
        members.iter().map(|&(s, pose)| Posed { model: &models[s.0], group_from_scan: pose }).collect()
    }

    /// The two keypoints of every match of a pair, each in its scan's frame.
    pub(super) fn matched_keypoints(&self, pair: &ScanPair) -> (Vec<Point>, Vec<Point>) {
        let (of_i, of_j) = (self.keypoints[pair.i.0], self.keypoints[pair.j.0]);
        pair.matches.iter().map(|&(i, j)| (of_i[i as usize], of_j[j as usize])).unzip()
    }

    /// Matches of pairs with one scan in either group, in the groups' frames: sources of `b`.
    pub(super) fn matches_between(
        &self,
        pairs: &[usize],
        a: &BTreeMap<ScanId, RigidMotion>,
        b: &BTreeMap<ScanId, RigidMotion>,
    ) -> Correspondences {
        let (mut source, mut target): (Vec<Point>, Vec<Point>) = (Vec::new(), Vec::new());
        for &p in pairs {
            let pair = &self.pairs[p];
            let (in_i, in_j) = self.matched_keypoints(pair);
            if let (Some(i), Some(j)) = (a.get(&pair.i), b.get(&pair.j)) {
                source.extend(PointMover::new(j).points(&in_j));
                target.extend(PointMover::new(i).points(&in_i));
            } else if let (Some(j), Some(i)) = (a.get(&pair.j), b.get(&pair.i)) {
                source.extend(PointMover::new(i).points(&in_i));
                target.extend(PointMover::new(j).points(&in_j));
            }
        }
        Correspondences::new(&source, &target)
    }

    /// Measures the evidence for the proposals of an edge; most probable first.
    pub(super) fn score_all(
        &self,
        (a, b): (ComponentId, ComponentId),
        edge: &ComponentEdge,
    ) -> Vec<ScoredHypothesis> {
        let (ca, cb) = (&self.components[&a], &self.components[&b]);
        let poses = |c: &Component| c.members.iter().copied().collect::<BTreeMap<_, _>>();
        let matches = self.matches_between(&edge.pairs, &poses(ca), &poses(cb));
        let (ga, gb) = (self.posed(&ca.members), self.posed(&cb.members));
        let motions: Vec<RigidMotion> = edge.proposals.iter().map(|p| p.0).collect();
        self.verifier.score(&ga, &gb, &motions, &matches)
    }

    /// The proposals of an edge, most probable first, each with the pair of scans that it came from.
    pub(super) fn score(
        &self,
        key: (ComponentId, ComponentId),
        edge: &ComponentEdge,
    ) -> Vec<(ScoredHypothesis, usize)> {
        let centre = self.centre(key.1);
        let origin = |found: ScoredHypothesis| {
            // The proposal it came from: the nearest one.
            let distance = |m: &RigidMotion| {
                (m * centre - found.a_from_b * centre).norm() + m.rotation.angle_to(&found.a_from_b.rotation)
            };
            let from = edge.proposals.iter().min_by(|x, y| distance(&x.0).total_cmp(&distance(&y.0)))?;
            Some((found, from.1))
        };
        self.score_all(key, edge).into_iter().filter_map(origin).collect()
    }

    /// The best-supported join: edges that some pair of scans gives a chance are looked at in the order
    /// of their prior score until one is as good as certain; failing that, the most probable of the more
    /// promising ones if it may be made, or else of all. `None` without any such edge.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn best_join(&mut self, monitor: &dyn Monitor) -> Result<Option<Proposal>> {
        let mut order: Vec<(f64, (ComponentId, ComponentId))> =
            self.edges.iter().map(|(key, edge)| (edge.prior_score, *key)).collect();
        order.sort_unstable_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        let mut best: Option<Proposal> = None;
        let mut examined = 0;
        for prior_score in PRIOR_SCORES {
            let as_good = order.partition_point(|l| l.0 >= prior_score);
            while examined < as_good {
                monitor.check("registration")?;
                let size = if examined < FIRST_EDGES { BATCH } else { LATER_BATCH };
                let batch = &order[examined..as_good.min(examined + size)];
                examined += batch.len();
                let keys: Vec<_> = batch.iter().map(|b| b.1).collect();
                let found = self.most_probable(&keys);
                if found.is_some_and(|f| best.is_none_or(|old| f.probability() > old.probability())) {
                    best = found;
                }
                if best.is_some_and(|p| p.probability() >= self.verifier.settings.confident) {
                    return Ok(best);
                }
            }
            if best.is_some_and(|p| p.probability() >= self.verifier.settings.accept) {
                break;
            }
        }
        Ok(best)
    }

    /// The most probable proposal of some edges, whose evidence is measured where it is not known; of
    /// equally probable ones the first.
    pub(super) fn most_probable(&mut self, keys: &[(ComponentId, ComponentId)]) -> Option<Proposal> {
        let unknown: Vec<(ComponentId, ComponentId)> =
            keys.iter().copied().filter(|key| self.edges[key].scored.is_none()).collect();
        let scored: Vec<_> = unknown.par_iter().map(|key| self.score(*key, &self.edges[key])).collect();
        for (key, found) in unknown.into_iter().zip(scored) {
            self.edges.entry(key).and_modify(|edge| edge.scored = Some(found));
        }
        let proposal = |&(a, b): &(ComponentId, ComponentId)| {
            let (scored, pair) = self.edges[&(a, b)].best()?;
            Some(Proposal { a, b, scored, pair })
        };
        let accept = self.verifier.settings.accept;
        let among_cycles = |p: Proposal| if p.probability() < accept { p } else { self.among_cycles(p) };
        keys.iter()
            .filter_map(proposal)
            .map(among_cycles)
            .reduce(|best, next| if next.probability() > best.probability() { next } else { best })
    }

    /// A join in words, for the log.
    pub fn describe(&self, proposal: &Proposal) -> String {
        let size = |c: &ComponentId| self.components.get(c).map_or(0, |c| c.members.len());
        let pair = &self.pairs[proposal.pair];
        format!(
            "{} with {} scans by {} and {}: {:?}",
            size(&proposal.a),
            size(&proposal.b),
            pair.i,
            pair.j,
            proposal.scored.evidence
        )
    }

    /// Joins two components: the smaller is brought into the frame of the larger.
    pub fn join(&mut self, proposal: &Proposal) {
        let (ca, cb) = (self.components.get(&proposal.a), self.components.get(&proposal.b));
        let (Some(ca), Some(cb)) = (ca, cb) else { return };
        if let Some(joined) = self.joined(ca, cb, proposal) {
            // The larger comes first and stays as it is.
            let kept = if joined.members[0].0 == ca.members[0].0 { proposal.a } else { proposal.b };
            self.replace(&[proposal.a, proposal.b], joined, Some(kept));
        }
    }

    pub(super) fn joined(&self, ca: &Component, cb: &Component, proposal: &Proposal) -> Option<Component> {
        let pair = self.pairs.get(proposal.pair)?;
        let ScoredHypothesis { a_from_b, evidence, .. } = proposal.scored;
        // The larger keeps its frame; of equals the one with the lower pivot.
        let first =
            (ca.members.len(), Reverse(ca.members[0].0)) >= (cb.members.len(), Reverse(cb.members[0].0));
        let (large, small, large_from_small) =
            if first { (ca, cb, a_from_b) } else { (cb, ca, a_from_b.inverse()) };
        let mut joined = large.clone();
        joined.members.extend(small.members.iter().map(|&(s, pose)| (s, large_from_small * pose)));
        joined.joins.extend(&small.joins);
        let pose = |s: ScanId| joined.members.iter().find(|m| m.0 == s).map(|m| m.1);
        let first_from_second = pose(pair.i)?.inverse() * pose(pair.j)?;
        joined.joins.push(Join { scans: (pair.i, pair.j), first_from_second, evidence });
        Some(joined)
    }

    /// Puts `with` in the place of the components in `gone`, of which `kept` comes first in it, unmoved.
    pub(super) fn replace(&mut self, gone: &[ComponentId], with: Component, kept: Option<ComponentId>) {
        let known = kept.and_then(|id| Some((id, self.components.get(&id)?.members.len())));
        for id in gone {
            self.components.remove(id);
            self.settled.remove(id);
        }
        let id = self.next;
        self.next += 1;
        let newcomers = known.map(|(kept, n)| (kept, with.members[n..].to_vec()));
        self.components.insert(id, with);
        self.replace_edges(gone, id, newcomers.as_ref().map(|(kept, scans)| (*kept, scans.as_slice())));
    }
}
