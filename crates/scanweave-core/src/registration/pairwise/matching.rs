//! Mutual descriptor matches between a candidate scan and the growing meta-shape,
//! kept up to date by what changed instead of being searched again.

use crate::registration::incremental::meta_shape::MetaShape;
use crate::registration::pairwise::nearest::{Best, Columns, nearest_both};
use crate::geometry::Point;

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

/// Nearest neighbours between one scan and the meta-shape, as of some version of the latter.
///
/// Exact: after [`NearestCache::update`] it holds what a search from scratch would find.
#[derive(Debug, Clone)]
pub struct NearestCache {
    columns: Columns,
    /// Version of the meta-shape that the answers are about.
    version: u32,
    /// For every row of the meta-shape, the nearest keypoint of the scan.
    of_rows: Vec<Best>,
    /// For every keypoint of the scan, the nearest row of the meta-shape.
    of_keypoints: Vec<Best>,
}

impl NearestCache {
    /// An empty cache for a scan with these descriptors.
    pub fn new(columns: Columns) -> Self {
        let of_keypoints = vec![Best::NOBODY; columns.len()];
        Self { columns, version: 0, of_rows: Vec::new(), of_keypoints }
    }

    /// Brings the answers up to the present state of `meta`.
    ///
    /// Rows whose descriptor is new are compared with every keypoint. A keypoint whose
    /// nearest row was replaced may now be nearest to any row, so only those keypoints
    /// are searched again.
    pub fn update(&mut self, meta: &MetaShape) {
        let changed: Vec<u32> =
            (0..meta.len() as u32).filter(|&row| meta.changed_at(row as usize) > self.version).collect();
        let lost: Vec<usize> = (0..self.of_keypoints.len())
            .filter(|&k| {
                let row = self.of_keypoints[k].index;
                row != u32::MAX && meta.changed_at(row as usize) > self.version
            })
            .collect();
        let new = nearest_both(meta.descriptors(), &changed, &self.columns);
        self.of_rows.resize(meta.len(), Best::NOBODY);
        for (&row, best) in changed.iter().zip(new.of_rows) {
            self.of_rows[row as usize] = best;
        }
        for (best, candidate) in self.of_keypoints.iter_mut().zip(new.of_columns) {
            *best = best.or(candidate);
        }
        self.search_again(&lost, meta);
        self.version = meta.version();
    }

    /// Searches all rows for the keypoints in `lost`.
    fn search_again(&mut self, lost: &[usize], meta: &MetaShape) {
        if lost.is_empty() {
            return;
        }
        let all: Vec<u32> = (0..meta.len() as u32).collect();
        let found = nearest_both(meta.descriptors(), &all, &self.columns.select(lost));
        for (&k, best) in lost.iter().zip(found.of_columns) {
            self.of_keypoints[k] = best;
        }
    }

    /// Pairs that are each other's nearest, with their positions.
    pub fn mutual(&self, keypoints: &[Point], meta: &MetaShape) -> Matches {
        let mut matches = Matches::default();
        for (k, best) in self.of_keypoints.iter().enumerate() {
            if best.index != u32::MAX && self.of_rows[best.index as usize].index == k as u32 {
                matches.pairs.push((k as u32, best.index));
                matches.source.push(keypoints[k]);
                matches.target.push(meta.points()[best.index as usize]);
                matches.scores.push(best.score);
            }
        }
        matches
    }
}
