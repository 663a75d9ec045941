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
/// Rows of voxels of a block.
const ROWS: usize = (SIDE * SIDE) as usize;
/// Something of every voxel of a row.
type Row<T> = [T; SIDE as usize];
/// No point is near.
pub const NO_POINT: u32 = u32::MAX;
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

/// Which blocks are kept, and the number of each.
enum Blocks {
    /// Of blocks close together: those of a box, one a bit, in an order in which the last coordinate runs
    /// fastest. A block's number is that of the bits before it.
    Boxed {
        low: [i32; 3],
        size: [u32; 3],
        /// The bits, and how many are set in the words before.
        words: Vec<(u64, u32)>,
    },
    /// Of blocks far apart.
    Scattered(HashMap<u64, u32, std::hash::BuildHasherDefault<KeyHasher>>),
}

impl Blocks {
    /// The blocks of points and all their neighbours.
    fn around(of_points: impl Iterator<Item = [i32; 3]> + Clone) -> Self {
        /// Blocks of the box for every one with points, at most: a bit each, which is little beside its voxels.
        const ROOMY: u64 = 1024;
        let Some(first) = of_points.clone().next() else { return Self::Scattered(HashMap::default()) };
        let (mut low, mut high, mut count) = (first, first, 0);
        for block in of_points.clone() {
            low = std::array::from_fn(|a| low[a].min(block[a]));
            high = std::array::from_fn(|a| high[a].max(block[a]));
            count += 1;
        }
        let low = low.map(|l| l.saturating_sub(1));
        let size: [u32; 3] = std::array::from_fn(|a| high[a].abs_diff(low[a]).saturating_add(2));
        let volume = size.iter().fold(1u64, |v, &s| v.saturating_mul(s.into()));
        if volume > ROOMY * count {
            let mut numbers = HashMap::default();
            for block in of_points.flat_map(neighbours) {
                let next = numbers.len() as u32;
                numbers.entry(key(block)).or_insert(next);
            }
            numbers.shrink_to_fit();
            return Self::Scattered(numbers);
        }
        let mut words = vec![(0u64, 0u32); volume.div_ceil(64) as usize];
        for block in of_points.flat_map(neighbours) {
            if let Some(bit) = bit(block, low, size) {
                words[bit / 64].0 |= 1 << (bit % 64);
            }
        }
        let mut before = 0;
        for word in &mut words {
            word.1 = before;
            before += word.0.count_ones();
        }
        Self::Boxed { low, size, words }
    }

    fn len(&self) -> usize {
        match self {
            Self::Boxed { words, .. } => words.last().map_or(0, |w| w.1 + w.0.count_ones()) as usize,
            Self::Scattered(numbers) => numbers.len(),
        }
    }

    /// Number of a block that is kept.
    #[inline(always)]
    fn get(&self, block: [i32; 3]) -> Option<u32> {
        match self {
            Self::Boxed { low, size, words } => {
                let bit = bit(block, *low, *size)?;
                let (word, before) = words[bit / 64];
                let at = 1u64 << (bit % 64);
                (word & at != 0).then(|| before + (word & (at - 1)).count_ones())
            }
            Self::Scattered(numbers) => numbers.get(&key(block)).copied(),
        }
    }
}

/// A block and the 26 around it.
fn neighbours(block: [i32; 3]) -> [[i32; 3]; 27] {
    std::array::from_fn(|n| {
        let n = n as i32;
        [block[0] + n / 9 - 1, block[1] + n / 3 % 3 - 1, block[2] + n % 3 - 1]
    })
}

/// Place of a block among those of a box.
#[inline(always)]
fn bit(block: [i32; 3], low: [i32; 3], size: [u32; 3]) -> Option<usize> {
    let at: [u32; 3] = std::array::from_fn(|a| block[a].wrapping_sub(low[a]) as u32);
    let within = at[0] < size[0] && at[1] < size[1] && at[2] < size[2];
    within.then(|| (at[0] as usize * size[1] as usize + at[1] as usize) * size[2] as usize + at[2] as usize)
}

/// The largest whole number that is no greater; the same as `floor`, which is a call on processors
/// of the baseline.
#[inline(always)]
fn whole(x: f32) -> i32 {
    let truncated = x as i32;
    truncated.saturating_sub(i32::from(truncated as f32 > x))
}

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
    Few(Vec<Row<u16>>),
    /// Of any points.
    Many(Vec<Row<u32>>),
}

