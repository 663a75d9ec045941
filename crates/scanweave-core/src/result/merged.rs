//! All placed scans of a component as one thinned cloud.

use crate::error::{Error, Result};
use crate::geometry::rigid::PointMover;
use crate::geometry::voxel::{VoxelGroups, voxel_of};
use crate::geometry::{Point, RigidMotion};
use crate::io::read_merged;
use crate::scan::assemble::{assemble, choose_origin};
use crate::scan::{Placement, PointCloud, Reconstruction, Scan};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::path::Path;

/// Colour of points whose scan has none, where other scans do.
const NO_COLOR: [u8; 3] = [128; 3];
/// Points of a scan that tell where the model lies.
const SAMPLE: usize = 100;
/// Points that are thinned at a time.
const SLAB: usize = 4_000_000;

/// A merged cloud.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MergedCloud {
    /// `[n,3]`, metres, relative to `origin_m`.
    pub points: Vec<Point>,
    /// Where the zero of the points lies in the frame of the component, metres: not at zero where
    /// that frame is georeferenced.
    pub origin_m: Vector3<f64>,
    /// `[n]` sRGB, where any of the scans has colour.
    pub colors: Option<Vec<[u8; 3]>>,
    /// `[n]` index of the scan that gave a point most of its measurements.
    pub scan: Vec<u32>,
}

impl MergedCloud {
    /// Brings the scans of `component` into its frame and keeps one point a voxel of
    /// `voxel_m`: the mean of the points and colours that fall into it. Ordered by voxel.
    pub fn new(scans: &[Scan], reconstruction: &Reconstruction, component: usize, voxel_m: f32) -> Self {
        Self::in_slabs(scans, reconstruction, component, voxel_m, SLAB)
    }

    /// The same, with at most so many points at a time (or a layer of voxels, if that has more): large
    /// models have more points than should be held twice.
    fn in_slabs(
        scans: &[Scan],
        reconstruction: &Reconstruction,
        component: usize,
        voxel_m: f32,
        most: usize,
    ) -> Self {
        let members: Vec<(&Scan, &Placement)> = scans
            .iter()
            .zip(&reconstruction.outcomes)
            .filter_map(|(scan, outcome)| {
                Some((scan, outcome.placement().filter(|p| p.component == component)?))
            })
            .collect();
        // Georeferenced models lie as far from zero as the scans that they are made of.
        let some = members.iter().flat_map(|(scan, placement)| {
            let world_from_points = placement.world_from_scan * scan.cloud.file_from_points();
            let points = scan.cloud.points.iter().step_by(scan.cloud.len().div_ceil(SAMPLE).max(1));
            points.map(move |p| (world_from_points * p.cast::<f64>()).coords.into())
        });
        let some: Vec<[f64; 3]> = some.collect();
        let origin_m = choose_origin(some.len(), &|i| some[i]);
        let near = RigidMotion::translation(-origin_m.x, -origin_m.y, -origin_m.z);
        let mover = |(scan, placement): (&'_ Scan, &Placement)| {
            PointMover::new(&(near * placement.world_from_scan * scan.cloud.file_from_points()))
        };
        let placed: Vec<(&Scan, PointMover)> = members.iter().map(|&(s, p)| (s, mover((s, p)))).collect();
        let colored = scans.iter().any(|s| s.cloud.colors.is_some());
        let empty = || Self { colors: colored.then(Vec::new), ..Self::default() };
        // Layers of voxels along x come one after the other in the order of voxels.
        let layer = |p: &Point| voxel_of(p, voxel_m)[0];
        let mut points_in: BTreeMap<i32, usize> = BTreeMap::new();
        let of_scan = |(scan, mover): &(&Scan, PointMover)| {
            let mut layers = (i32::MAX, i32::MIN);
            for p in &scan.cloud.points {
                let x = layer(&mover.point(p));
                *points_in.entry(x).or_default() += 1;
                layers = (layers.0.min(x), layers.1.max(x));
            }
            layers
        };
        let layers_of: Vec<(i32, i32)> = placed.iter().map(of_scan).collect();
        let mut thin = Self { origin_m, ..empty() };
        for (low, high) in slabs(&points_in, most) {
            let mut slab = empty();
            let reaching = placed.iter().zip(&layers_of).filter(|(_, l)| l.0 <= high && low <= l.1);
            for ((scan, mover), _) in reaching {
                slab.extend(scan, mover, |p| (low..=high).contains(&layer(p)));
            }
            slab.thin_into(voxel_m, &mut thin);
        }
        thin
    }

