//! The network of scans and the pairs that touch.

use crate::result::{Document, EntryOutcome, Pose};
use crate::scan::ScanEdge;
use std::collections::{BTreeMap, BTreeSet};

/// Two placed scans of one component that touch, or of which one is the parent of the other.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Pair {
    /// The scans, the lower number first.
    pub scans: (usize, usize),
    pub component: usize,
    /// How they touch; none where they do not.
    pub touch: Option<Touch>,
    /// Whether one is the parent of the other.
    pub parent: bool,
}

/// How two scans touch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Touch {
    /// Two-way, in `[0, 1]`.
    pub overlap: f64,
    /// Median distance of their surfaces, metres; none where too little of them touches.
    pub distance_m: Option<f64>,
}

impl Pair {
    /// The overlap, 0 where the scans do not touch.
    pub fn overlap(&self) -> f64 {
        self.touch.map_or(0.0, |t| t.overlap)
    }

    /// Median distance of the surfaces, metres.
    pub fn distance_m(&self) -> Option<f64> {
        self.touch?.distance_m
    }
}

/// All placed scans and all pairs.
pub(super) struct Network<'a> {
    /// Pose of every scan; none for those declined.
    pub poses: Vec<Option<&'a Pose>>,
    /// Ordered by scans.
    pub pairs: Vec<Pair>,
    /// How many others every scan touches.
    pub touching: Vec<usize>,
}

/// What one component's pairs come to.
pub(super) struct Figures<'a> {
    /// Pairs that touch.
    pub touching: Vec<&'a Pair>,
    /// Touching pairs that close a loop.
    pub loops: usize,
    /// Scans that touch one other or none.
    pub single: Vec<usize>,
    /// Of the distances of touching pairs.
    pub median_m: Option<f64>,
    /// The pair of the largest distance.
    pub largest: Option<&'a Pair>,
    /// The parent edge of the least overlap.
    pub least: Option<&'a Pair>,
    /// The least certain of the scans' weakest edges.
    pub weakest: Option<ScanEdge>,
}

impl<'a> Network<'a> {
    pub fn new(document: &'a Document) -> Self {
        let poses: Vec<Option<&Pose>> = document
            .scans
            .iter()
            .map(|entry| match &entry.outcome {
                EntryOutcome::Placed(pose) => Some(pose.as_ref()),
                EntryOutcome::Declined { .. } => None,
            })
            .collect();
        let mut pairs: BTreeMap<(usize, usize), Pair> = BTreeMap::new();
        for (scan, pose) in poses.iter().enumerate().filter_map(|(i, p)| p.map(|p| (i, p))) {
            // Numbers come from a file and may name no scan, or one of another component.
            let component = pose.component;
            let related = |other: usize| {
                scan != other && poses.get(other).copied().flatten().is_some_and(|o| o.component == component)
            };
            let near = pose.neighbours.iter().map(|n| {
                let touch = Touch { overlap: n.overlap, distance_m: n.plane_distance_m };
                (n.scan.0, Some(touch), false)
            });
            let parent = pose.parent.map(|p| (p, None, true));
            for (other, touch, parent) in near.chain(parent).filter(|p| related(p.0)) {
                let scans = (scan.min(other), scan.max(other));
                let new = Pair { scans, component, touch: None, parent: false };
                let pair = pairs.entry(scans).or_insert(new);
                pair.touch = pair.touch.or(touch);
                pair.parent |= parent;
            }
        }
        let pairs: Vec<Pair> = pairs.into_values().collect();
        let mut touching = vec![0; poses.len()];
        for pair in pairs.iter().filter(|p| p.touch.is_some()) {
            touching[pair.scans.0] += 1;
            touching[pair.scans.1] += 1;
        }
        Self { poses, pairs, touching }
    }

    /// The largest overlap of a scan with another, and the median over its pairs of the distance of surfaces,
    /// metres; none where there is none.
    pub fn agreement(&self, scan: usize) -> (Option<f64>, Option<f64>) {
        let pairs = || self.pairs.iter().filter(|p| p.scans.0 == scan || p.scans.1 == scan);
        let overlap = pairs().filter_map(|p| p.touch.map(|t| t.overlap)).max_by(f64::total_cmp);
        let mut distances: Vec<f64> = pairs().filter_map(Pair::distance_m).collect();
        distances.sort_by(f64::total_cmp);
        (overlap, median(&distances))
    }

    /// The figures of a component.
    pub fn figures(&self, component: usize) -> Figures<'_> {
        let members = || self.poses.iter().enumerate().filter_map(|(i, p)| p.map(|p| (i, p)));
        let members = || members().filter(|(_, p)| p.component == component);
        let pairs = || self.pairs.iter().filter(|p| p.component == component);
        let touching: Vec<&Pair> = pairs().filter(|p| p.touch.is_some()).collect();
        let mut distances: Vec<f64> = touching.iter().filter_map(|p| p.distance_m()).collect();
        distances.sort_by(f64::total_cmp);
        let weakest = members().filter_map(|(_, p)| p.pose_uncertainty.as_ref()?.weakest_edge);
        let further = |a: &&Pair, b: &&Pair| {
            let of = |p: &Pair| p.distance_m().unwrap_or(0.0);
            of(a).total_cmp(&of(b))
        };
        Figures {
            loops: loops(&touching),
            single: members().map(|m| m.0).filter(|&s| self.touching[s] < 2).collect(),
            median_m: median(&distances),
            largest: touching.iter().copied().filter(|p| p.distance_m().is_some()).max_by(further),
            least: pairs().filter(|p| p.parent).min_by(|a, b| a.overlap().total_cmp(&b.overlap())),
            weakest: weakest.min_by(|a, b| a.probability.total_cmp(&b.probability)),
            touching,
        }
    }

    /// The pairs that are listed, in the order in which they are: all by scans where they are `most` at
    /// most, else the `weakest`, parent edges before others and each by overlap.
    pub fn listed(&self, most: usize, weakest: usize) -> Vec<&Pair> {
        let mut all: Vec<&Pair> = self.pairs.iter().collect();
        if all.len() > most {
            all.sort_by(|a, b| b.parent.cmp(&a.parent).then(a.overlap().total_cmp(&b.overlap())));
            all.truncate(weakest);
        }
        all
    }
}

/// Of sorted values; the mean of the two in the middle where their number is even.
fn median(sorted: &[f64]) -> Option<f64> {
    let upper = sorted.get(sorted.len() / 2)?;
    let lower = sorted.get(sorted.len().saturating_sub(1) / 2)?;
    Some(0.5 * (lower + upper))
}

/// How many of the pairs close a loop: those that join what others before them have joined.
fn loops(pairs: &[&Pair]) -> usize {
    let scans: BTreeSet<usize> = pairs.iter().flat_map(|p| [p.scans.0, p.scans.1]).collect();
    let mut above: BTreeMap<usize, usize> = scans.into_iter().map(|s| (s, s)).collect();
    let mut closing = 0;
    for pair in pairs {
        let (a, b) = (root(&mut above, pair.scans.0), root(&mut above, pair.scans.1));
        if a == b {
            closing += 1;
        } else {
            above.insert(b, a);
        }
    }
    closing
}

/// The scan that stands for all that are joined with a scan.
fn root(above: &mut BTreeMap<usize, usize>, scan: usize) -> usize {
    let mut at = scan;
    while let Some(&next) = above.get(&at).filter(|&&next| next != at) {
        // Shorter ways for the next search.
        let further = above.get(&next).copied().unwrap_or(next);
        above.insert(at, further);
        at = next;
    }
    at
}