impl Indices {
    #[inline]
    fn get(&self, row: usize, voxel: usize) -> Option<usize> {
        match self {
            Self::Few(of) => Some(of[row][voxel]).filter(|&i| i != NOBODY_OF_FEW).map(usize::from),
            Self::Many(of) => Some(of[row][voxel]).filter(|&i| i != NO_POINT).map(|i| i as usize),
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
        let blocks = Blocks::Scattered(HashMap::default());
        let mut map = Self { per_metre, origin, blocks, nearest: Indices::Few(Vec::new()) };
        // Block by block: the blocks around are found once for all points of one.
        let mut order: Vec<([i32; 3], u32)> =
            points.iter().zip(0..).map(|(p, i)| (map.voxel(p).map(|v| v.div_euclid(SIDE)), i)).collect();
        order.sort_unstable();
        let of_blocks: Vec<_> = order.chunk_by(|one, other| one.0 == other.0).collect();
        map.blocks = Blocks::around(of_blocks.iter().map(|of| of[0].0));
        let nearest = map.fill(points, &of_blocks);
        map.nearest = match points.len() <= usize::from(NOBODY_OF_FEW) {
            // Nobody of many is nobody of few, cut short.
            true => Indices::Few(nearest.into_iter().map(|row| row.map(|i| i as u16)).collect()),
            false => Indices::Many(nearest),
        };
        map
    }

    /// The nearest point of every voxel.
    fn fill(&self, points: &[Point], of_blocks: &[&[([i32; 3], u32)]]) -> Vec<Row<u32>> {
        let rows = self.blocks.len() * ROWS;
        let mut nearest = vec![[NO_POINT; SIDE as usize]; rows];
        // What is nearer than this is within reach.
        let mut squared = vec![[(REACH * REACH).next_up(); SIDE as usize]; rows];
        for of_block in of_blocks {
            // All of them are kept.
            let around = neighbours(of_block[0].0).map(|block| self.blocks.get(block).unwrap_or(0));
            for &(block, i) in *of_block {
                self.offer(&points[i as usize], block, &around, |row, squares| {
                    // Four voxels at once, without a branch: which are nearer is anybody's guess.
                    let (before, whose) = (squared[row], nearest[row]);
                    squared[row] =
                        std::array::from_fn(|v| if squares[v] < before[v] { squares[v] } else { before[v] });
                    nearest[row] = std::array::from_fn(|v| if squares[v] < before[v] { i } else { whose[v] });
                });
            }
        }
        nearest
    }

    /// Voxel that a place lies in.
    #[inline(always)]
    fn voxel(&self, place: &Point) -> [i32; 3] {
        let at = (place - self.origin) * self.per_metre;
        [whole(at.x), whole(at.y), whole(at.z)]
    }

    /// Calls `offer(row, squared distances from the centres of its voxels)` for all rows of voxels that
    /// places within the radius of a point may lie in.
    #[inline(always)]
    fn offer(&self, p: &Point, block: [i32; 3], around: &[u32; 27], mut offer: impl FnMut(usize, Row<f32>)) {
        // In voxels from the corner of the blocks around, with centres at whole numbers.
        let corner = nalgebra::Vector3::from(block.map(|b| ((b - 1) * SIDE) as f32 + 0.5));
        let at = (p - self.origin) * self.per_metre - corner;
        let away = |a: usize| -> [f32; 3 * SIDE as usize] {
            std::array::from_fn(|v| (v as f32 - at[a]) * (v as f32 - at[a]))
        };
        let [xs, ys, zs] = [0, 1, 2].map(away);
        for (x, dx) in xs.into_iter().enumerate() {
            for (y, dy) in ys.into_iter().enumerate() {
                let dy = dx + dy;
                if dy > REACH * REACH {
                    continue;
                }
                let column = x / SIDE as usize * 9 + y / SIDE as usize * 3;
                let within = x % SIDE as usize * SIDE as usize + y % SIDE as usize;
                for (z, dz) in zs.as_chunks().0.iter().enumerate() {
                    offer(around[column + z] as usize * ROWS + within, dz.map(|dz| dy + dz));
                }
            }
        }
    }

    /// A point near a place: of the set given to [`Self::new`], the one nearest to the centre of the
    /// place's voxel. `None` where no point is within the radius; some that are found lie up to a
    /// voxel diagonal (0.58 radii) beyond it, which the caller tells by the distance.
    #[inline]
    pub fn near(&self, place: &Point) -> Option<usize> {
        let (row, voxel) = self.row_and_voxel(place)?;
        self.nearest.get(row, voxel)
    }

    /// [`Self::near`] of every place, [`NO_POINT`] for `None`. Maps lie in distant memory: here it is not
    /// waited for one place at a time.
    pub fn near_each(&self, places: &[Point]) -> Vec<u32> {
        const NOWHERE: usize = usize::MAX;
        let side = SIDE as usize;
        let number = |p| self.row_and_voxel(p).map_or(NOWHERE, |(row, voxel)| row * side + voxel);
        // Bits are counted and numbers rounded by instructions that not every processor has.
        let voxels: Vec<usize> = pulp::Arch::new().dispatch(
            #[inline(always)]
            || places.iter().map(number).collect(),
        );
        fn each<T: Copy>(of: &[Row<T>], voxels: &[usize], nobody: T) -> impl Iterator<Item = T> {
            let of = of.as_flattened();
            let last = of.len().saturating_sub(1);
            // Read from somewhere in any case: a branch would be guessed wrongly and wait.
            voxels.iter().map(move |&v| {
                let there = of.get(v.min(last)).copied().unwrap_or(nobody);
                if v == NOWHERE { nobody } else { there }
            })
        }
        match &self.nearest {
            Indices::Few(of) => each(of, &voxels, NOBODY_OF_FEW)
                .map(|i| if i == NOBODY_OF_FEW { NO_POINT } else { u32::from(i) })
                .collect(),
            Indices::Many(of) => each(of, &voxels, NO_POINT).collect(),
        }
    }

    /// Row of voxels and voxel of it that a place lies in, where these are kept.
    #[inline(always)]
    fn row_and_voxel(&self, place: &Point) -> Option<(usize, usize)> {
        let voxel = self.voxel(place);
        let block = voxel.map(|v| v.div_euclid(SIDE));
        let start = self.blocks.get(block)? as usize * ROWS;
        let within = voxel.map(|v| v.rem_euclid(SIDE));
        Some((start + (within[0] * SIDE + within[1]) as usize, within[2] as usize))
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
                let each = map.near_each(std::slice::from_ref(q));
                prop_assert_eq!(each, vec![map.near(q).map_or(NO_POINT, |i| i as u32)]);
                match (map.near(q), least) {
                    (Some(i), Some(least)) => prop_assert!((points[i] - q).norm() <= least + diagonal + 1e-5),
                    (Some(_), None) => prop_assert!(false, "found a point of none"),
                    (None, least) => prop_assert!(least.is_none_or(|d| d > radius_m - 1e-5)),
                }
            }
        }
    }

    proptest! {
        #[test]
        fn blocks_in_a_box_and_scattered_ones_give_the_same(
            points in places(1..120), queries in places(1..60), radius_m in 0.3f32..0.9,
        ) {
            let close = NearestMap::new(&points, radius_m);
            // Higher in every coordinate, so that voxels are counted from the same corner.
            let mut with_one_far_away = points.clone();
            with_one_far_away.push(Point::new(1e4, 1e4, 1e4));
            let scattered = NearestMap::new(&with_one_far_away, radius_m);
            let boxed = |map: &NearestMap| matches!(map.blocks, Blocks::Boxed { .. });
            prop_assert_eq!((boxed(&close), boxed(&scattered)), (true, false));
            for q in &queries {
                prop_assert_eq!(close.near(q), scattered.near(q));
            }
        }
    }

    #[test]
    fn whole_numbers_are_those_of_floor() {
        for x in [-3.0f32, -2.5, -0.0, 0.0, 0.5, 2.0, 2.9999998, -1e-30, 1e9, -1e9, 1e30, -1e30, f32::NAN] {
            assert_eq!(whole(x), x.floor() as i32, "{x}");
        }
    }

    #[test]
    fn of_more_points_than_small_indices_count_every_one_is_found() {
        for n in [65_534, 65_535, 65_536, 70_000] {
            let row = |i: usize| Point::new((i % 300) as f32, (i / 300) as f32, 0.0);
            let points: Vec<Point> = (0..n).map(row).collect();
            let map = NearestMap::new(&points, 0.3);
            assert!((0..n).all(|i| map.near(&points[i]) == Some(i)), "of {n} points");
            let each = map.near_each(&points);
            assert!(each.into_iter().eq(0..n as u32), "of {n} points");
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
