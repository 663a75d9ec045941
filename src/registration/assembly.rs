//! State of a registration that joins components, strongest evidence first, and the mechanism
//! of its steps; [`super::agglomerate`] says when each happens.

mod refinement;
mod review;
mod trial;

use super::assessment::{Assessment, Assessor, centre_of};
use super::config::RegistrationConfig;
use super::estimate::same_motion;
use super::estimate::scoring::Correspondences;
use super::pairs::ScanPair;
use super::surface_fit::Posed;
use crate::error::Result;
use crate::geometry::rigid::PointMover;
use crate::geometry::{Point, RigidMotion};
use crate::monitor::Monitor;
use crate::scan::{ScanId, Support};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Clusters of pairwise hypotheses of two components that are assessed.
const CLUSTERS: usize = 8;
/// Pairs of components that are assessed at a time.
const BATCH: usize = 2;

/// A link that joined two components.
#[derive(Debug, Clone, Copy)]
pub struct Join {
    /// The two scans whose registration spoke for it most, one of either component.
    pub scans: (ScanId, ScanId),
    /// Pose of the second relative to the first when they joined.
    pub first_from_second: RigidMotion,
    /// The evidence between the components.
    pub support: Support,
}

/// Scans posed relative to each other.
#[derive(Debug, Clone)]
pub struct Component {
    /// Scans with their poses in the frame of the first, which is the pivot.
    pub members: Vec<(ScanId, RigidMotion)>,
    /// The joins that made it: a spanning tree of its scans, in order.
    pub joins: Vec<Join>,
    /// Members at the time of the last joint refinement.
    refined_at: usize,
}

/// Names a component; every join makes a new one.
type ComponentId = usize;

/// What is known about two components' relative pose.
#[derive(Debug, Clone)]
struct Link {
    /// Pairs of scans with one in either component.
    pairs: Vec<usize>,
    /// Distinct proposals `a_from_b` with the pair that speaks for each most, best first.
    proposals: Vec<(RigidMotion, usize)>,
    /// How probable the best proposal is if pairs were independent witnesses.
    promise: f64,
    /// Evidence for proposals, most probable first, and the pair that speaks for each; once measured.
    assessed: Option<Vec<(Assessment, usize)>>,
}

impl Link {
    /// The most probable proposal, where it was measured.
    fn best(&self) -> Option<(Assessment, usize)> {
        self.assessed.as_ref()?.first().copied()
    }
}

/// State of the registration.
pub struct Assembly<'a> {
    assessor: &'a Assessor<'a>,
    pairs: Vec<ScanPair>,
    components: BTreeMap<ComponentId, Component>,
    links: BTreeMap<(ComponentId, ComponentId), Link>,
    next: ComponentId,
    /// Links whose trials failed, with the scans and pairs that they had.
    tried: BTreeSet<(ComponentId, ComponentId, usize, usize)>,
}

/// A join that may be made.
#[derive(Debug, Clone, Copy)]
pub struct Proposal {
    a: ComponentId,
    b: ComponentId,
    assessment: Assessment,
    pair: usize,
}

impl Proposal {
    /// Probability that it is right.
    pub fn probability(&self) -> f64 {
        self.assessment.probability()
    }
}

impl<'a> Assembly<'a> {
    /// Every scan a component of its own.
    pub fn new(assessor: &'a Assessor<'a>, scans: &[ScanId]) -> Self {
        let alone = |&s: &ScanId| Component {
            members: vec![(s, RigidMotion::identity())],
            joins: Vec::new(),
            refined_at: 1,
        };
        let components = scans.iter().map(|s| (s.0, alone(s))).collect();
        let next = scans.iter().map(|s| s.0 + 1).max().unwrap_or(0);
        Self { assessor, pairs: Vec::new(), components, links: BTreeMap::new(), next, tried: BTreeSet::new() }
    }

