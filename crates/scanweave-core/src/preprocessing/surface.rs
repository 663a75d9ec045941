//! Thinning of a scan and its normals.

use crate::geometry::neighbours::RadiusGrid;
use crate::geometry::spread::Spread;
use crate::geometry::voxel::{VoxelGroups, voxel_means};
use crate::geometry::{Direction, Point};
use crate::preprocessing::viewpoint::{SeenFrom, ViewpointStudy};
use crate::scan::{PointCloud, Surface, WorkingScale};
use rayon::prelude::*;

/// Thins a cloud alone to one mean point a voxel, as [`Thinned`] does: seen from its viewpoint where
/// that is known, or else from the zero of its coordinates where that can be.
pub fn thin(cloud: &PointCloud, scale: &WorkingScale) -> Surface {
    let thinned = Thinned::new(cloud, &Point::origin(), scale);
    let seen_from = ViewpointStudy::decide(&[thinned.study])[0];
    thinned.seen_from(&seen_from)
}

/// A thinned cloud before it is decided where it was seen from.
pub struct Thinned {
    surface: Surface,
    /// What its shape says of that.
    pub study: ViewpointStudy,
}

impl Thinned {
    /// One mean point a voxel with its normal; points are ordered by voxel, whatever the order of the
    /// cloud. `file_zero` is the zero of the file's coordinates in those of the cloud.
    pub fn new(cloud: &PointCloud, file_zero: &Point, scale: &WorkingScale) -> Self {
        let points = voxel_means(&cloud.points, scale.voxel_m as f32);
        let normals = normals(&points, &Point::origin(), scale.normal_radius_m as f32);
        let study = ViewpointStudy::new(&points, &normals, cloud.viewpoint, *file_zero);
        let intensities = match &cloud.colors {
            Some(colors) => intensities(&VoxelGroups::new(&cloud.points, scale.voxel_m as f32), colors),
            None => Vec::new(),
        };
        Self { surface: Surface { points, normals, intensities, ..Surface::default() }, study }
    }

    /// One that was thinned before.
    pub(crate) fn of_parts(surface: Surface, study: ViewpointStudy) -> Self {
        Self { surface, study }
    }

    /// The surface, whose normals may point to either side, without a viewpoint.
    pub(crate) fn surface(&self) -> &Surface {
        &self.surface
    }

    /// The surface with its normals turned to where it was seen from.
    pub fn seen_from(self, seen_from: &SeenFrom) -> Surface {
        let Surface { points, mut normals, intensities, .. } = self.surface;
        let SeenFrom { viewpoint, confidence, .. } = *seen_from;
        for (normal, p) in normals.iter_mut().zip(&points) {
            *normal = facing(*normal, p, &viewpoint);
        }
        Surface { points, normals, viewpoint, viewpoint_confidence: confidence, intensities }
    }
}

/// `points` of a scan of `known` surface, in the same frame, thinned to another voxel size, seen from the
/// same place; `colors` are those of the points.
pub fn thin_again(
    points: &[Point],
    colors: Option<&[[u8; 3]]>,
    known: &Surface,
    scale: &WorkingScale,
) -> Surface {
    let voxel_m = scale.voxel_m as f32;
    let thinned = voxel_means(points, voxel_m);
    let normals = normals(&thinned, &known.viewpoint, scale.normal_radius_m as f32);
    let intensities = colors.map(|colors| intensities(&VoxelGroups::new(points, voxel_m), colors));
    Surface {
        points: thinned,
        normals,
        intensities: intensities.unwrap_or_default(),
        viewpoint: known.viewpoint,
        viewpoint_confidence: known.viewpoint_confidence,
    }
}

/// Mean brightness of every group of points in `[0, 1]`: luma of the colours as they are stored
/// (ITU-R BT.601).
fn intensities(groups: &VoxelGroups, colors: &[[u8; 3]]) -> Vec<f32> {
    const LUMA: [f32; 3] = [0.299, 0.587, 0.114];
    let luma = |color: [u8; 3]| color.iter().zip(LUMA).map(|(&c, w)| w * f32::from(c)).sum::<f32>() / 255.0;
    let mean = |group: &[u32]| {
        group.iter().map(|&i| luma(colors[i as usize])).sum::<f32>() / group.len().max(1) as f32
    };
    groups.iter().map(mean).collect()
}

/// Unit normals of `points` `[n,3]` by principal components of their neighbours within
/// `radius_m`, turned so that `viewpoint` is in front of the surface.
///
/// The zero vector where the neighbours fix no plane: fewer than three, or on one line.
pub fn normals(points: &[Point], viewpoint: &Point, radius_m: f32) -> Vec<Direction> {
    let grid = RadiusGrid::new(points, radius_m);
    points
        .par_iter()
        .map(|p| {
            let normal = plane_normal(&grid, p, points).unwrap_or_default();
            facing(normal, p, viewpoint)
        })
        .collect()
}

