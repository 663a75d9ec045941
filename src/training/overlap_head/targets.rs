//! True overlap of many posed point sets at once.

use crate::Result;
use crate::geometry::Point;
use crate::scan::SimilarityMatrix;
use rayon::prelude::*;

/// Cells that one task counts; sums of whole numbers, so the split changes nothing.
const CELLS_PER_TASK: usize = 128;
/// Points measured before looking whether one of them was near.
const LANES: usize = 8;

/// Two-way overlap of all pairs of point sets in one frame: (points of i near j + points of j near
/// i) / (|i| + |j|), near meaning within `radius_m`; empty sets overlap nothing.
///
/// One grid holds the points of all sets. The neighbourhood of a cell is gathered once for all its
/// points and grouped by set, so that a point stops at the first hit of each set: the cost grows
/// with points times the sets around them, not with points times points, nor with pairs of sets.
/// Sets that share an eighth of a cell with a point are near it without being measured.
///
/// # Errors
/// None for finite points.
pub fn overlap_matrix(sets: &[Vec<Point>], radius_m: f32) -> Result<SimilarityMatrix> {
    let n = sets.len();
    let grid = OwnedGrid::new(sets, radius_m);
    let counts = grid
        .cells
        .par_chunks(CELLS_PER_TASK)
        .map(|cells| {
            let mut counts = vec![0u32; n * n];
            let mut around = Around::new(n);
            for cell in cells {
                around.gather(&grid, cell);
                for points in grid.eighths(cell) {
                    around.meet(points);
                    points.iter().for_each(|p| around.count(p, radius_m, &mut counts));
                }
            }
            counts
        })
        .reduce_with(|mut a, b| {
            a.iter_mut().zip(&b).for_each(|(x, y)| *x += y);
            a
        })
        .unwrap_or_else(|| vec![0; n * n]);
    let mut values = vec![0.0f32; n * n];
    for i in 0..n {
        for j in (0..n).filter(|&j| j != i) {
            let total = (sets[i].len() + sets[j].len()).max(1);
            values[i * n + j] = (f64::from(counts[i * n + j] + counts[j * n + i]) / total as f64) as f32;
        }
    }
    SimilarityMatrix::new(n, values)
}

/// Points of all sets, sorted by grid cell, within a cell by its eighths, and there by set.
struct OwnedGrid {
    points: Vec<(Point, u32)>,
    /// Key of the cell and number of the eighth of every point.
    keys: Vec<u64>,
    /// Cells in the order of their keys, so that those of equal x and y lie side by side.
    cells: Vec<Cell>,
}

struct Cell {
    /// Coordinates side by side, without the bits of the eighths.
    key: u64,
    start: usize,
    end: usize,
}

/// Bits of a cell coordinate in a key: a million cells a side, far beyond single precision.
const BITS: u32 = 20;
/// Edge of an eighth of a cell in radii: a little below 1/√3, so that points in the same eighth are
/// within the radius whatever was rounded (in scenes up to ten thousand radii wide), and cells,
/// two of them wide, are wider than the radius.
const EIGHTH: f32 = 0.575;

impl OwnedGrid {
    /// Cells wider than the radius: what is near a point lies in its own cell or the 26 around.
    fn new(sets: &[Vec<Point>], radius_m: f32) -> Self {
        let mut low = [f32::INFINITY; 3];
        sets.iter().flatten().for_each(|p| (0..3).for_each(|a| low[a] = low[a].min(p[a])));
        let width = EIGHTH * radius_m;
        let key = |p: &Point| {
            let halves: [u64; 3] = std::array::from_fn(|a| ((p[a] - low[a]) / width) as u64);
            // One free cell below the lowest and above the highest, for the neighbours.
            let [x, y, z] = halves.map(|h| (h >> 1).min((1 << BITS) - 3) + 1);
            let eighth = halves.iter().fold(0, |bits, h| bits << 1 | (h & 1));
            (x << (2 * BITS) | y << BITS | z) << 3 | eighth
        };
        let flat: Vec<(Point, u32)> =
            (0u32..).zip(sets).flat_map(|(owner, set)| set.iter().map(move |&p| (p, owner))).collect();
        let mut keyed: Vec<(u64, u32)> = (0u32..).zip(&flat).map(|(i, (p, _))| (key(p), i)).collect();
        keyed.par_sort_unstable();
        let points = keyed.iter().map(|&(_, i)| flat[i as usize]).collect();
        let mut cells: Vec<Cell> = Vec::new();
        for (i, &(key, _)) in keyed.iter().enumerate() {
            match cells.last_mut() {
                Some(last) if last.key == key >> 3 => last.end = i + 1,
                _ => cells.push(Cell { key: key >> 3, start: i, end: i + 1 }),
            }
        }
        Self { points, keys: keyed.into_iter().map(|(key, _)| key).collect(), cells }
    }

