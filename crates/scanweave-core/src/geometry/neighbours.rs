//! Nearest and fixed-radius neighbours of 3-D points.

use super::{Point, RigidMotion};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use std::collections::HashMap;
use std::num::NonZero;

/// A static k-d tree over points; answers are indices into the slice it was built from.
pub struct PointIndex {
    tree: Option<ImmutableKdTree<f32, 3>>,
    len: usize,
}

impl PointIndex {
    /// Indexes `points` (finite, metres). An empty slice gives an index that finds nothing.
    pub fn new(points: &[Point]) -> Self {
        let entries: Vec<[f32; 3]> = points.iter().map(|p| [p.x, p.y, p.z]).collect();
        let tree = if entries.is_empty() { None } else { ImmutableKdTree::new_from_slice(&entries).ok() };
        Self { tree, len: points.len() }
    }

    /// Number of indexed points.
    pub fn len(&self) -> usize {
        self.len
    }

    /// True when there is nothing to find.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The nearest point and its squared distance (m²).
    pub fn nearest(&self, query: &Point) -> Option<(usize, f32)> {
        let hit = self
            .tree
            .as_ref()?
            .query(&[query.x, query.y, query.z])
            .nearest_one::<SquaredEuclidean<f32>>()
            .execute();
        Some((hit.item as usize, hit.distance))
    }

    /// The `count` nearest points with their squared distances (m²), nearest first.
    pub fn nearest_n(&self, query: &Point, count: usize) -> Vec<(usize, f32)> {
        let (Some(tree), Some(count)) = (&self.tree, NonZero::new(count.min(self.len))) else {
            return Vec::new();
        };
        tree.query(&[query.x, query.y, query.z])
            .nearest_n::<SquaredEuclidean<f32>>(count)
            .execute()
            .into_iter()
            .map(|hit| (hit.item as usize, hit.distance))
            .collect()
    }

    /// All points within `radius_m`, with squared distances (m²), ordered by index.
    pub fn within(&self, query: &Point, radius_m: f32) -> Vec<(usize, f32)> {
        let Some(tree) = &self.tree else { return Vec::new() };
        let mut hits: Vec<(usize, f32)> = tree
            .query(&[query.x, query.y, query.z])
            .within::<SquaredEuclidean<f32>>(radius_m * radius_m)
            .unsorted()
            .execute()
            .into_iter()
            .map(|hit| (hit.item as usize, hit.distance))
            .collect();
        hits.sort_unstable_by_key(|hit| hit.0);
        hits
    }
}

/// Fixed-radius neighbours by a hashed grid: no search where nothing is near.
///
/// Cells are twice the radius wide, so a query looks into eight of them.
pub struct RadiusGrid<'a> {
    points: &'a [Point],
    radius_m: f32,
    cells: HashMap<[i32; 3], (u32, u32), CellHasher>,
    /// Points in the order of their cells, and their coordinates in that order, axis by axis.
    order: Vec<u32>,
    coordinates: [Vec<f32>; 3],
    /// Box around the points, grown by the radius: nothing outside it has a neighbour.
    reach: (Point, Point),
}

#[derive(Default, Clone, Copy)]
struct CellHasher;

impl std::hash::BuildHasher for CellHasher {
    type Hasher = CellHash;
    fn build_hasher(&self) -> CellHash {
        CellHash(0)
    }
}

/// Multiply-and-rotate hash of three cell coordinates (the keys come from our own data).
struct CellHash(u64);

