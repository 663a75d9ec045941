//! How firmly scans are held in their components.

use crate::geometry::rigid::same_motion;
use crate::registration::multiview_icp::{JointScan, pose_covariances};
use super::agglomeration::{Assembly, Component};
use crate::scan::{Hold, Link, ScanId};
use std::collections::BTreeMap;

impl Assembly<'_> {
    /// How firmly every scan of a component is held, in the order of its members.
    pub fn holds(&self, component: &Component) -> Vec<Hold> {
        let models = self.assessor.models;
        let scans: Vec<JointScan<'_>> = component
            .members
            .iter()
            .map(|&(scan, world_from_scan)| JointScan { model: &models[scan.0], world_from_scan })
            .collect();
        let covariances = if self.config().joint.enabled && scans.len() > 1 {
            pose_covariances(&scans, &self.config().joint, self.assessor.radius_m)
        } else {
            vec![None; scans.len()]
        };
        let weakest = weakest_links(component.members.iter().map(|m| m.0), &self.links_within(component));
        covariances
            .into_iter()
            .zip(&component.members)
            .map(|(covariance, member)| Hold { weakest_link: weakest.get(&member.0).copied(), covariance })
            .collect()
    }

    /// The joins that made a component, and all pairs whose registration agrees with its poses.
    pub(super) fn links_within(&self, component: &Component) -> Vec<Link> {
        let poses: BTreeMap<ScanId, _> = component.members.iter().copied().collect();
        let joins = component
            .joins
            .iter()
            .map(|join| Link { scans: join.scans, probability: join.support.probability.unwrap_or(0.0) });
        let pairs = self.pairs.iter().filter_map(|pair| {
            let i_from_j = poses.get(&pair.i)?.inverse() * poses.get(&pair.j)?;
            let centre = self.assessor.models[pair.j.0].centre.cast();
            let agrees = |motion| same_motion(motion, &i_from_j, &centre, self.assessor.radius_m);
            let agreeing = pair.hypotheses.iter().find(|h| agrees(&h.a_from_b))?;
            Some(Link { scans: (pair.i, pair.j), probability: agreeing.probability() })
        });
        joins.chain(pairs).collect()
    }
}

/// The weakest link between every scan and the first, along the chain whose weakest link is
/// strongest: links are added strongest first, and the one that first connects a scan is it.
fn weakest_links(scans: impl Iterator<Item = ScanId>, links: &[Link]) -> BTreeMap<ScanId, Link> {
    let mut group: BTreeMap<ScanId, usize> = scans.enumerate().map(|(at, scan)| (scan, at)).collect();
    let mut links: Vec<&Link> = links.iter().collect();
    links.sort_by(|x, y| y.probability.total_cmp(&x.probability).then(x.scans.cmp(&y.scans)));
    let mut weakest = BTreeMap::new();
    for link in links {
        let (Some(&a), Some(&b)) = (group.get(&link.scans.0), group.get(&link.scans.1)) else { continue };
        if a == b {
            continue;
        }
        // The first scan's group keeps number 0.
        let (kept, gone) = (a.min(b), a.max(b));
        for (scan, of) in group.iter_mut().filter(|g| *g.1 == gone) {
            *of = kept;
            if kept == 0 {
                weakest.insert(*scan, *link);
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
        let link = |a: usize, b: usize, probability: f64| Link { scans: (ScanId(a), ScanId(b)), probability };
        let links = [
            link(5, 1, 0.9),
            link(1, 2, 0.6),
            link(5, 2, 0.5),
            link(2, 3, 0.99),
            link(3, 4, 0.3),
            link(5, 4, 0.2),
        ];
        let found = weakest_links([5, 1, 2, 3, 4].map(ScanId).into_iter(), &links);
        let of = |scan: usize| found.get(&ScanId(scan)).map(|l| l.probability);
        assert_eq!([of(5), of(1), of(2), of(3), of(4)], [None, Some(0.9), Some(0.6), Some(0.6), Some(0.3)]);
        // What no link reaches has none.
        assert_eq!(weakest_links([5, 7].map(ScanId).into_iter(), &links), BTreeMap::new());
    }
}