    /// The points of a cell, those of every eighth together.
    fn eighths(&self, cell: &Cell) -> impl Iterator<Item = &[(Point, u32)]> {
        let mut start = cell.start;
        self.keys[cell.start..cell.end].chunk_by(|a, b| a == b).map(move |keys| {
            start += keys.len();
            &self.points[start - keys.len()..start]
        })
    }

    /// The points of the 27 cells in and around `cell`: a range for every column of three.
    fn neighbourhood(&self, cell: &Cell) -> [&[(Point, u32)]; 9] {
        let key = cell.key - (1 << (2 * BITS)) - (1 << BITS);
        std::array::from_fn(|column| {
            let middle = key + ((column as u64 / 3) << (2 * BITS)) + ((column as u64 % 3) << BITS);
            let first = self.cells.partition_point(|c| c.key < middle - 1);
            let near = self.cells[first..].iter().take_while(|c| c.key <= middle + 1);
            near.fold(None, |range: Option<(usize, usize)>, c| Some((range.map_or(c.start, |r| r.0), c.end)))
                .map_or(&[][..], |(start, end)| &self.points[start..end])
        })
    }
}

/// Points in and around one cell, grouped by set.
struct Around {
    /// Coordinates one after another, so that several points are measured at once.
    xyz: [Vec<f32>; 3],
    /// Set, and where its points lie.
    groups: Vec<(u32, std::ops::Range<usize>)>,
    /// For every set, where its next point goes.
    next: Vec<usize>,
    /// For every set, whether it is near all points that are looked at.
    met: Vec<bool>,
}

impl Around {
    fn new(n: usize) -> Self {
        Self { xyz: Default::default(), groups: Vec::new(), next: vec![0; n], met: vec![false; n] }
    }

    /// Counting sort by set.
    fn gather(&mut self, grid: &OwnedGrid, cell: &Cell) {
        let columns = grid.neighbourhood(cell);
        self.next.fill(0);
        for &(_, owner) in columns.into_iter().flatten() {
            self.next[owner as usize] += 1;
        }
        self.groups.clear();
        let mut start = 0;
        for (owner, next) in (0u32..).zip(self.next.iter_mut()) {
            let end = start + *next;
            if end > start {
                self.groups.push((owner, start..end));
            }
            *next = start;
            start = end;
        }
        self.xyz.iter_mut().for_each(|axis| axis.resize(start, 0.0));
        let [xs, ys, zs] = &mut self.xyz;
        for &(point, owner) in columns.into_iter().flatten() {
            let slot = &mut self.next[owner as usize];
            (xs[*slot], ys[*slot], zs[*slot]) = (point.x, point.y, point.z);
            *slot += 1;
        }
    }

    /// Notes whose points these are, all of them within the radius of each other.
    fn meet(&mut self, points: &[(Point, u32)]) {
        self.met.fill(false);
        points.iter().for_each(|&(_, owner)| self.met[owner as usize] = true);
    }

    /// Adds one to the count of (own set, other set) for every set with a point near this one.
    fn count(&self, (point, own): &(Point, u32), radius_m: f32, counts: &mut [u32]) {
        let limit = radius_m * radius_m;
        let row = *own as usize * self.next.len();
        let [xs, ys, zs] = &self.xyz;
        for (owner, range) in &self.groups {
            if self.met[*owner as usize] {
                counts[row + *owner as usize] += 1;
                continue;
            }
            let chunks = xs[range.clone()].chunks(LANES).zip(ys[range.clone()].chunks(LANES));
            let hit = chunks.zip(zs[range.clone()].chunks(LANES)).any(|((x, y), z)| {
                // Without a way out inside a chunk, so that it compiles to vector instructions.
                x.iter().zip(y).zip(z).fold(false, |hit, ((x, y), z)| {
                    let (x, y, z) = (x - point.x, y - point.y, z - point.z);
                    hit | (x * x + y * y + z * z <= limit)
                })
            });
            counts[row + *owner as usize] += u32::from(hit);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::RadiusGrid;
    use crate::geometry::RigidMotion;
    use crate::geometry::two_way_overlap;
    use crate::random::generator;
    use rand::RngExt;

    #[test]
    fn all_pairs_at_once_equal_the_pairwise_overlap() {
        let mut rng = generator(3, "test", 0);
        let sets: Vec<Vec<Point>> = (0..7)
            .map(|i| {
                let mut draw = |from: f32| rng.random_range(from..from + 1.0);
                (0..i * 60).map(|_| Point::new(draw(0.2 * i as f32), draw(0.0), draw(0.0))).collect()
            })
            .collect();
        let all = overlap_matrix(&sets, 0.1).unwrap();
        let mut positive = 0;
        for i in 0..7 {
            for j in (0..7).filter(|&j| j != i) {
                let (a, b) = (RadiusGrid::new(&sets[i], 0.1), RadiusGrid::new(&sets[j], 0.1));
                let pair = two_way_overlap(&a, &b, &RigidMotion::identity()).ratio;
                assert!((f64::from(all.get(i, j)) - pair).abs() < 1e-6, "{i} {j}");
                positive += usize::from(pair > 0.0);
            }
        }
        assert!(positive > 10);
    }
}
