//! What registered pairs of scans say of the relative pose of two components.

use super::agglomeration::{Agglomeration, Component, ComponentId};
use super::pairs::most_similar;
use super::trial::WORTH_TRYING;
use crate::geometry::RigidMotion;
use crate::geometry::rigid::same_motion;
use crate::registration::verification::verifier::ScoredHypothesis;
use crate::scan::{ScanId, SimilarityMatrix};
use nalgebra::Point3;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

/// Clusters of pairwise hypotheses of two components that are scored.
const CLUSTERS: usize = 8;
/// Scans of other components that a scan is compared with in a retrieval round.
const ROUND_PARTNERS: usize = 40;

/// What is known about two components' relative pose.
#[derive(Debug, Clone)]
pub(super) struct ComponentEdge {
    /// Pairs of scans with one in either component.
    pub(super) pairs: Vec<usize>,
    /// Distinct proposals `a_from_b` with the pair that speaks for each most, best first.
    pub(super) proposals: Vec<(RigidMotion, usize)>,
    /// How probable the best proposal is if pairs were independent.
    pub(super) prior_score: f64,
    /// Evidence for proposals, most probable first, and the pair that speaks for each; once measured.
    pub(super) scored: Option<Vec<(ScoredHypothesis, usize)>>,
    /// Whether its trials failed, on the evidence that there is.
    pub(super) tried: bool,
}

impl ComponentEdge {
    /// The most probable proposal, where it was measured.
    pub(super) fn best(&self) -> Option<(ScoredHypothesis, usize)> {
        self.scored.as_ref()?.first().copied()
    }

    /// The same with the two components exchanged.
    pub(super) fn turned(mut self) -> Self {
        self.proposals.iter_mut().for_each(|p| p.0 = p.0.inverse());
        self.scored.iter_mut().flatten().for_each(|a| a.0 = a.0.turned());
        self
    }
}

