//! Mutual descriptor matches between a scan and a target: another scan, or a meta-shape that grows,
//! with which they are kept up to date by what changed instead of being searched again.

use crate::geometry::Point;
use crate::registration::pairwise::nearest::{Best, Columns, nearest_both};
use crate::scan::Features;

/// Mutual matches between a scan and a target.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Matches {
    /// `(keypoint of the scan, row of the target)`, ordered by keypoint.
    pub pairs: Vec<(u32, u32)>,
    /// Keypoints of the scan, in its frame, one a pair.
    pub source: Vec<Point>,
    /// Their counterparts, in the target's frame, one a pair.
    pub target: Vec<Point>,
    /// How near the descriptors are, one a pair: x·y − ½‖y‖², greater is nearer.
    pub scores: Vec<f32>,
}

impl Matches {
    /// Number of matches.
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// True when there is none.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// The `at_most` matches whose descriptors are nearest, in their original order.
    pub fn nearest_in_descriptor_space(&self, at_most: usize) -> Vec<usize> {
        let mut chosen: Vec<usize> = (0..self.len()).collect();
        if chosen.len() > at_most {
            chosen.sort_by(|&a, &b| self.scores[b].total_cmp(&self.scores[a]).then(a.cmp(&b)));
            chosen.truncate(at_most);
            chosen.sort_unstable();
        }
        chosen
    }
}

/// What a scan is matched with: the keypoints and descriptors of another scan or of a meta-shape.
#[derive(Debug, Clone, Copy)]
pub struct MatchTarget<'a> {
    /// Keypoints `[n,3]`, metres, in the frame of the target.
    pub points: &'a [Point],
    /// Descriptors, row-major `[n·D]`.
    pub descriptors: &'a [f32],
    /// Version of the target; it rises whenever a row changes.
    pub version: u32,
    /// Version at which each row last changed; `None` where all are of the first.
    pub changed: Option<&'a [u32]>,
}

impl<'a> MatchTarget<'a> {
    /// A scan.
    pub fn of_scan(features: &'a Features) -> Self {
        Self {
            points: &features.keypoints,
            descriptors: features.descriptors.values(),
            version: 1,
            changed: None,
        }
    }

    fn changed_at(&self, row: usize) -> u32 {
        self.changed.map_or(1, |changed| changed[row])
    }
}

/// Nearest neighbours between one scan and the target, as of some version of the latter.
///
/// Exact: after [`NearestCache::update`] it holds what a search from scratch would find.
#[derive(Debug, Clone)]
pub struct NearestCache {
    columns: Columns,
    /// Version of the target that the answers are about.
    version: u32,
    /// For every row of the target, the nearest keypoint of the scan.
    of_rows: Vec<Best>,
    /// For every keypoint of the scan, the nearest row of the target.
    of_keypoints: Vec<Best>,
}

impl NearestCache {
    /// An empty cache for a scan with these descriptors.
    pub fn new(columns: Columns) -> Self {
        let of_keypoints = vec![Best::NONE; columns.len()];
        Self { columns, version: 0, of_rows: Vec::new(), of_keypoints }
    }

    /// Brings the answers up to the present state of `target`.
    ///
    /// Rows whose descriptor is new are compared with every keypoint. A keypoint whose
    /// nearest row was replaced may now be nearest to any row, so only those keypoints
    /// are searched again.
    pub fn update(&mut self, target: &MatchTarget<'_>) {
        let changed: Vec<u32> = (0..target.points.len() as u32)
            .filter(|&row| target.changed_at(row as usize) > self.version)
            .collect();
        let lost: Vec<usize> = (0..self.of_keypoints.len())
            .filter(|&k| {
                let row = self.of_keypoints[k].index;
                row != u32::MAX && target.changed_at(row as usize) > self.version
            })
            .collect();
        let new = nearest_both(target.descriptors, &changed, &self.columns);
        self.of_rows.resize(target.points.len(), Best::NONE);
        for (&row, best) in changed.iter().zip(new.of_rows) {
            self.of_rows[row as usize] = best;
        }
        for (best, candidate) in self.of_keypoints.iter_mut().zip(new.of_columns) {
            *best = best.or(candidate);
        }
        self.search_again(&lost, target);
        self.version = target.version;
    }

    /// Searches all rows for the keypoints in `lost`.
    fn search_again(&mut self, lost: &[usize], target: &MatchTarget<'_>) {
        if lost.is_empty() {
            return;
        }
        let all: Vec<u32> = (0..target.points.len() as u32).collect();
        let found = nearest_both(target.descriptors, &all, &self.columns.select(lost));
        for (&k, best) in lost.iter().zip(found.of_columns) {
            self.of_keypoints[k] = best;
        }
    }

    /// Pairs that are each other's nearest, with their positions.
    pub fn mutual(&self, keypoints: &[Point], target: &MatchTarget<'_>) -> Matches {
        let mut matches = Matches::default();
        for (k, best) in self.of_keypoints.iter().enumerate() {
            if best.index != u32::MAX && self.of_rows[best.index as usize].index == k as u32 {
                matches.pairs.push((k as u32, best.index));
                matches.source.push(keypoints[k]);
                matches.target.push(target.points[best.index as usize]);
                matches.scores.push(best.score);
            }
        }
        matches
    }
}