/// The normal at `p`, turned to the viewpoint.
fn facing(normal: Direction, p: &Point, viewpoint: &Point) -> Direction {
    if (viewpoint - p).dot(&normal) < 0.0 { -normal } else { normal }
}

/// Direction of least variance about the mean of the neighbourhood of `p`.
fn plane_normal(grid: &RadiusGrid<'_>, p: &Point, points: &[Point]) -> Option<Direction> {
    let mut spread = Spread::default();
    // Relative to p: sums of far-away coordinates would lose the small differences.
    grid.for_each_within(p, |i, _| spread.add((points[i] - p).cast()));
    spread.least_direction()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use rand::RngExt;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    /// Random points on the unit sphere.
    fn sphere(n: usize) -> Vec<Point> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut draw = || Vector3::from_fn(|_, _| rng.random_range(-1.0f32..1.0));
        std::iter::repeat_with(&mut draw)
            .filter(|v| (0.1..1.0).contains(&v.norm()))
            .map(|v| Point::from(v.normalize()))
            .take(n)
            .collect()
    }

    #[test]
    fn normals_of_a_sphere_point_at_a_viewpoint_inside_and_away_from_none() {
        let points = sphere(20_000);
        for (p, n) in points.iter().zip(normals(&points, &Point::origin(), 0.1)) {
            // The cap of radius 0.1 is tilted by sampling noise only: some 2° at 50 points.
            assert!(n.dot(&-p.coords) > 0.985, "{p} {n}");
            assert!((n.norm() - 1.0).abs() < 1e-5);
        }
        let outside = Point::new(0.0, 0.0, 9.0);
        let seen = normals(&points, &outside, 0.1);
        let at = points.iter().position(|p| p.z > 0.99).unwrap();
        assert!(seen[at].z > 0.98);
    }

    #[test]
    fn a_point_off_its_neighbours_gets_their_normal() {
        // The axis of least spread about the mean, by the SVD of the centred coordinates.
        // The queried point lies aside: spread about the point itself has another axis.
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..50 {
            let size = Vector3::new(1.0f32, 0.7, 0.3);
            let mut draw = || Vector3::from_fn(|axis, _| 3.0 + size[axis] * rng.random_range(-1.0f32..1.0));
            let mut points: Vec<Point> = (0..30).map(|_| Point::from(draw())).collect();
            points.push(Point::new(3.0, 3.3, 3.9));
            let mean = points.iter().map(|p| p.coords.cast::<f64>()).sum::<Vector3<f64>>() / 31.0;
            let centred = nalgebra::Matrix3xX::from_fn(31, |r, c| f64::from(points[c][r]) - mean[r]);
            let svd = centred.svd(true, false);
            let expected = svd.u.unwrap().column(svd.singular_values.imin()).into_owned().cast::<f32>();
            let found = normals(&points, &Point::origin(), 10.0)[30];
            assert!(found.dot(&expected).abs() > 0.99999, "{found} {expected}");
        }
    }

    #[test]
    fn far_from_the_origin_the_normal_is_as_good() {
        // A tilted plane 1 km out, where sums of squares of raw coordinates lose the plane.
        let truth = Vector3::new(1.0f32, 2.0, 2.0) / 3.0;
        let (u, v) = (Vector3::new(2.0f32, 1.0, -2.0) / 3.0, Vector3::new(2.0f32, -2.0, 1.0) / 3.0);
        let at = |i: usize| u * (i % 20) as f32 * 0.125 + v * (i / 20) as f32 * 0.125;
        let points: Vec<Point> =
            (0..400).map(|i| Point::from(Vector3::new(1024.0, -1024.0, 512.0) + at(i))).collect();
        for n in normals(&points, &Point::from(points[0] + truth), 0.5) {
            assert!(n.dot(&truth) > 0.99999, "{n}");
        }
    }

    #[test]
    fn lines_and_lone_points_have_no_normal() {
        let mut points: Vec<Point> =
            (0..20).map(|i| Point::new(i as f32 * 0.1, i as f32 * 0.2, 0.0)).collect();
        points.push(Point::new(50.0, 0.0, 0.0));
        points.extend([Point::new(-50.0, 0.0, 0.0); 5]);
        assert!(normals(&points, &Point::new(0.0, 0.0, 5.0), 0.5).iter().all(|n| *n == Direction::zeros()));
        assert!(normals(&[], &Point::origin(), 0.5).is_empty());
    }

    #[test]
    fn thinning_gives_the_same_surface_for_any_order_of_points() {
        let mut cloud = PointCloud::from_points(sphere(5000));
        let scale = WorkingScale::from_voxel(0.05);
        let surface = thin(&cloud, &scale);
        assert!(surface.len() > 1000 && surface.normals.len() == surface.len());
        cloud.points.reverse();
        let reversed = thin(&cloud, &scale);
        // Means are summed in another order: equal up to the last bit of f32.
        for (a, b) in surface.points.iter().zip(&reversed.points) {
            assert!((a - b).norm() < 1e-6);
        }
    }
}
