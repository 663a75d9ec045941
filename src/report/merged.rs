//! All placed scans of a component as one thinned cloud.

use crate::error::{Error, Result};
use crate::geometry::Point;
use crate::geometry::rigid::PointMover;
use crate::geometry::voxel::VoxelGroups;
use crate::io::read_merged;
use crate::scan::{PointCloud, Reconstruction, Scan};
use std::path::Path;

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

/// What the merged clouds of a result, `files[c]` of component `c`, still hold of each scan, in the
/// frame of that scan: one point a voxel of the model, so that where scans overlap only one of
/// them has it. Scans without a pose have no points, nor have those of a file that does not exist.
///
/// # Errors
/// [`Error::Read`], or [`Error::File`] for a cloud that is not of this result.
pub fn points_of_scans(
    files: &[impl AsRef<Path>],
    reconstruction: &Reconstruction,
) -> Result<Vec<PointCloud>> {
    let mut clouds = vec![PointCloud::default(); reconstruction.outcomes.len()];
    for (component, file) in files.iter().enumerate() {
        let path = file.as_ref();
        if !path.exists() {
            continue;
        }
        let (merged, scans) = read_merged(path)?;
        let scan_from_world = |scan: usize| {
            let placement = reconstruction.outcomes.get(scan).and_then(|o| o.placement());
            placement.filter(|p| p.component == component).map(|p| p.world_from_scan.inverse()).ok_or_else(
                || {
                    let found = format!("points of the scan {scan}");
                    let expected = format!("scans of component {component} of the result only");
                    Error::file(path, found, expected, "remove it, or register again")
                },
            )
        };
        for (i, (point, &scan)) in merged.points.iter().zip(&scans).enumerate() {
            let scan_from_world = scan_from_world(scan)?;
            let world = point.cast::<f64>() + merged.origin_m;
            clouds[scan].points.push((scan_from_world * world).cast());
            if let Some(colors) = &merged.colors {
                clouds[scan].colors.get_or_insert_default().push(colors[i]);
            }
        }
    }
    Ok(clouds)
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

    /// A placement without evidence.
    fn bare() -> Placement {
        Placement {
            world_from_scan: RigidMotion::identity(),
            component: 0,
            step: 0,
            parent: None,
            matches: 0,
            inliers: 0,
            residual_m: 0.0,
            support: None,
            neighbours: Vec::new(),
            hold: None,
        }
    }

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
            let world_from_scan = RigidMotion::translation(x, 0.0, 0.0);
            Outcome::Placed(Placement { world_from_scan, component, ..bare() })
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
    #[test]
    fn a_merged_cloud_is_taken_apart_into_its_scans() {
        let placed = |world_from_scan: RigidMotion, component: usize| {
            Outcome::Placed(Placement { world_from_scan, component, ..bare() })
        };
        let declined = Outcome::Declined(DeclineReason::TooFewKeypoints { keypoints: 0, needed: 3 });
        // A quarter turn about z and a shift: (x, y, z) → (1 − y, 2 + x, 3 + z).
        let turned = RigidMotion::from_parts(
            nalgebra::Translation3::new(1.0, 2.0, 3.0),
            nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2),
        );
        let outcomes =
            vec![placed(RigidMotion::identity(), 0), declined, placed(turned, 0), placed(turned, 1)];
        let reconstruction = Reconstruction { outcomes };
        let folder = tempfile::tempdir().unwrap();
        let files = ["merged.ply", "merged_1.ply"].map(|n| folder.path().join(n));
        let write = |scans: &[i32], colors: Option<&[[u8; 3]]>| {
            let points = vec![Point::new(-4.0, 7.0, 9.0); scans.len()];
            let cloud = crate::io::PlyCloud { points: &points, scans: Some(scans), colors, normals: None };
            crate::io::write_ply(&files[0], &cloud).unwrap();
        };
        write(&[2, 0, 2], Some(&[[1; 3], [2; 3], [3; 3]]));
        let clouds = points_of_scans(&files, &reconstruction).unwrap();
        assert_eq!(clouds.iter().map(PointCloud::len).collect::<Vec<_>>(), [1, 0, 2, 0]);
        assert_eq!(clouds[0].points, [Point::new(-4.0, 7.0, 9.0)]);
        // (1 − y, 2 + x, 3 + z) = (−4, 7, 9) at (5, 5, 6).
        assert!((clouds[2].points[1] - Point::new(5.0, 5.0, 6.0)).norm() < 1e-5, "{}", clouds[2].points[1]);
        assert_eq!(clouds[2].colors, Some(vec![[1; 3], [3; 3]]));

        for (wrong, named) in [(1, "scan 1"), (3, "scan 3"), (9, "scan 9")] {
            write(&[0, wrong], None);
            let said = points_of_scans(&files, &reconstruction).unwrap_err().to_string();
            assert!(said.contains(named) && said.contains("merged.ply"), "{said}");
        }
    }
}
