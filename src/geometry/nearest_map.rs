//! The point of a set that is nearest to a place, looked up instead of searched for.
//!
//! Space within a radius of the points is cut into voxels, and each voxel keeps the point that is
//! nearest to its centre. A lookup costs the same however many points there are, and what it
//! finds is at most one voxel diagonal further away than the true nearest point.

use super::Point;
use std::collections::HashMap;

/// Voxels along a radius: finer costs memory and time to build with its third power.
const VOXELS_PER_RADIUS: f32 = 3.0;
/// A place within the radius lies in a voxel whose centre is half a diagonal further at most: in
/// voxels, less than the side of a block.
const REACH: f32 = VOXELS_PER_RADIUS + 0.866_026;
/// Voxels along the side of a block, which are stored together.
const SIDE: i32 = 4;
/// Voxels of a block.
const BLOCK: usize = (SIDE * SIDE * SIDE) as usize;
/// No point is near.
const NOBODY: u32 = u32::MAX;
/// The same among few points.
const NOBODY_OF_FEW: u16 = u16::MAX;
/// A block's coordinates are kept in this many bits each.
const BITS: u32 = 21;

/// Multiplies the key of a block, which comes from our own data.
#[derive(Default, Clone, Copy)]
struct KeyHasher(u64);

impl std::hash::Hasher for KeyHasher {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&b| self.write_u64(u64::from(b)));
    }
    fn write_u64(&mut self, key: u64) {
        let mixed = (self.0 ^ key).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = mixed ^ (mixed >> 32);
    }
}

type Blocks = HashMap<u64, u32, std::hash::BuildHasherDefault<KeyHasher>>;

/// For every place within a radius of some points, one of them that is nearest up to a voxel.
///
/// Holds indices only: the points stay where they are and must not change.
pub struct NearestMap {
    per_metre: f32,
    /// Lowest corner of the points' box: voxels are counted from there.
    origin: Point,
    blocks: Blocks,
    nearest: Indices,
}

/// Voxels are by far the most that is kept of a scan: small indices where they suffice.
enum Indices {
    /// Of points up to the 65 535th.
    Few(Vec<u16>),
    /// Of any points.
    Many(Vec<u32>),
}

impl Indices {
    /// Of nobody, in so many voxels of a map of so many points.
    fn new(voxels: usize, points: usize) -> Self {
        match points <= usize::from(NOBODY_OF_FEW) {
            true => Self::Few(vec![NOBODY_OF_FEW; voxels]),
            false => Self::Many(vec![NOBODY; voxels]),
        }
    }

    #[inline]
    fn set(&mut self, voxel: usize, index: u32) {
        match self {
            Self::Few(of) => of[voxel] = index as u16,
            Self::Many(of) => of[voxel] = index,
        }
    }

    #[inline]
    fn get(&self, voxel: usize) -> Option<usize> {
        match self {
            Self::Few(of) => (of[voxel] != NOBODY_OF_FEW).then_some(of[voxel].into()),
            Self::Many(of) => (of[voxel] != NOBODY).then_some(of[voxel] as usize),
        }
    }
}

impl NearestMap {
    /// Maps the space within `radius_m` (positive, metres) of `points` (finite, metres).
    pub fn new(points: &[Point], radius_m: f32) -> Self {
        let low = points.iter().fold(Point::from([f32::INFINITY; 3]), |c, p| c.inf(p));
        let origin =
            if points.is_empty() { Point::origin() } else { low - nalgebra::Vector3::repeat(radius_m) };
        let per_metre = VOXELS_PER_RADIUS / radius_m;
        let mut map =
            Self { per_metre, origin, blocks: Blocks::default(), nearest: Indices::Few(Vec::new()) };
        // Block by block: the blocks around are found once for all points of one.
        let mut order: Vec<([i32; 3], u32)> =
            points.iter().zip(0..).map(|(p, i)| (map.voxel(p).map(|v| v.div_euclid(SIDE)), i)).collect();
        order.sort_unstable();
        let of_blocks: Vec<_> = order.chunk_by(|one, other| one.0 == other.0).collect();
        let around: Vec<[u32; 27]> = of_blocks.iter().map(|of| map.blocks_around(of[0].0)).collect();
        map.blocks.shrink_to_fit();
        // What stays is allocated at its full size before what goes.
        let voxels = map.blocks.len() * BLOCK;
        map.nearest = Indices::new(voxels, points.len());
        let mut squared = vec![f32::INFINITY; voxels];
        for (of_block, around) in of_blocks.iter().zip(&around) {
            for &(block, i) in *of_block {
                map.offer(i, &points[i as usize], block, around, &mut squared);
            }
        }
        map
    }

    /// Voxel that a place lies in.
    #[inline]
    fn voxel(&self, place: &Point) -> [i32; 3] {
        let at = (place - self.origin) * self.per_metre;
        [at.x.floor() as i32, at.y.floor() as i32, at.z.floor() as i32]
    }

    /// Numbers of a block and its 26 neighbours, which are numbered where they are new.
    fn blocks_around(&mut self, block: [i32; 3]) -> [u32; 27] {
        std::array::from_fn(|n| {
            let n = n as i32;
            let at = [block[0] + n / 9 - 1, block[1] + n / 3 % 3 - 1, block[2] + n % 3 - 1];
            let next = self.blocks.len() as u32;
            *self.blocks.entry(key(at)).or_insert(next)
        })
    }

