//! The growing union of registered scans' features.

use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::rigid::PointMover;
use crate::geometry::{Point, RigidMotion};
use crate::registration::config::MergeRule;
use crate::registration::pairwise::matching::MatchTarget;
use crate::scan::{Features, ScanId};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// Keypoints and descriptors of all scans registered so far, in the frame of the pivot.
#[derive(Debug, Clone)]
pub struct MetaShape {
    dim: usize,
    points: Vec<Point>,
    descriptors: Vec<f32>,
    /// Where each row's keypoint came from: scan and keypoint.
    origins: Vec<(ScanId, u32)>,
    /// How many keypoints have met in a row.
    counts: Vec<u64>,
    /// Version at which the descriptor of a row last changed.
    changed: Vec<u32>,
    version: u32,
}

impl MetaShape {
    /// The meta-shape of the pivot alone; its frame is the pivot's.
    pub fn new(pivot: ScanId, features: &Features) -> Self {
        let mut meta = Self {
            dim: features.descriptors.dim(),
            points: Vec::with_capacity(features.len()),
            descriptors: Vec::with_capacity(features.descriptors.values().len()),
            origins: Vec::with_capacity(features.len()),
            counts: Vec::with_capacity(features.len()),
            changed: Vec::with_capacity(features.len()),
            version: 1,
        };
        for k in 0..features.len() {
            meta.push(pivot, k, features.keypoints[k], features);
        }
        meta
    }

    fn push(&mut self, scan: ScanId, keypoint: usize, point: Point, features: &Features) {
        self.points.push(point);
        self.descriptors.extend_from_slice(features.descriptors.row(keypoint));
        self.origins.push((scan, keypoint as u32));
        self.counts.push(1);
        self.changed.push(self.version);
    }

    /// Merges a registered scan.
    ///
    /// Rows and keypoints that are each other's nearest within `radius_m` are redundant.
    /// Under [`MergeRule::Reservoir`] the newcomer replaces a row with probability
    /// 1/(count+1), so that after m meetings each of the m keypoints is kept with
    /// probability 1/m (Vitter's algorithm R with a reservoir of one).
    pub fn merge(
        &mut self,
        scan: ScanId,
        features: &Features,
        world_from_scan: &RigidMotion,
        rule: MergeRule,
        radius_m: f32,
        rng: &mut ChaCha8Rng,
    ) {
        self.version += 1;
        let moved = PointMover::new(world_from_scan).points(&features.keypoints);
        let partner = match rule {
            MergeRule::Concatenate => vec![None; moved.len()],
            MergeRule::Reservoir | MergeRule::Mean => mutual_nearest(&moved, &self.points, radius_m),
        };
        for (k, partner) in partner.into_iter().enumerate() {
            let Some(row) = partner else {
                self.push(scan, k, moved[k], features);
                continue;
            };
            match rule {
                MergeRule::Mean => self.average(row, moved[k], features.descriptors.row(k)),
                _ if rng.random_range(0..=self.counts[row]) == 0 => {
                    self.points[row] = moved[k];
                    self.origins[row] = (scan, k as u32);
                    self.changed[row] = self.version;
                    self.descriptors[row * self.dim..(row + 1) * self.dim]
                        .copy_from_slice(features.descriptors.row(k));
                }
                _ => {}
            }
            self.counts[row] += 1;
        }
    }

    /// Folds one more keypoint into the running mean of a row.
    fn average(&mut self, row: usize, point: Point, descriptor: &[f32]) {
        let share = 1.0 / (self.counts[row] as f32 + 1.0);
        let step = (point - self.points[row]) * share;
        self.points[row] += step;
        for (mean, &new) in self.descriptors[row * self.dim..(row + 1) * self.dim].iter_mut().zip(descriptor)
        {
            *mean += (new - *mean) * share;
        }
        self.changed[row] = self.version;
    }

    /// Moves every row with the scan it came from, after poses were refined.
    ///
    /// `new_from_old` gives the motion of a scan from its old place to its new one.
    pub fn repose(&mut self, new_from_old: impl Fn(ScanId) -> RigidMotion) {
        let mut movers: BTreeMap<ScanId, PointMover> = BTreeMap::new();
        for (point, &(scan, _)) in self.points.iter_mut().zip(&self.origins) {
            let mover = movers.entry(scan).or_insert_with(|| PointMover::new(&new_from_old(scan)));
            *point = mover.point(point);
        }
    }

    /// What candidates are matched with.
    pub fn as_target(&self) -> MatchTarget<'_> {
        MatchTarget {
            points: &self.points,
            descriptors: &self.descriptors,
            version: self.version,
            changed: Some(&self.changed),
        }
    }

    /// The scan and keypoint that a row holds at present.
    pub fn origin(&self, row: usize) -> (ScanId, u32) {
        self.origins[row]
    }
}