impl Agglomeration<'_> {
    /// Edges between all components; those whose pairs are the same as before stay.
    pub(super) fn rebuild_edges(&mut self) {
        let home: BTreeMap<ScanId, ComponentId> =
            self.components.iter().flat_map(|(&id, c)| c.members.iter().map(move |m| (m.0, id))).collect();
        let mut between: BTreeMap<(ComponentId, ComponentId), Vec<usize>> = BTreeMap::new();
        for (p, pair) in self.pairs.iter().enumerate() {
            let (Some(&a), Some(&b)) = (home.get(&pair.i), home.get(&pair.j)) else { continue };
            if a != b && !pair.hypotheses.is_empty() {
                between.entry((a.min(b), a.max(b))).or_default().push(p);
            }
        }
        let mut old = std::mem::take(&mut self.edges);
        let known: Vec<_> = between
            .into_iter()
            .map(|(key, pairs)| (key, old.remove(&key).filter(|edge| edge.pairs == pairs), pairs))
            .collect();
        let made = known
            .into_par_iter()
            .map(|(key, known, pairs)| (key, known.unwrap_or_else(|| self.edge(key, pairs))));
        self.edges = made.collect();
    }

    /// Clusters what the pairs between two components say of their relative pose.
    pub(super) fn edge(&self, (a, b): (ComponentId, ComponentId), pairs: Vec<usize>) -> ComponentEdge {
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
            let model = &self.verifier.models[of_b.0];
            let at = of(cb, of_b).map_or(model.centre.cast(), |pose| pose * model.centre.cast::<f64>());
            // One pair is one vote, however many of its hypotheses agree.
            let mut voters: BTreeMap<usize, f64> = BTreeMap::new();
            for (w, other) in votes.iter().enumerate().skip(v) {
                if free[w] && same_motion(&motion, &other.0, &at, self.verifier.radius_m) {
                    free[w] = false;
                    let best = voters.entry(other.2).or_default();
                    *best = best.max(other.1);
                }
            }
            let doubt: f64 = voters.values().map(|p| (1.0 - p).ln()).sum();
            clusters.push((motion, pair, -doubt));
        }
        clusters.sort_by(|x, y| y.2.total_cmp(&x.2));
        clusters.truncate(CLUSTERS);
        let prior_score = clusters.first().map_or(0.0, |c| c.2);
        let mut edge = ComponentEdge {
            pairs,
            proposals: clusters.into_iter().map(|(motion, pair, _)| (motion, pair)).collect(),
            prior_score,
            scored: None,
            tried: false,
        };
        if let ([only], 1, 1) = (edge.pairs.as_slice(), ca.members.len(), cb.members.len()) {
            // Two scans alone: the evidence between them is what their registration found.
            let pair = &self.pairs[*only];
            let i_in_a = of(ca, pair.i).is_some();
            let turned = pair.hypotheses.iter().map(|h| (if i_in_a { *h } else { h.turned() }, *only));
            edge.scored = Some(turned.collect());
        }
        edge
    }

    /// Edges of the components in `gone` become edges of `id`, in which the component `kept` has kept its
    /// frame and its poses, if one has. What is known of an edge of that one stays where the newcomers
    /// have nothing to say to it: evidence that cannot have changed is not measured again.
    pub(super) fn replace_edges(
        &mut self,
        gone: &[ComponentId],
        id: ComponentId,
        kept: Option<(ComponentId, &[(ScanId, RigidMotion)])>,
    ) {
        let keys: Vec<(ComponentId, ComponentId)> =
            self.edges.keys().copied().filter(|k| gone.contains(&k.0) || gone.contains(&k.1)).collect();
        let mut old: BTreeMap<ComponentId, Vec<(ComponentId, ComponentEdge)>> = BTreeMap::new();
        for key in keys {
            let Some(edge) = self.edges.remove(&key) else { continue };
            let (side, other) = if gone.contains(&key.0) { key } else { (key.1, key.0) };
            if !gone.contains(&other) {
                // As seen from the other component, which has the lower number: new ones count up.
                old.entry(other).or_default().push((side, if side < other { edge.turned() } else { edge }));
            }
        }
        let old: Vec<(ComponentId, Vec<(ComponentId, ComponentEdge)>)> = old.into_iter().collect();
        let made: Vec<((ComponentId, ComponentId), ComponentEdge)> = old
            .into_par_iter()
            .map(|(other, mut edges)| {
                let key = (other.min(id), other.max(id));
                if let ([(side, edge)], Some((kept, newcomers)), true) = (&edges[..], kept, other < id)
                    && *side == kept
                    && self.stands(edge, newcomers, other)
                {
                    return (key, edges.remove(0).1);
                }
                let mut pairs: Vec<usize> = edges.into_iter().flat_map(|l| l.1.pairs).collect();
                pairs.sort_unstable();
                (key, self.edge(key, pairs))
            })
            .collect();
        self.edges.extend(made);
    }

    /// Measures edges of a component anew where scans of it, given with their former and their new poses,
    /// have something to say to them; a trial that failed is not repeated for that.
    pub(super) fn rescore_edges(&mut self, id: ComponentId, changed: &[(ScanId, RigidMotion)]) {
        let touched = self.touched_edges(id, changed);
        let renewed: Vec<((ComponentId, ComponentId), ComponentEdge)> = touched
            .into_par_iter()
            .map(|key| {
                let ComponentEdge { pairs, tried, .. } = &self.edges[&key];
                (key, ComponentEdge { tried: *tried, ..self.edge(key, pairs.clone()) })
            })
            .collect();
        self.edges.extend(renewed);
    }

    /// Edges of a component that scans of it, given with their poses in its frame, have something to say
    /// to: by matches of theirs, or by surfaces where these count.
    pub(super) fn touched_edges(
        &self,
        id: ComponentId,
        changed: &[(ScanId, RigidMotion)],
    ) -> Vec<(ComponentId, ComponentId)> {
        let scans: BTreeSet<ScanId> = changed.iter().map(|c| c.0).collect();
        let edges: Vec<_> = self.edges.iter().filter(|(key, _)| key.0 == id || key.1 == id).collect();
        let touched = edges.into_par_iter().filter(|&(&(a, b), edge)| {
            let speaks = |&p: &usize| scans.contains(&self.pairs[p].i) || scans.contains(&self.pairs[p].j);
            edge.pairs.iter().any(speaks)
                || !if b == id {
                    self.stands(edge, changed, a)
                } else {
                    self.stands(&edge.clone().turned(), changed, b)
                }
        });
        touched.map(|(key, _)| *key).collect()
    }

    /// Whether what is known of an edge stands although surfaces of its second component come, go or move:
    /// `scans`, without matches for it, at poses in that component's frame. `first` is the other one.
    pub(super) fn stands(
        &self,
        edge: &ComponentEdge,
        scans: &[(ScanId, RigidMotion)],
        first: ComponentId,
    ) -> bool {
        self.is_hopeless(edge) || !self.reach_any(scans, first, edge)
    }

    /// Whether no proposal of an edge is even worth a trial, rivals apart: surfaces of a few more scans
    /// will not change that, while further matches or refined poses might.
    pub(super) fn is_hopeless(&self, edge: &ComponentEdge) -> bool {
        let mut scored = edge.scored.iter().flatten();
        edge.scored.is_some() && scored.all(|found| self.unrivalled(&found.0.evidence) < WORTH_TRYING)
    }

    /// Whether scans come near those of the component `a` at any pose that an edge proposes for it, in the
    /// frame of the edge's second component.
    pub(super) fn reach_any(
        &self,
        scans: &[(ScanId, RigidMotion)],
        a: ComponentId,
        edge: &ComponentEdge,
    ) -> bool {
        let spheres = |members: &[(ScanId, RigidMotion)], frame: &RigidMotion| -> Vec<(Point3<f64>, f64)> {
            let models = self.verifier.models;
            let of = |&(s, pose): &(ScanId, RigidMotion)| {
                (frame * (pose * models[s.0].centre.cast::<f64>()), f64::from(models[s.0].reach_m))
            };
            members.iter().map(of).collect()
        };
        let scans = spheres(scans, &RigidMotion::identity());
        let scored = edge.scored.iter().flatten().map(|found| found.0.a_from_b);
        edge.proposals.iter().map(|p| p.0).chain(scored).any(|a_from_b| {
            let others = spheres(&self.components[&a].members, &a_from_b.inverse());
            let radius_m = self.verifier.radius_m;
            scans.iter().any(|(c, r)| others.iter().any(|(d, s)| (c - d).norm() <= r + s + radius_m))
        })
    }

    /// Pairs of scans of different components that were not registered yet: for every scan outside the
    /// largest component up to forty of the most similar ones, all scans as many, so that there are no
    /// more of these pairs than were registered before.
    pub fn unseen_pairs(&self, similarity: &SimilarityMatrix) -> Vec<(ScanId, ScanId)> {
        let ordered = |i: ScanId, j: ScanId| (i.min(j), i.max(j));
        let home: BTreeMap<ScanId, ComponentId> =
            self.components.iter().flat_map(|(&id, c)| c.members.iter().map(move |m| (m.0, id))).collect();
        let home: Vec<(ScanId, ComponentId)> = home.into_iter().collect();
        let largest = self.components.iter().max_by_key(|(id, c)| (c.members.len(), Reverse(**id)));
        let largest = largest.map(|(&id, _)| id);
        let apart: Vec<(ScanId, ComponentId)> =
            home.iter().copied().filter(|h| Some(h.1) != largest).collect();
        let partners: Vec<(ScanId, Vec<ScanId>)> = apart
            .into_par_iter()
            .map(|(i, of_i)| {
                let seen: BTreeSet<ScanId> = self.pairs_of(i).into_iter().map(|p| p.1).collect();
                let others = home.iter().filter(|&(j, of_j)| *of_j != of_i && !seen.contains(j));
                (i, most_similar(similarity, i, others.map(|h| h.0), ROUND_PARTNERS))
            })
            .collect();
        // Every pair with the better of its ranks among those of its two scans.
        let mut rank: BTreeMap<(ScanId, ScanId), usize> = BTreeMap::new();
        for (i, others) in partners {
            for (r, j) in others.into_iter().enumerate() {
                rank.entry(ordered(i, j)).and_modify(|known| *known = r.min(*known)).or_insert(r);
            }
        }
        let mut ranks: Vec<usize> = rank.values().copied().collect();
        ranks.sort_unstable();
        // Where a rank does not fit as a whole it is left out, and all after it.
        let first_left_out = ranks.get(self.pairs.len()).copied().unwrap_or(ROUND_PARTNERS);
        rank.into_iter().filter(|r| r.1 < first_left_out).map(|r| r.0).collect()
    }
}
