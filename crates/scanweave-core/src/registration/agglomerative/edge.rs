//! What registered pairs of scans say of the relative pose of two components.

use crate::registration::verification::verifier::Assessment;
use crate::geometry::rigid::same_motion;
use super::trial::WORTH_TRYING;
use super::agglomeration::{Assembly, Component, ComponentId};
use crate::geometry::RigidMotion;
use crate::scan::{ScanId, SimilarityMatrix};
use nalgebra::Point3;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

/// Clusters of pairwise hypotheses of two components that are assessed.
const CLUSTERS: usize = 8;
/// Scans of other components that a scan is compared with in a further look.
const LOOKED_AT: usize = 40;

/// What is known about two components' relative pose.
#[derive(Debug, Clone)]
pub(super) struct Link {
    /// Pairs of scans with one in either component.
    pub(super) pairs: Vec<usize>,
    /// Distinct proposals `a_from_b` with the pair that speaks for each most, best first.
    pub(super) proposals: Vec<(RigidMotion, usize)>,
    /// How probable the best proposal is if pairs were independent witnesses.
    pub(super) promise: f64,
    /// Evidence for proposals, most probable first, and the pair that speaks for each; once measured.
    pub(super) assessed: Option<Vec<(Assessment, usize)>>,
    /// Whether its trials failed, on the evidence that there is.
    pub(super) tried: bool,
}

impl Link {
    /// The most probable proposal, where it was measured.
    pub(super) fn best(&self) -> Option<(Assessment, usize)> {
        self.assessed.as_ref()?.first().copied()
    }

    /// The same with the two components exchanged.
    pub(super) fn turned(mut self) -> Self {
        self.proposals.iter_mut().for_each(|p| p.0 = p.0.inverse());
        self.assessed.iter_mut().flatten().for_each(|a| a.0.a_from_b = a.0.a_from_b.inverse());
        self
    }
}

