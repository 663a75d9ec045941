//! All placed scans of a component as one thinned cloud.

use crate::geometry::Point;
use crate::geometry::rigid::PointMover;
use crate::geometry::voxel::VoxelGroups;
use crate::scan::{Reconstruction, Scan};

/// Colour of points whose scan has none, where other scans do.
const NO_COLOR: [u8; 3] = [128; 3];

/// A merged cloud.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MergedCloud {
    /// `[n,3]`, metres, in the frame of the component.
    pub points: Vec<Point>,
    /// `[n]` sRGB, where any of the scans has colour.
    pub colors: Option<Vec<[u8; 3]>>,
    /// `[n]` index of the scan that gave a point most of its measurements.
    pub scan: Vec<u32>,
}

impl MergedCloud {
    /// Brings the scans of `component` into its frame and keeps one point a voxel of
    /// `voxel_m`: the mean of the points and colours that fall into it. Ordered by voxel.
    pub fn new(scans: &[Scan], reconstruction: &Reconstruction, component: usize, voxel_m: f32) -> Self {
        let colored = scans.iter().any(|s| s.cloud.colors.is_some());
        let mut all = Self { colors: colored.then(Vec::new), ..Self::default() };
        for (scan, outcome) in scans.iter().zip(&reconstruction.outcomes) {
            let Some(placement) = outcome.placement().filter(|p| p.component == component) else { continue };
            let mover = PointMover::new(&placement.world_from_scan);
            all.points.extend(scan.cloud.points.iter().map(|p| mover.point(p)));
            all.scan.resize(all.points.len(), scan.id.0 as u32);
            if let Some(colors) = &mut all.colors {
                colors.extend(scan.cloud.colors.iter().flatten());
                colors.resize(all.points.len(), NO_COLOR);
            }
        }
        all.thinned(voxel_m)
    }

    fn thinned(&self, voxel_m: f32) -> Self {
        let mut thin = Self { colors: self.colors.as_ref().map(|_| Vec::new()), ..Self::default() };
        for group in VoxelGroups::new(&self.points, voxel_m).iter() {
            thin.points.push(Point::from(mean(group, |i| self.points[i].coords.into())));
            thin.scan.push(most_frequent(group.iter().map(|&i| self.scan[i as usize])));
            if let (Some(out), Some(colors)) = (&mut thin.colors, &self.colors) {
                out.push(mean(group, |i| colors[i].map(f32::from)).map(|v| v.round() as u8));
            }
        }
        thin
    }
}

/// Mean of a triple over a group, summed in double precision.
fn mean(group: &[u32], value: impl Fn(usize) -> [f32; 3]) -> [f32; 3] {
    let mut sum = [0.0f64; 3];
    for &i in group {
        for (s, v) in sum.iter_mut().zip(value(i as usize)) {
            *s += f64::from(v);
        }
    }
    sum.map(|s| (s / group.len() as f64) as f32)
}

/// The value that occurs most often, the lowest of equals; the values come in ascending runs.
fn most_frequent(values: impl Iterator<Item = u32>) -> u32 {
    let (mut best, mut best_count, mut current, mut count) = (0, 0usize, 0, 0usize);
    for value in values {
        count = if value == current { count + 1 } else { 1 };
        current = value;
        if count > best_count {
            (best, best_count) = (current, count);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::RigidMotion;
    use crate::scan::{DeclineReason, Outcome, Placement, PointCloud, ScanId};

    #[test]
    fn placed_scans_are_moved_thinned_and_keep_colour_and_scan() {
        let scan = |id: usize, points: &[[f32; 3]], colors: Option<Vec<[u8; 3]>>| Scan {
            id: ScanId(id),
            name: String::new(),
            path: None,
            cloud: PointCloud {
                colors,
                ..PointCloud::from_points(points.iter().map(|&p| Point::from(p)).collect())
            },
        };
        let placed = |x: f64, component: usize| {
            Outcome::Placed(Placement {
                world_from_scan: RigidMotion::translation(x, 0.0, 0.0),
                component,
                step: 0,
                parent: None,
                matches: 0,
                inliers: 0,
                residual_m: 0.0,
                support: None,
                neighbours: Vec::new(),
                hold: None,
            })
        };
        let scans = [
            scan(0, &[[0.1, 0.1, 0.1]], Some(vec![[10, 20, 30]])),
            scan(1, &[[-0.8, 0.1, 0.1], [-0.6, 0.1, 0.1], [2.5, 0.5, 0.5]], Some(vec![[40, 20, 30]; 3])),
            scan(2, &[[4.5, 0.5, 0.5]], None),
            scan(3, &[[9.5, 0.5, 0.5]], None),
            scan(4, &[[7.5, 0.5, 0.5]], None),
        ];
        let declined = Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 0, needed: 3 });
        let outcomes = vec![placed(0.0, 0), placed(1.0, 0), placed(0.0, 0), placed(0.0, 1), declined];
        let merged = MergedCloud::new(&scans, &Reconstruction { outcomes }, 0, 1.0);
        // First voxel: (0.1 + 0.2 + 0.4)/3 and (10 + 40 + 40)/3; two of its three points are scan 1's.
        assert_eq!(merged.scan, [1, 1, 2]);
        assert!((merged.points[0] - Point::new(0.7 / 3.0, 0.1, 0.1)).norm() < 1e-6);
        assert!((merged.points[1] - Point::new(3.5, 0.5, 0.5)).norm() < 1e-6);
        assert_eq!(merged.colors.unwrap(), [[30, 20, 30], [40, 20, 30], NO_COLOR]);
    }
}
