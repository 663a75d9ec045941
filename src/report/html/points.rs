//! The points of a scan that a page shows: thinned, few enough, and packed.

use crate::geometry::Point;
use crate::geometry::VoxelGroups;
use crate::scan::PointCloud;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;

/// Points that a page shows at most, of all scans together. A point takes at most ten bytes,
/// 13.4 in base64: the page stays below 11 MB, and an ordinary graphics chip turns it smoothly.
pub const MOST_POINTS: usize = 700_000;

/// Where a page's points of a scan come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum PointSource {
    /// The scan itself.
    Scan,
    /// The merged cloud, in which overlapping scans share their points out.
    Merged,
}

/// The points of one scan that are shown, in its own frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Shown {
    /// Metres, in an order in which every beginning is an even choice.
    pub points: Vec<Point>,
    /// sRGB, where the scan has colour.
    pub colors: Option<Vec<[u8; 3]>>,
}

/// One mean point and colour a voxel of `voxel_m`; where that is more than `most` points for all
/// scans together, every scan keeps the same share of its own.
///
/// Scan `i` draws from its own stream of `seed`.
pub(super) fn choose(clouds: &[&PointCloud], voxel_m: f32, most: usize, seed: u64) -> Vec<Shown> {
    let groups: Vec<VoxelGroups> = clouds.par_iter().map(|c| VoxelGroups::new(&c.points, voxel_m)).collect();
    let total: usize = groups.iter().map(VoxelGroups::len).sum();
    let share = (most as f64 / total.max(1) as f64).min(1.0);
    let one = |(i, (cloud, groups)): (usize, (&&PointCloud, &VoxelGroups))| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(i as u64);
        let mut chosen: Vec<&[u32]> = groups.iter().collect();
        chosen.shuffle(&mut rng);
        chosen.truncate((groups.len() as f64 * share) as usize);
        let mean = |values: &dyn Fn(usize) -> Vector3<f32>, group: &[u32]| {
            let sum: Vector3<f64> = group.iter().map(|&i| values(i as usize).cast::<f64>()).sum();
            (sum / group.len() as f64).cast::<f32>()
        };
        let mean_point = |g: &[u32]| Point::from(mean(&|i| cloud.points[i].coords, g));
        let points = chosen.iter().map(|g| mean_point(g)).collect();
        let colors = cloud.colors.as_ref().map(|colors| {
            let color = |i: usize| Vector3::from(colors[i]).cast::<f32>();
            chosen.iter().map(|g| mean(&color, g).map(|v| v.round() as u8).into()).collect()
        });
        Shown { points, colors }
    };
    clouds.par_iter().zip(&groups).enumerate().map(one).collect()
}

/// [`Shown`] as a page takes it: base64 of little-endian arrays.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Packed {
    /// Number of points n.
    pub count: usize,
    /// Least coordinates, metres.
    pub low: [f32; 3],
    /// Extent of the box, metres; never zero.
    pub size: [f32; 3],
    /// `[n,3]` 16-bit: 0 at `low`, 65535 at `low + size`.
    pub xyz: String,
    /// `[n,3]` 8-bit sRGB.
    pub rgb: Option<String>,
    /// `[n]` 8-bit disagreement with other scans: see [`super::agreement`].
    pub residual: Option<String>,
}

