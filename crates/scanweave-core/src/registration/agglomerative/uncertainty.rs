//! How firmly scans are held in their components.

use super::agglomeration::{Agglomeration, Component};
use crate::geometry::rigid::same_motion;
use crate::registration::multiview_icp::{PosedScan, pose_covariances};
use crate::scan::{PoseUncertainty, ScanEdge, ScanId};
use std::collections::BTreeMap;

impl Agglomeration<'_> {
    /// How firmly every scan of a component is held, in the order of its members.
    pub fn uncertainties(&self, component: &Component) -> Vec<PoseUncertainty> {
        let models = self.verifier.models;
        let scans: Vec<PosedScan<'_>> = component
            .members
            .iter()
            .map(|&(scan, world_from_scan)| PosedScan { model: &models[scan.0], world_from_scan })
            .collect();
        let covariances = if self.multiview_icp.enabled && scans.len() > 1 {
            pose_covariances(&scans, self.multiview_icp, self.verifier.radius_m)
        } else {
            vec![None; scans.len()]
        };
        let weakest = weakest_edges(component.members.iter().map(|m| m.0), &self.edges_within(component));
        covariances
            .into_iter()
            .zip(&component.members)
            .map(|(covariance, member)| PoseUncertainty {
                weakest_edge: weakest.get(&member.0).copied(),
                covariance,
                centre: Some(models[member.0.0].centre.cast()),
            })
            .collect()
    }

    /// The joins that made a component, and all pairs whose registration agrees with its poses.
    pub(super) fn edges_within(&self, component: &Component) -> Vec<ScanEdge> {
        let poses: BTreeMap<ScanId, _> = component.members.iter().copied().collect();
        let joins = component.joins.iter().map(|join| ScanEdge {
            scans: join.scans,
            probability: join.evidence.probability.unwrap_or(0.0),
        });
        let pairs = self.pairs_within(component).into_iter().filter_map(|pair| {
            let i_from_j = poses.get(&pair.i)?.inverse() * poses.get(&pair.j)?;
            let centre = self.verifier.models[pair.j.0].centre.cast();
            let agrees = |motion| same_motion(motion, &i_from_j, &centre, self.verifier.radius_m);
            let agreeing = pair.hypotheses.iter().find(|h| agrees(&h.a_from_b))?;
            Some(ScanEdge { scans: (pair.i, pair.j), probability: agreeing.probability() })
        });
        joins.chain(pairs).collect()
    }
}

/// The weakest edge between every scan and the first, along the chain whose weakest edge is
/// strongest: edges are added strongest first, and the one that first connects a scan is it.
fn weakest_edges(scans: impl Iterator<Item = ScanId>, edges: &[ScanEdge]) -> BTreeMap<ScanId, ScanEdge> {
    let mut group: BTreeMap<ScanId, usize> = scans.enumerate().map(|(at, scan)| (scan, at)).collect();
    let mut edges: Vec<&ScanEdge> = edges.iter().collect();
    edges.sort_by(|x, y| y.probability.total_cmp(&x.probability).then(x.scans.cmp(&y.scans)));
    let mut weakest = BTreeMap::new();
    for edge in edges {
        let (Some(&a), Some(&b)) = (group.get(&edge.scans.0), group.get(&edge.scans.1)) else { continue };
        if a == b {
            continue;
        }
        // The first scan's group keeps number 0.
        let (kept, gone) = (a.min(b), a.max(b));
        for (scan, of) in group.iter_mut().filter(|g| *g.1 == gone) {
            *of = kept;
            if kept == 0 {
                weakest.insert(*scan, *edge);
            }
        }
    }
    weakest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    pub(super) fn a_chain_is_as_strong_as_its_weakest_link_and_the_strongest_chain_counts() {
        // 5 is the pivot. 5–1 .9, 1–2 .6, 5–2 .5, 2–3 .99, 3–4 .3, 5–4 .2
        let edge =
            |a: usize, b: usize, probability: f64| ScanEdge { scans: (ScanId(a), ScanId(b)), probability };
        let edges = [
            edge(5, 1, 0.9),
            edge(1, 2, 0.6),
            edge(5, 2, 0.5),
            edge(2, 3, 0.99),
            edge(3, 4, 0.3),
            edge(5, 4, 0.2),
        ];
        let found = weakest_edges([5, 1, 2, 3, 4].map(ScanId).into_iter(), &edges);
        let of = |scan: usize| found.get(&ScanId(scan)).map(|l| l.probability);
        assert_eq!([of(5), of(1), of(2), of(3), of(4)], [None, Some(0.9), Some(0.6), Some(0.6), Some(0.3)]);
        // What no edge reaches has none.
        assert_eq!(weakest_edges([5, 7].map(ScanId).into_iter(), &edges), BTreeMap::new());
    }
}