    /// Appends the chosen points of a scan.
    fn extend(&mut self, scan: &Scan, mover: &PointMover, chosen: impl Fn(&Point) -> bool) {
        for (i, p) in scan.cloud.points.iter().enumerate() {
            let p = mover.point(p);
            if !chosen(&p) {
                continue;
            }
            self.points.push(p);
            self.scan.push(scan.id.0 as u32);
            if let Some(colors) = &mut self.colors {
                colors.push(scan.cloud.colors.as_ref().map_or(NO_COLOR, |c| c[i]));
            }
        }
    }

    /// Appends one point a voxel, ordered by voxel.
    fn thin_into(&self, voxel_m: f32, thin: &mut Self) {
        for group in VoxelGroups::new(&self.points, voxel_m).iter() {
            thin.points.push(Point::from(mean(group, |i| self.points[i].coords.into())));
            thin.scan.push(most_frequent(group.iter().map(|&i| self.scan[i as usize])));
            if let (Some(out), Some(colors)) = (&mut thin.colors, &self.colors) {
                out.push(mean(group, |i| colors[i].map(f32::from)).map(|v| v.round() as u8));
            }
        }
    }
}

/// Consecutive layers, from first to last, with at most so many points together where one has not more.
fn slabs(points_in: &BTreeMap<i32, usize>, most: usize) -> Vec<(i32, i32)> {
    let mut slabs: Vec<(i32, i32)> = Vec::new();
    let mut held = usize::MAX;
    for (&layer, &points) in points_in {
        match slabs.last_mut() {
            Some(last) if held.saturating_add(points) <= most => {
                last.1 = layer;
                held += points;
            }
            _ => {
                slabs.push((layer, layer));
                held = points;
            }
        }
    }
    slabs
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
    let scans = reconstruction.outcomes.len();
    let (mut rows, mut colors) = (vec![Vec::<[f64; 3]>::new(); scans], vec![Vec::<[u8; 3]>::new(); scans]);
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
            rows[scan].push((scan_from_world * world).coords.into());
            if let Some(of_points) = &merged.colors {
                colors[scan].push(of_points[i]);
            }
        }
    }
    let cloud = |(rows, colors): (Vec<[f64; 3]>, Vec<[u8; 3]>)| {
        let color = (colors.len() == rows.len() && !rows.is_empty()).then_some(|i: usize| colors[i]);
        assemble(rows.len(), |i| rows[i], color, None)
    };
    Ok(rows.into_iter().zip(colors).map(cloud).collect())
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
    use crate::scan::{DeclineReason, Outcome, ScanId};

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
            evidence: None,
            neighbours: Vec::new(),
            pose_uncertainty: None,
        }
    }

    #[test]
    fn placed_scans_are_moved_thinned_and_keep_colour_and_scan() {
        let scan = |id: usize, points: &[[f32; 3]], colors: Option<Vec<[u8; 3]>>| Scan {
            id: ScanId(id),
            cloud: PointCloud {
                colors,
                ..PointCloud::from_points(points.iter().map(|&p| Point::from(p)).collect())
            },
            ..Scan::default()
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
        let reconstruction = Reconstruction { outcomes };
        let merged = MergedCloud::new(&scans, &reconstruction, 0, 1.0);
        // However few points are thinned at a time.
        for most in 1..8 {
            assert_eq!(MergedCloud::in_slabs(&scans, &reconstruction, 0, 1.0, most), merged);
        }
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
            let cloud =
                crate::io::PlyCloud { points: &points, scans: Some(scans), colors, ..Default::default() };
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