    /// Components of scans at given poses, for measuring how evidence relates to truth.
    pub fn of_groups(assessor: &'a Assessor<'a>, groups: Vec<Vec<(ScanId, RigidMotion)>>) -> Self {
        let mut assembly = Self::new(assessor, &[]);
        for members in groups.into_iter().filter(|g| !g.is_empty()) {
            let refined_at = members.len();
            assembly.components.insert(assembly.next, Component { members, joins: Vec::new(), refined_at });
            assembly.next += 1;
        }
        assembly
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

    /// All assessed proposals between any two components, as `(a, b, proposals)` with the
    /// components' places in [`Self::of_groups`].
    pub fn assessments(&self) -> Vec<(usize, usize, Vec<Assessment>)> {
        let links: Vec<_> = self.links.iter().collect();
        links.into_par_iter().map(|(&(a, b), link)| (a, b, self.assess_all((a, b), link))).collect()
    }

    fn config(&self) -> &RegistrationConfig {
        self.assessor.config
    }

    /// Takes in more registered pairs.
    pub fn add_pairs(&mut self, pairs: Vec<ScanPair>) {
        self.pairs.extend(pairs);
        self.relink();
    }

    /// Links between all components, made anew.
    fn relink(&mut self) {
        let home: BTreeMap<ScanId, ComponentId> =
            self.components.iter().flat_map(|(&id, c)| c.members.iter().map(move |m| (m.0, id))).collect();
        let mut between: BTreeMap<(ComponentId, ComponentId), Vec<usize>> = BTreeMap::new();
        for (p, pair) in self.pairs.iter().enumerate() {
            let (Some(&a), Some(&b)) = (home.get(&pair.i), home.get(&pair.j)) else { continue };
            if a != b && !pair.hypotheses.is_empty() {
                between.entry((a.min(b), a.max(b))).or_default().push(p);
            }
        }
        self.links = between.into_iter().map(|(key, pairs)| (key, self.link(key, pairs))).collect();
    }

    /// Clusters what the pairs between two components say of their relative pose.
    fn link(&self, (a, b): (ComponentId, ComponentId), pairs: Vec<usize>) -> Link {
        let (ca, cb) = (&self.components[&a], &self.components[&b]);
        let of = |c: &Component, s: ScanId| c.members.iter().find(|m| m.0 == s).map(|m| m.1);
        // Every hypothesis as a motion of b into the frame of a.
        let mut votes: Vec<(RigidMotion, f64, usize, ScanId)> = Vec::new();
        for &p in &pairs {
            let pair = &self.pairs[p];
            let (Some(in_a), Some(in_b)) =
                (of(ca, pair.i).or(of(ca, pair.j)), of(cb, pair.j).or(of(cb, pair.i)))
            else {
                continue;
            };
            let i_in_a = of(ca, pair.i).is_some();
            for h in &pair.hypotheses {
                let a_from_b = if i_in_a { h.a_from_b } else { h.a_from_b.inverse() };
                let of_b = if i_in_a { pair.j } else { pair.i };
                votes.push((in_a * a_from_b * in_b.inverse(), h.probability(), p, of_b));
            }
        }
        votes.sort_by(|x, y| y.1.total_cmp(&x.1).then(x.2.cmp(&y.2)));
        let mut clusters: Vec<(RigidMotion, usize, f64)> = Vec::new();
        let mut free = vec![true; votes.len()];
        for v in 0..votes.len() {
            if !free[v] {
                continue;
            }
            let (motion, _, pair, of_b) = votes[v];
            // Compared where the scans of the pair are: far away a small turn is a large shift.
            let model = &self.assessor.models[of_b.0];
            let at = of(cb, of_b).map_or(model.centre.cast(), |pose| pose * model.centre.cast::<f64>());
            // One pair is one witness, however many of its hypotheses agree.
            let mut witnesses: BTreeMap<usize, f64> = BTreeMap::new();
            for (w, other) in votes.iter().enumerate().skip(v) {
                if free[w] && same_motion(&motion, &other.0, &at, self.assessor.radius_m) {
                    free[w] = false;
                    let best = witnesses.entry(other.2).or_default();
                    *best = best.max(other.1);
                }
            }
            let doubt: f64 = witnesses.values().map(|p| (1.0 - p).ln()).sum();
            clusters.push((motion, pair, -doubt));
        }
        clusters.sort_by(|x, y| y.2.total_cmp(&x.2));
        clusters.truncate(CLUSTERS);
        let promise = clusters.first().map_or(0.0, |c| c.2);
        let mut link = Link {
            pairs,
            proposals: clusters.into_iter().map(|(motion, pair, _)| (motion, pair)).collect(),
            promise,
            assessed: None,
        };
        if let ([only], 1, 1) = (link.pairs.as_slice(), ca.members.len(), cb.members.len()) {
            // Two scans alone: the evidence between them is what their registration found.
            let pair = &self.pairs[*only];
            let i_in_a = of(ca, pair.i).is_some();
            let turned = pair.hypotheses.iter().map(|h| {
                let a_from_b = if i_in_a { h.a_from_b } else { h.a_from_b.inverse() };
                (Assessment { a_from_b, ..*h }, *only)
            });
            link.assessed = Some(turned.collect());
        }
        link
    }

    fn posed(&self, members: &[(ScanId, RigidMotion)]) -> Vec<Posed<'a>> {
        let models = self.assessor.models;
        members.iter().map(|&(s, pose)| Posed { model: &models[s.0], group_from_scan: pose }).collect()
    }