impl Packed {
    /// Packs what is shown; `residual` has one value a point.
    pub fn new(shown: &Shown, residual: Option<&[u8]>) -> Self {
        let (low, high) =
            shown.points.iter().fold(
                (Vector3::repeat(f32::INFINITY), Vector3::repeat(f32::NEG_INFINITY)),
                |(low, high), p| (low.inf(&p.coords), high.sup(&p.coords)),
            );
        let empty = shown.points.is_empty();
        let low = if empty { Vector3::zeros() } else { low };
        let size = if empty { Vector3::repeat(1.0) } else { (high - low).map(|s| s.max(1e-9)) };
        let step = |p: &Point, a: usize| ((p[a] - low[a]) / size[a] * 65535.0).round() as u16;
        let xyz: Vec<u8> =
            shown.points.iter().flat_map(|p| [0, 1, 2].map(|a| step(p, a).to_le_bytes())).flatten().collect();
        Self {
            count: shown.points.len(),
            low: low.into(),
            size: size.into(),
            xyz: STANDARD.encode(xyz),
            rgb: shown.colors.as_ref().map(|c| STANDARD.encode(c.as_flattened())),
            residual: residual.map(|r| STANDARD.encode(r)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(n: usize) -> PointCloud {
        let at = |i: usize| Point::new((i % 50) as f32, (i / 50 % 50) as f32, (i / 2500) as f32);
        PointCloud::from_points((0..n).map(at).collect())
    }

    #[test]
    fn a_budget_is_shared_by_size_and_any_beginning_is_spread_evenly() {
        let (large, small) = (grid(40_000), grid(10_000));
        let chosen = choose(&[&large, &small], 0.5, 5_000, 1);
        assert_eq!(chosen.iter().map(|s| s.points.len()).collect::<Vec<_>>(), [4_000, 1_000]);
        // The first tenth has its mean where the whole has it: 24.5 ± 5 standard errors of 14.4/√400.
        let mean = chosen[0].points[..400].iter().map(|p| f64::from(p.x)).sum::<f64>() / 400.0;
        assert!((mean - 24.5).abs() < 5.0 * 14.4 / 20.0, "{mean}");
        // Nothing is drawn where all fit, and another scan draws differently.
        assert_eq!(choose(&[&small], 0.5, 10_000, 1)[0].points.len(), 10_000);
        let twins = choose(&[&small, &small], 0.5, 5_000, 1);
        assert_ne!(twins[0], twins[1]);
    }

    #[test]
    fn packed_points_are_where_they_were_within_half_a_step() {
        let points = [[1.0, -2.0, 5.0], [3.0, 2.0, 5.0], [1.7, 0.1, 5.0]].map(Point::from).to_vec();
        let shown = Shown { points: points.clone(), colors: Some(vec![[1, 2, 3], [4, 5, 6], [7, 8, 9]]) };
        let packed = Packed::new(&shown, Some(&[0, 128, 255]));
        let bytes = STANDARD.decode(&packed.xyz).unwrap();
        for (p, six) in points.iter().zip(bytes.chunks_exact(6)) {
            for a in 0..3 {
                let v = f32::from(u16::from_le_bytes([six[2 * a], six[2 * a + 1]]));
                let back = packed.low[a] + packed.size[a] * v / 65535.0;
                assert!((back - p[a]).abs() <= 0.5001 * packed.size[a] / 65535.0 + 1e-6, "{back} {}", p[a]);
            }
        }
        // RFC 4648: bytes 01…09 and 00 80 ff.
        assert_eq!(packed.rgb.as_deref(), Some("AQIDBAUGBwgJ"));
        assert_eq!(packed.residual.as_deref(), Some("AID/"));
        let none = Packed::new(&Shown::default(), None);
        assert_eq!((none.count, none.xyz.as_str(), none.size), (0, "", [1.0; 3]));
    }

    #[test]
    fn a_voxel_shows_its_mean_point_and_colour() {
        let cloud = PointCloud {
            colors: Some(vec![[10, 0, 0], [20, 0, 0], [200, 0, 0]]),
            ..PointCloud::from_points(
                [[0.1, 0.1, 0.1], [0.3, 0.1, 0.1], [5.5, 0.0, 0.0]].map(Point::from).to_vec(),
            )
        };
        let mut shown = choose(&[&cloud], 1.0, 100, 0).remove(0);
        let colors = shown.colors.take().unwrap();
        let at = shown.points.iter().position(|p| p.x < 1.0).unwrap();
        assert!((shown.points[at] - Point::new(0.2, 0.1, 0.1)).norm() < 1e-6);
        assert_eq!((colors[at], colors.len()), ([15, 0, 0], 2));
    }
}