/// For every point of `a`, the point of `b` within `radius_m` that is its nearest and whose nearest it is.
fn mutual_nearest(a: &[Point], b: &[Point], radius_m: f32) -> Vec<Option<usize>> {
    let (grid_a, grid_b) = (RadiusGrid::new(a, radius_m), RadiusGrid::new(b, radius_m));
    a.iter()
        .enumerate()
        .map(|(i, p)| {
            let (j, _) = grid_b.nearest(p)?;
            (grid_a.nearest(&b[j])?.0 == i).then_some(j)
        })
        .collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::registration::pairwise::matching::NearestCache;
    use crate::registration::pairwise::nearest::Columns;
    use crate::scan::Descriptors;
    use proptest::prelude::*;
    use rand::SeedableRng;

    impl MetaShape {
        fn len(&self) -> usize {
            self.points.len()
        }

        fn points(&self) -> &[Point] {
            &self.points
        }

        fn descriptors(&self) -> &[f32] {
            &self.descriptors
        }
    }

    pub(crate) fn features(points: Vec<Point>, dim: usize, values: Vec<f32>) -> Features {
        Features::new(points, None, Descriptors::new(dim, values).unwrap().normalized()).unwrap()
    }

    fn single(x: f32, tag: f32) -> Features {
        features(vec![Point::new(x, 0.0, 0.0)], 2, vec![tag.cos(), tag.sin()])
    }

    #[test]
    fn every_keypoint_that_met_in_a_row_is_kept_with_equal_probability() {
        // Closed form: after m meetings each of the m is the survivor with probability 1/m.
        let (m, trials) = (4usize, 4000u64);
        let mut survivors = vec![0u32; m];
        for trial in 0..trials {
            let mut rng = ChaCha8Rng::seed_from_u64(trial);
            let mut meta = MetaShape::new(ScanId(0), &single(0.0, 0.0));
            for s in 1..m {
                let pose = RigidMotion::identity();
                meta.merge(ScanId(s), &single(0.001, s as f32), &pose, MergeRule::Reservoir, 0.07, &mut rng);
            }
            assert_eq!(meta.len(), 1);
            survivors[meta.origin(0).0.0] += 1;
        }
        // Binomial(4000, 1/4): standard deviation 27; five of them either side.
        assert!(survivors.iter().all(|&n| (n as i32 - 1000).abs() < 137), "{survivors:?}");
    }

    #[test]
    fn unpaired_points_of_both_sides_are_kept() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut meta = MetaShape::new(ScanId(0), &single(0.0, 0.0));
        let shift = RigidMotion::translation(5.0, 0.0, 0.0);
        meta.merge(ScanId(1), &single(0.0, 1.0), &shift, MergeRule::Reservoir, 0.07, &mut rng);
        assert_eq!(meta.len(), 2);
        assert_eq!(meta.points()[1], Point::new(5.0, 0.0, 0.0));
    }

    #[test]
    fn mean_merge_is_the_arithmetic_mean_of_all_that_met() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let pose = RigidMotion::identity();
        let mut meta = MetaShape::new(ScanId(0), &single(0.0, 0.0));
        for (s, x) in [(1, 0.03), (2, 0.06)] {
            meta.merge(ScanId(s), &single(x, s as f32), &pose, MergeRule::Mean, 0.07, &mut rng);
        }
        assert!((meta.points()[0].x - 0.03).abs() < 1e-6);
        let expected = (1.0 + 1f32.cos() + 2f32.cos()) / 3.0;
        assert!((meta.descriptors()[0] - expected).abs() < 1e-6);
        let mut concatenated = MetaShape::new(ScanId(0), &single(0.0, 0.0));
        concatenated.merge(ScanId(1), &single(0.01, 1.0), &pose, MergeRule::Concatenate, 0.07, &mut rng);
        assert_eq!(concatenated.len(), 2);
    }

    fn scan(n: usize) -> impl Strategy<Value = Features> {
        // Coordinates on a coarse lattice make many redundant pairs; few distinct descriptors make ties.
        (prop::collection::vec((0..6i8, 0..6i8), n), prop::collection::vec(0..5i8, n * 3)).prop_map(
            |(xy, d)| {
                let points =
                    xy.into_iter().map(|(x, y)| Point::new(f32::from(x), f32::from(y), 0.0)).collect();
                features(points, 3, d.into_iter().map(|v| f32::from(v) + 0.1).collect())
            },
        )
    }

    proptest! {
        #[test]
        fn updated_matches_equal_a_search_from_scratch(
            scans in prop::collection::vec(scan(30), 5),
            candidate in scan(25),
            rule in prop::sample::select(vec![MergeRule::Reservoir, MergeRule::Mean, MergeRule::Concatenate]),
            skip in 0..4usize,
            seed: u64,
        ) {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut meta = MetaShape::new(ScanId(0), &scans[0]);
            let mut cache = NearestCache::new(Columns::new(&candidate.descriptors));
            cache.update(&meta.as_target());
            for (s, merged) in scans.iter().enumerate().skip(1) {
                meta.merge(ScanId(s), merged, &RigidMotion::identity(), rule, 0.5, &mut rng);
                if s == skip {
                    continue; // a candidate may sit out a few steps
                }
                cache.update(&meta.as_target());
                let mut fresh = NearestCache::new(Columns::new(&candidate.descriptors));
                fresh.update(&meta.as_target());
                prop_assert_eq!(
                    cache.mutual(&candidate.keypoints, &meta.as_target()),
                    fresh.mutual(&candidate.keypoints, &meta.as_target())
                );
            }
        }
    }

    #[test]
    fn reposing_moves_rows_with_their_scan() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (a, b) = (single(0.0, 0.0), single(0.0, 1.0));
        let mut meta = MetaShape::new(ScanId(0), &a);
        let shift = RigidMotion::translation(5.0, 0.0, 0.0);
        meta.merge(ScanId(1), &b, &shift, MergeRule::Reservoir, 0.07, &mut rng);
        let nudge = RigidMotion::translation(1.0, 0.0, 0.0);
        meta.repose(|s| if s.0 == 1 { nudge } else { RigidMotion::identity() });
        assert_eq!(meta.points(), [Point::origin(), Point::new(6.0, 0.0, 0.0)]);
    }
}