    /// Matches of pairs with one scan in either group, in the groups' frames: sources of `b`.
    fn matches_between(
        &self,
        pairs: &[usize],
        a: &BTreeMap<ScanId, RigidMotion>,
        b: &BTreeMap<ScanId, RigidMotion>,
    ) -> Correspondences {
        let (mut source, mut target): (Vec<Point>, Vec<Point>) = (Vec::new(), Vec::new());
        for &p in pairs {
            let pair = &self.pairs[p];
            let m = &pair.matches;
            if let (Some(i), Some(j)) = (a.get(&pair.i), b.get(&pair.j)) {
                source.extend(PointMover::new(j).points(&m.source));
                target.extend(PointMover::new(i).points(&m.target));
            } else if let (Some(j), Some(i)) = (a.get(&pair.j), b.get(&pair.i)) {
                source.extend(PointMover::new(i).points(&m.target));
                target.extend(PointMover::new(j).points(&m.source));
            }
        }
        Correspondences::new(&source, &target)
    }

    /// Measures the evidence for the proposals of a link; most probable first.
    fn assess_all(&self, (a, b): (ComponentId, ComponentId), link: &Link) -> Vec<Assessment> {
        let (ca, cb) = (&self.components[&a], &self.components[&b]);
        let poses = |c: &Component| c.members.iter().copied().collect::<BTreeMap<_, _>>();
        let matches = self.matches_between(&link.pairs, &poses(ca), &poses(cb));
        let (ga, gb) = (self.posed(&ca.members), self.posed(&cb.members));
        let motions: Vec<RigidMotion> = link.proposals.iter().map(|p| p.0).collect();
        self.assessor.assess(&ga, &gb, &motions, &matches)
    }

    /// The proposals of a link, most probable first, each with the pair of scans that it came from.
    fn assess(&self, key: (ComponentId, ComponentId), link: &Link) -> Vec<(Assessment, usize)> {
        let centre = self.centre(key.1);
        let origin = |found: Assessment| {
            // The proposal it came from: the nearest one.
            let distance = |m: &RigidMotion| {
                (m * centre - found.a_from_b * centre).norm() + m.rotation.angle_to(&found.a_from_b.rotation)
            };
            let from = link.proposals.iter().min_by(|x, y| distance(&x.0).total_cmp(&distance(&y.0)))?;
            Some((found, from.1))
        };
        self.assess_all(key, link).into_iter().filter_map(origin).collect()
    }