impl std::hash::Hasher for CellHash {
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 29)
    }
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&b| self.write_i32(i32::from(b)));
    }
    fn write_i32(&mut self, v: i32) {
        self.0 = (self.0.rotate_left(23) ^ u64::from(v as u32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
    fn write_usize(&mut self, _: usize) {}
}

fn cell_of(p: &Point, width: f32) -> [i32; 3] {
    [(p.x / width).floor() as i32, (p.y / width).floor() as i32, (p.z / width).floor() as i32]
}

impl<'a> RadiusGrid<'a> {
    /// Indexes `points` (finite, metres) for queries of up to `radius_m` (positive).
    pub fn new(points: &'a [Point], radius_m: f32) -> Self {
        let width = 2.0 * radius_m;
        let mut keyed: Vec<([i32; 3], u32)> =
            points.iter().enumerate().map(|(i, p)| (cell_of(p, width), i as u32)).collect();
        keyed.sort_unstable();
        let mut cells = HashMap::with_capacity_and_hasher(keyed.len() / 2 + 1, CellHasher);
        let mut start = 0;
        for i in 1..=keyed.len() {
            if i == keyed.len() || keyed[i].0 != keyed[start].0 {
                cells.insert(keyed[start].0, (start as u32, i as u32));
                start = i;
            }
        }
        let grown = nalgebra::Vector3::repeat(radius_m);
        let reach = points.iter().fold(
            (Point::from([f32::INFINITY; 3]), Point::from([f32::NEG_INFINITY; 3])),
            |(low, high), p| (low.inf(&(p - grown)), high.sup(&(p + grown))),
        );
        let order: Vec<u32> = keyed.into_iter().map(|(_, i)| i).collect();
        let coordinates = [0, 1, 2].map(|axis| order.iter().map(|&i| points[i as usize][axis]).collect());
        Self { points, radius_m, cells, order, coordinates, reach }
    }

    /// The indexed points.
    pub fn points(&self) -> &'a [Point] {
        self.points
    }

    /// The radius of every query, metres.
    pub fn radius_m(&self) -> f32 {
        self.radius_m
    }

    /// Whether nothing of `other`, moved by `self_from_other`, can be within this grid's radius of a
    /// point: their boxes' spheres do not meet.
    pub fn apart_from(&self, other: &RadiusGrid<'_>, self_from_other: &RigidMotion) -> bool {
        let sphere = |g: &RadiusGrid<'_>| {
            let (low, high) = (g.reach.0.cast::<f64>(), g.reach.1.cast::<f64>());
            (nalgebra::center(&low, &high), (high - low).norm() / 2.0)
        };
        let ((here, one), (there, two)) = (sphere(self), sphere(other));
        (here - self_from_other * there).norm() > one + two
    }

    /// Calls `visit(index, squared distance)` for every point within the radius.
    #[inline]
    pub fn for_each_within(&self, query: &Point, mut visit: impl FnMut(usize, f32)) {
        let r = self.radius_m;
        let limit = r * r;
        let (low, high) = &self.reach;
        if (0..3).any(|a| query[a] < low[a] || query[a] > high[a]) {
            return;
        }
        let low = cell_of(&Point::new(query.x - r, query.y - r, query.z - r), 2.0 * r);
        let high = cell_of(&Point::new(query.x + r, query.y + r, query.z + r), 2.0 * r);
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    let Some(&(start, end)) = self.cells.get(&[x, y, z]) else { continue };
                    self.visit_within(query, limit, start as usize..end as usize, &mut visit);
                }
            }
        }
    }

    /// Those of the points at these places of the order whose squared distance is at most `limit`.
    #[inline(always)]
    fn visit_within(
        &self,
        query: &Point,
        limit: f32,
        places: std::ops::Range<usize>,
        visit: &mut impl FnMut(usize, f32),
    ) {
        /// Points whose distances are computed side by side.
        const LANES: usize = 8;
        let order = &self.order[places.clone()];
        let [x, y, z] = [0, 1, 2].map(|axis| &self.coordinates[axis][places.clone()]);
        let squared = |x: f32, y: f32, z: f32| {
            let (dx, dy, dz) = (x - query.x, y - query.y, z - query.z);
            dx * dx + dy * dy + dz * dz
        };
        let ((xs, x), (ys, y), (zs, z)) =
            (x.as_chunks::<LANES>(), y.as_chunks::<LANES>(), z.as_chunks::<LANES>());
        let (orders, order) = order.as_chunks::<LANES>();
        for (((order, x), y), z) in orders.iter().zip(xs).zip(ys).zip(zs) {
            let d: [f32; LANES] = std::array::from_fn(|l| squared(x[l], y[l], z[l]));
            let mut near = (0..LANES).map(|l| u32::from(d[l] <= limit) << l).sum::<u32>();
            while near != 0 {
                let l = near.trailing_zeros() as usize;
                near &= near - 1;
                visit(order[l] as usize, d[l]);
            }
        }
        for (((&i, &x), &y), &z) in order.iter().zip(x).zip(y).zip(z) {
            let d = squared(x, y, z);
            if d <= limit {
                visit(i as usize, d);
            }
        }
    }

    /// The nearest point within the radius and its squared distance; ties go to the lower index.
    #[inline]
    pub fn nearest(&self, query: &Point) -> Option<(usize, f32)> {
        let mut best: Option<(usize, f32)> = None;
        self.for_each_within(query, |i, d| {
            if best.is_none_or(|(bi, bd)| d < bd || (d == bd && i < bi)) {
                best = Some((i, d));
            }
        });
        best
    }

    /// True when a point lies within the radius.
    pub fn any(&self, query: &Point) -> bool {
        self.nearest(query).is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn brute(points: &[Point], q: &Point, r: f32) -> Vec<usize> {
        (0..points.len()).filter(|&i| (points[i] - q).norm_squared() <= r * r).collect()
    }

    fn cloud() -> impl Strategy<Value = Vec<Point>> {
        prop::collection::vec((-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0), 0..200)
            .prop_map(|v| v.into_iter().map(|(x, y, z)| Point::new(x, y, z)).collect())
    }

    proptest! {
        #[test]
        fn grid_and_tree_agree_with_brute_force(points in cloud(), q in (-1.5f32..1.5, -1.5f32..1.5, -1.5f32..1.5), r in 0.01f32..0.8) {
            let q = Point::new(q.0, q.1, q.2);
            let expected = brute(&points, &q, r);
            let grid = RadiusGrid::new(&points, r);
            let mut from_grid = Vec::new();
            grid.for_each_within(&q, |i, _| from_grid.push(i));
            from_grid.sort_unstable();
            prop_assert_eq!(&from_grid, &expected);
            let tree = PointIndex::new(&points);
            // The tree's radius test is exact up to the rounding of r².
            let from_tree: Vec<usize> = tree.within(&q, r).into_iter().map(|h| h.0).collect();
            prop_assert_eq!(&from_tree, &expected);
            let nearest = expected.iter().map(|&i| (points[i] - q).norm_squared()).min_by(f32::total_cmp);
            prop_assert_eq!(grid.nearest(&q).map(|h| h.1), nearest);
            let all = (0..points.len()).map(|i| (points[i] - q).norm_squared()).min_by(f32::total_cmp);
            prop_assert_eq!(tree.nearest(&q).map(|h| h.1), all);
        }
    }

    #[test]
    fn a_thousand_copies_of_one_point_are_all_found() {
        // k-d trees may overflow a leaf when many points share a coordinate.
        let points = vec![Point::new(0.5, 0.5, 0.5); 1000];
        let tree = PointIndex::new(&points);
        assert_eq!(tree.within(&points[0], 0.1).len(), 1000);
        let grid = RadiusGrid::new(&points, 0.1);
        assert_eq!(grid.nearest(&points[0]), Some((0, 0.0)));
    }

    #[test]
    fn an_empty_index_finds_nothing() {
        let q = Point::origin();
        assert!(PointIndex::new(&[]).nearest(&q).is_none());
        assert!(PointIndex::new(&[]).within(&q, 1.0).is_empty());
        assert!(PointIndex::new(&[]).nearest_n(&q, 3).is_empty());
        assert!(RadiusGrid::new(&[], 1.0).nearest(&q).is_none());
    }
}
