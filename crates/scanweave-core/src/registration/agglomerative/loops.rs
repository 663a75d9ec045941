//! Loops of a component that no registered pair closes yet.
//!
//! Scans that hang together by a long way round may see the same place, and drift shows where they meet
//! again. The pairs that were retrieved first need not be among these: they are registered when the poses
//! tell which scans meet.

use super::agglomeration::{Agglomeration, Component};
use crate::scan::{ScanId, SimilarityMatrix};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Agreeing pairs between two scans from which a pair of theirs closes a loop: with fewer the two are
/// neighbours of a neighbour, and what adds up between them is as little.
const LONG_WAY: usize = 3;
/// New pairs a scan at most.
const PARTNERS: usize = 2;

impl Agglomeration<'_> {
    /// Pairs of scans of one component that are not registered with each other, may see the same at their
    /// poses, and are connected by a long way round only: the most similar ones of every scan, ordered.
    pub fn open_loops(&self, similarity: &SimilarityMatrix) -> Vec<(ScanId, ScanId)> {
        let seen: BTreeSet<(ScanId, ScanId)> = self.pairs.iter().map(|p| (p.i, p.j)).collect();
        let open: BTreeSet<(ScanId, ScanId)> = self
            .components
            .values()
            .filter(|c| c.members.len() > LONG_WAY)
            .flat_map(|component| self.open_loops_of(component, similarity, &seen))
            .collect();
        open.into_iter().collect()
    }

    fn open_loops_of(
        &self,
        component: &Component,
        similarity: &SimilarityMatrix,
        seen: &BTreeSet<(ScanId, ScanId)>,
    ) -> Vec<(ScanId, ScanId)> {
        let mut neighbours: BTreeMap<ScanId, Vec<ScanId>> = BTreeMap::new();
        for edge in self.edges_within(component) {
            neighbours.entry(edge.scans.0).or_default().push(edge.scans.1);
            neighbours.entry(edge.scans.1).or_default().push(edge.scans.0);
        }
        let models = self.verifier.models;
        let sphere = |&(scan, pose): &(ScanId, crate::geometry::RigidMotion)| {
            let model = &models[scan.0];
            (scan, pose * model.centre.cast::<f64>(), f64::from(model.reach_m))
        };
        let spheres: Vec<_> = component.members.iter().map(sphere).collect();
        spheres
            .par_iter()
            .flat_map_iter(|&(scan, centre, reach_m)| {
                let near = within(&neighbours, scan, LONG_WAY - 1);
                let mut far: Vec<ScanId> = spheres
                    .iter()
                    .filter(|s| (s.1 - centre).norm() < s.2.min(reach_m))
                    .map(|s| s.0)
                    .filter(|&s| !near.contains(&s) && !seen.contains(&(scan.min(s), scan.max(s))))
                    .collect();
                let like = |s: &ScanId| similarity.get(scan.0, s.0);
                far.sort_by(|a, b| like(b).total_cmp(&like(a)).then(a.cmp(b)));
                far.truncate(PARTNERS);
                far.into_iter().map(move |s| (scan.min(s), scan.max(s)))
            })
            .collect()
    }

    /// Has the components of these pairs refined anew.
    pub(super) fn unsettle(&mut self, pairs: &[(ScanId, ScanId)]) {
        let moved: BTreeSet<ScanId> = pairs.iter().flat_map(|p| [p.0, p.1]).collect();
        let components = &self.components;
        self.settled.retain(|id| !components[id].members.iter().any(|m| moved.contains(&m.0)));
    }
}

/// Scans that so many edges or fewer lead to, the scan itself among them.
fn within(neighbours: &BTreeMap<ScanId, Vec<ScanId>>, from: ScanId, edges: usize) -> BTreeSet<ScanId> {
    let mut found = BTreeSet::from([from]);
    let mut queue = VecDeque::from([(from, 0)]);
    while let Some((scan, away)) = queue.pop_front() {
        if away == edges {
            continue;
        }
        for &next in neighbours.get(&scan).into_iter().flatten() {
            if found.insert(next) {
                queue.push_back((next, away + 1));
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Direction, Point, RigidMotion};
    use crate::registration::agglomerative::Join;
    use crate::registration::config::{RegistrationConfig, SurfaceVerification};
    use crate::registration::scan_model::ScanModel;
    use crate::registration::verification::verifier::Verifier;
    use crate::scan::{Evidence, Surface};

    /// Eight scans once around a square block, each joined to the next; the last sees the first again.
    #[test]
    fn the_ends_of_a_way_around_a_block_are_compared_and_neighbours_are_not() {
        let points = vec![Point::new(-3.0, 0.0, 0.0), Point::new(3.0, 0.0, 0.0)];
        let surface = Surface { normals: vec![Direction::z(); 2], points, ..Surface::default() };
        let settings = SurfaceVerification::default();
        let config = RegistrationConfig::default();
        let models: Vec<ScanModel<'_>> =
            (0..8).map(|_| ScanModel::with_sizes(&surface, 0.07, 2, 0.14)).collect();
        let verifier = Verifier::new(&models, &settings, 0.07);
        let mut agglomeration = Agglomeration::new(&verifier, &config, vec![&[]; 8], &[]);
        // Ten metres on between scans, of which each reaches three; the last comes back to within two of
        // the first.
        let corners =
            [(0., 0.), (10., 0.), (20., 0.), (20., 10.), (20., 20.), (10., 20.), (0., 20.), (0., 2.)];
        let members: Vec<(ScanId, RigidMotion)> = corners
            .iter()
            .enumerate()
            .map(|(k, &(x, y))| (ScanId(k), RigidMotion::translation(x, y, 0.0)))
            .collect();
        let join = |k: usize| Join {
            scans: (ScanId(k), ScanId(k + 1)),
            first_from_second: members[k].1.inverse() * members[k + 1].1,
            evidence: Evidence { probability: Some(0.99), ..Evidence::default() },
        };
        let component =
            Component { joins: (0..7).map(join).collect(), members: members.clone(), refined_at: 8 };
        agglomeration.components.insert(0, component);
        let similarity = SimilarityMatrix::new(8, vec![0.5; 64]).unwrap();
        assert_eq!(agglomeration.open_loops(&similarity), [(ScanId(0), ScanId(7))]);
    }

    #[test]
    fn a_chain_leads_one_scan_further_an_edge() {
        let chain: BTreeMap<ScanId, Vec<ScanId>> = (0..6usize)
            .map(|k| (ScanId(k), [k.checked_sub(1), Some(k + 1)].into_iter().flatten().map(ScanId).collect()))
            .collect();
        let found = |edges| within(&chain, ScanId(1), edges).into_iter().map(|s| s.0).collect::<Vec<_>>();
        assert_eq!(found(0), [1]);
        assert_eq!(found(2), [0, 1, 2, 3]);
    }
}