    /// The best-supported join: links are looked at in the order of their promise until one is
    /// certain enough; failing that, the most probable of all. `None` without any link.
    ///
    /// # Errors
    /// Only when the monitor is cancelled.
    pub fn best_join(&mut self, monitor: &dyn Monitor) -> Result<Option<Proposal>> {
        let mut order: Vec<(ComponentId, ComponentId)> = self.links.keys().copied().collect();
        order.sort_by(|x, y| self.links[y].promise.total_cmp(&self.links[x].promise).then(x.cmp(y)));
        let mut best: Option<Proposal> = None;
        for batch in order.chunks(BATCH) {
            monitor.check("registration")?;
            let assessed: Vec<Option<Vec<(Assessment, usize)>>> = batch
                .par_iter()
                .map(|key| {
                    let link = &self.links[key];
                    link.assessed.is_none().then(|| self.assess(*key, link))
                })
                .collect();
            for (&(a, b), found) in batch.iter().zip(assessed) {
                let Some(link) = self.links.get_mut(&(a, b)) else { continue };
                link.assessed = found.or(link.assessed.take());
                let Some((assessment, pair)) = link.best() else { continue };
                let proposal = Proposal { a, b, assessment, pair };
                if best.is_none_or(|old| proposal.probability() > old.probability()) {
                    best = Some(proposal);
                }
            }
            if best.is_some_and(|p| p.probability() >= self.config().evidence.confident) {
                break;
            }
        }
        Ok(best)
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
            proposal.assessment.support
        )
    }

    /// Joins two components: the smaller is brought into the frame of the larger.
    pub fn join(&mut self, proposal: &Proposal) {
        let (ca, cb) = (self.components.get(&proposal.a), self.components.get(&proposal.b));
        let (Some(ca), Some(cb)) = (ca, cb) else { return };
        if let Some(joined) = self.joined(ca, cb, proposal) {
            self.replace(&[proposal.a, proposal.b], joined);
        }
    }

    fn joined(&self, ca: &Component, cb: &Component, proposal: &Proposal) -> Option<Component> {
        let pair = self.pairs.get(proposal.pair)?;
        let Assessment { a_from_b, support } = proposal.assessment;
        // The larger keeps its frame; of equals the one with the lower pivot.
        let first = (ca.members.len(), std::cmp::Reverse(ca.members[0].0))
            >= (cb.members.len(), std::cmp::Reverse(cb.members[0].0));
        let (large, small, large_from_small) =
            if first { (ca, cb, a_from_b) } else { (cb, ca, a_from_b.inverse()) };
        let mut joined = large.clone();
        joined.members.extend(small.members.iter().map(|&(s, pose)| (s, large_from_small * pose)));
        joined.joins.extend(&small.joins);
        let pose = |s: ScanId| joined.members.iter().find(|m| m.0 == s).map(|m| m.1);
        let first_from_second = pose(pair.i)?.inverse() * pose(pair.j)?;
        joined.joins.push(Join { scans: (pair.i, pair.j), first_from_second, support });
        Some(joined)
    }

    fn replace(&mut self, gone: &[ComponentId], with: Component) {
        for id in gone {
            self.components.remove(id);
        }
        let id = self.next;
        self.next += 1;
        self.components.insert(id, with);
        self.replace_links(gone, id);
    }

    /// Links of the components in `gone` become links of `id`.
    fn replace_links(&mut self, gone: &[ComponentId], id: ComponentId) {
        let mut pairs: BTreeMap<ComponentId, Vec<usize>> = BTreeMap::new();
        let old: Vec<(ComponentId, ComponentId)> =
            self.links.keys().copied().filter(|k| gone.contains(&k.0) || gone.contains(&k.1)).collect();
        for key in old {
            let Some(link) = self.links.remove(&key) else { continue };
            let other = if gone.contains(&key.0) { key.1 } else { key.0 };
            if !gone.contains(&other) {
                pairs.entry(other).or_default().extend(link.pairs);
            }
        }
        let made: Vec<((ComponentId, ComponentId), Link)> = pairs
            .into_iter()
            .map(|(other, mut pairs)| {
                pairs.sort_unstable();
                let key = (other.min(id), other.max(id));
                (key, self.link(key, pairs))
            })
            .collect();
        self.links.extend(made);
    }

    /// Pairs of scans of different components that were not registered yet.
    pub fn unseen_pairs(&self) -> Vec<(ScanId, ScanId)> {
        let seen: BTreeSet<(ScanId, ScanId)> = self.pairs.iter().map(|p| (p.i, p.j)).collect();
        let components: Vec<&Component> = self.components.values().collect();
        let mut unseen = Vec::new();
        for (k, a) in components.iter().enumerate() {
            for b in &components[k + 1..] {
                for &(i, _) in &a.members {
                    unseen.extend(b.members.iter().map(|&(j, _)| (i.min(j), i.max(j))));
                }
            }
        }
        unseen.retain(|pair| !seen.contains(pair));
        unseen.sort_unstable();
        unseen
    }
}