impl Assembly<'_> {
    /// Links between all components; those whose pairs are the same as before stay.
    pub(super) fn relink(&mut self) {
        let home: BTreeMap<ScanId, ComponentId> =
            self.components.iter().flat_map(|(&id, c)| c.members.iter().map(move |m| (m.0, id))).collect();
        let mut between: BTreeMap<(ComponentId, ComponentId), Vec<usize>> = BTreeMap::new();
        for (p, pair) in self.pairs.iter().enumerate() {
            let (Some(&a), Some(&b)) = (home.get(&pair.i), home.get(&pair.j)) else { continue };
            if a != b && !pair.hypotheses.is_empty() {
                between.entry((a.min(b), a.max(b))).or_default().push(p);
            }
        }
        let mut old = std::mem::take(&mut self.links);
        let made = between.into_iter().map(|(key, pairs)| match old.remove(&key) {
            Some(link) if link.pairs == pairs => (key, link),
            _ => (key, self.link(key, pairs)),
        });
        self.links = made.collect();
    }

    /// Clusters what the pairs between two components say of their relative pose.
    pub(super) fn link(&self, (a, b): (ComponentId, ComponentId), pairs: Vec<usize>) -> Link {
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
            tried: false,
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

    /// Links of the components in `gone` become links of `id`, in which the component `kept` has kept its
    /// frame and its poses, if one has. What is known of a link of that one stays where the newcomers
    /// have nothing to say to it: evidence that cannot have changed is not measured again.
    pub(super) fn replace_links(
        &mut self,
        gone: &[ComponentId],
        id: ComponentId,
        kept: Option<(ComponentId, &[(ScanId, RigidMotion)])>,
    ) {
        let keys: Vec<(ComponentId, ComponentId)> =
            self.links.keys().copied().filter(|k| gone.contains(&k.0) || gone.contains(&k.1)).collect();
        let mut old: BTreeMap<ComponentId, Vec<(ComponentId, Link)>> = BTreeMap::new();
        for key in keys {
            let Some(link) = self.links.remove(&key) else { continue };
            let (side, other) = if gone.contains(&key.0) { key } else { (key.1, key.0) };
            if !gone.contains(&other) {
                // As seen from the other component, which has the lower number: new ones count up.
                old.entry(other).or_default().push((side, if side < other { link.turned() } else { link }));
            }
        }
        let old: Vec<(ComponentId, Vec<(ComponentId, Link)>)> = old.into_iter().collect();
        let made: Vec<((ComponentId, ComponentId), Link)> = old
            .into_par_iter()
            .map(|(other, mut links)| {
                let key = (other.min(id), other.max(id));
                if let ([(side, link)], Some((kept, newcomers)), true) = (&links[..], kept, other < id)
                    && *side == kept
                    && self.stands(link, newcomers, other)
                {
                    return (key, links.remove(0).1);
                }
                let mut pairs: Vec<usize> = links.into_iter().flat_map(|l| l.1.pairs).collect();
                pairs.sort_unstable();
                (key, self.link(key, pairs))
            })
            .collect();
        self.links.extend(made);
    }

    /// Measures links of a component anew where scans of it, given with their former and their new poses,
    /// have something to say to them; a trial that failed is not repeated for that.
    pub(super) fn renew_links(&mut self, id: ComponentId, changed: &[(ScanId, RigidMotion)]) {
        let touched = self.touched_links(id, changed);
        let renewed: Vec<((ComponentId, ComponentId), Link)> = touched
            .into_par_iter()
            .map(|key| {
                let Link { pairs, tried, .. } = &self.links[&key];
                (key, Link { tried: *tried, ..self.link(key, pairs.clone()) })
            })
            .collect();
        self.links.extend(renewed);
    }

    /// Links of a component that scans of it, given with their poses in its frame, have something to say
    /// to: by matches of theirs, or by surfaces where these count.
    pub(super) fn touched_links(
        &self,
        id: ComponentId,
        changed: &[(ScanId, RigidMotion)],
    ) -> Vec<(ComponentId, ComponentId)> {
        let scans: BTreeSet<ScanId> = changed.iter().map(|c| c.0).collect();
        let links: Vec<_> = self.links.iter().filter(|(key, _)| key.0 == id || key.1 == id).collect();
        let touched = links.into_par_iter().filter(|&(&(a, b), link)| {
            let speaks = |&p: &usize| scans.contains(&self.pairs[p].i) || scans.contains(&self.pairs[p].j);
            link.pairs.iter().any(speaks)
                || !if b == id {
                    self.stands(link, changed, a)
                } else {
                    self.stands(&link.clone().turned(), changed, b)
                }
        });
        touched.map(|(key, _)| *key).collect()
    }

    /// Whether what is known of a link stands although surfaces of its second component come, go or move:
    /// `scans`, without matches for it, at poses in that component's frame. `first` is the other one.
    pub(super) fn stands(&self, link: &Link, scans: &[(ScanId, RigidMotion)], first: ComponentId) -> bool {
        self.is_hopeless(link) || !self.reach_any(scans, first, link)
    }

    /// Whether no proposal of a link is even worth a trial, rivals apart: surfaces of a few more scans
    /// will not change that, while further matches or refined poses might.
    pub(super) fn is_hopeless(&self, link: &Link) -> bool {
        let mut assessed = link.assessed.iter().flatten();
        link.assessed.is_some() && assessed.all(|found| self.unrivalled(&found.0.support) < WORTH_TRYING)
    }

    /// Whether scans come near those of the component `a` at any pose that a link proposes for it, in the
    /// frame of the link's second component.
    pub(super) fn reach_any(&self, scans: &[(ScanId, RigidMotion)], a: ComponentId, link: &Link) -> bool {
        let spheres = |members: &[(ScanId, RigidMotion)], frame: &RigidMotion| -> Vec<(Point3<f64>, f64)> {
            let models = self.assessor.models;
            let of = |&(s, pose): &(ScanId, RigidMotion)| {
                (frame * (pose * models[s.0].centre.cast::<f64>()), f64::from(models[s.0].reach_m))
            };
            members.iter().map(of).collect()
        };
        let scans = spheres(scans, &RigidMotion::identity());
        let assessed = link.assessed.iter().flatten().map(|found| found.0.a_from_b);
        link.proposals.iter().map(|p| p.0).chain(assessed).any(|a_from_b| {
            let others = spheres(&self.components[&a].members, &a_from_b.inverse());
            let radius_m = self.assessor.radius_m;
            scans.iter().any(|(c, r)| others.iter().any(|(d, s)| (c - d).norm() <= r + s + radius_m))
        })
    }

    /// Pairs of scans of different components that were not registered yet: for every scan outside the
    /// largest component up to forty of the most similar ones, all scans as many, so that there are no
    /// more of these pairs than were registered before.
    pub fn unseen_pairs(&self, similarity: &SimilarityMatrix) -> Vec<(ScanId, ScanId)> {
        let seen: BTreeSet<(ScanId, ScanId)> = self.pairs.iter().map(|p| (p.i, p.j)).collect();
        let ordered = |i: ScanId, j: ScanId| (i.min(j), i.max(j));
        let home: BTreeMap<ScanId, ComponentId> =
            self.components.iter().flat_map(|(&id, c)| c.members.iter().map(move |m| (m.0, id))).collect();
        let largest = self.components.iter().max_by_key(|(id, c)| (c.members.len(), Reverse(**id)));
        let largest = largest.map(|(&id, _)| id);
        // Every pair with the better of its ranks among those of its two scans.
        let mut rank: BTreeMap<(ScanId, ScanId), usize> = BTreeMap::new();
        for (&i, &of_i) in home.iter().filter(|&(_, &of_i)| Some(of_i) != largest) {
            let others = home.iter().filter(|&(_, &of_j)| of_j != of_i).map(|(&j, _)| j);
            let mut others: Vec<ScanId> = others.filter(|&j| !seen.contains(&ordered(i, j))).collect();
            let like = |j: &ScanId| similarity.get(i.0, j.0);
            others.sort_by(|a, b| like(b).total_cmp(&like(a)).then(a.cmp(b)));
            for (r, j) in others.into_iter().take(LOOKED_AT).enumerate() {
                rank.entry(ordered(i, j)).and_modify(|known| *known = r.min(*known)).or_insert(r);
            }
        }
        let mut ranks: Vec<usize> = rank.values().copied().collect();
        ranks.sort_unstable();
        // Where a rank does not fit as a whole it is left out, and all after it.
        let first_left_out = ranks.get(self.pairs.len()).copied().unwrap_or(LOOKED_AT);
        rank.into_iter().filter(|r| r.1 < first_left_out).map(|r| r.0).collect()
    }
}