    /// Offers a point to all voxels that places within the radius of it lie in; of equally near
    /// points a voxel keeps the first offered.
    fn offer(&mut self, index: u32, p: &Point, block: [i32; 3], around: &[u32; 27], squared: &mut [f32]) {
        // In voxels from the corner of the blocks around, with centres at whole numbers.
        let corner = nalgebra::Vector3::from(block.map(|b| ((b - 1) * SIDE) as f32 + 0.5));
        let at = (p - self.origin) * self.per_metre - corner;
        let limit = REACH * REACH;
        let span = |a: usize| {
            let (low, high) = ((at[a] - REACH).ceil() as i32, (at[a] + REACH).floor() as i32);
            low.max(0)..=high.min(3 * SIDE - 1)
        };
        for x in span(0) {
            let dx = (x as f32 - at.x).powi(2);
            for y in span(1) {
                let dy = dx + (y as f32 - at.y).powi(2);
                if dy > limit {
                    continue;
                }
                let row = (x / SIDE * 9 + y / SIDE * 3) as usize;
                let within = ((x % SIDE * SIDE + y % SIDE) * SIDE) as usize;
                for z in span(2) {
                    let d = dy + (z as f32 - at.z).powi(2);
                    let voxel =
                        around[row + (z / SIDE) as usize] as usize * BLOCK + within + (z % SIDE) as usize;
                    if d < squared[voxel] && d <= limit {
                        squared[voxel] = d;
                        self.nearest.set(voxel, index);
                    }
                }
            }
        }
    }

    /// A point near a place: of the set given to [`Self::new`], the one nearest to the centre of the
    /// place's voxel. `None` where no point is within the radius; some that are found lie up to a
    /// voxel diagonal (0.58 radii) beyond it, which the caller tells by the distance.
    #[inline]
    pub fn near(&self, place: &Point) -> Option<usize> {
        let voxel = self.voxel(place);
        let block = voxel.map(|v| v.div_euclid(SIDE));
        let start = *self.blocks.get(&key(block))? as usize * BLOCK;
        let within = voxel.map(|v| v.rem_euclid(SIDE));
        self.nearest.get(start + ((within[0] * SIDE + within[1]) * SIDE + within[2]) as usize)
    }
}

/// A block's coordinates in one number; further apart than 2²¹ blocks they would share numbers,
/// which only ever costs a distance that turns out too large.
#[inline]
fn key(block: [i32; 3]) -> u64 {
    let mask = (1u64 << BITS) - 1;
    block.iter().fold(0, |key, &b| (key << BITS) | (b as u32 as u64 & mask))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn places(n: impl Into<prop::collection::SizeRange>) -> impl Strategy<Value = Vec<Point>> {
        prop::collection::vec((-1.5f32..1.5, -1.5f32..1.5, -1.5f32..1.5), n)
            .prop_map(|v| v.into_iter().map(|(x, y, z)| Point::new(x, y, z)).collect())
    }

    proptest! {
        #[test]
        fn what_is_found_is_a_voxel_diagonal_further_than_the_nearest_at_most(
            points in places(0..120), queries in places(1..60), radius_m in 0.02f32..0.9,
        ) {
            let map = NearestMap::new(&points, radius_m);
            let diagonal = 3f32.sqrt() * radius_m / VOXELS_PER_RADIUS;
            for q in &queries {
                // Independent of the map: every point is looked at.
                let least = points.iter().map(|p| (p - q).norm()).min_by(f32::total_cmp);
                match (map.near(q), least) {
                    (Some(i), Some(least)) => prop_assert!((points[i] - q).norm() <= least + diagonal + 1e-5),
                    (Some(_), None) => prop_assert!(false, "found a point of none"),
                    (None, least) => prop_assert!(least.is_none_or(|d| d > radius_m - 1e-5)),
                }
            }
        }
    }

    #[test]
    fn of_more_points_than_small_indices_count_every_one_is_found() {
        for n in [65_534, 65_535, 65_536, 70_000] {
            let row = |i: usize| Point::new((i % 300) as f32, (i / 300) as f32, 0.0);
            let points: Vec<Point> = (0..n).map(row).collect();
            let map = NearestMap::new(&points, 0.3);
            assert!((0..n).all(|i| map.near(&points[i]) == Some(i)), "of {n} points");
            assert_eq!(map.near(&Point::new(0.5, 0.5, 0.0)), None);
        }
    }

    #[test]
    fn points_far_apart_and_far_from_the_origin_are_found() {
        let points = [Point::new(-4000.0, 2.0, 900.0), Point::new(5000.0, -3000.0, 1000.0)];
        let map = NearestMap::new(&points, 0.07);
        assert_eq!(map.near(&points[0]), Some(0));
        assert_eq!(map.near(&points[1]), Some(1));
        assert_eq!(map.near(&Point::new(-4000.0, 2.5, 900.0)), None);
        assert_eq!(map.near(&Point::new(-9000.0, 2.0, 900.0)), None);
    }
}
