//! True overlap of many posed point sets at once.

use crate::error::Result;
use crate::geometry::Point;
use crate::scan::SimilarityMatrix;
use rayon::prelude::*;

/// Cells that one task counts; sums of whole numbers, so the split changes nothing.
const CELLS_PER_TASK: usize = 128;

/// Two-way overlap of all pairs of point sets in one frame: (points of i near j + points of j near
/// i) / (|i| + |j|), near meaning within `radius_m`; empty sets overlap nothing.
///
/// One grid holds the points of all sets. The neighbourhood of a cell is gathered once for all its
/// points and grouped by set, so that a point stops at the first hit of each set: the cost grows
/// with points times the sets around them, not with points times points, nor with pairs of sets.
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
                grid.points[cell.start..cell.end].iter().for_each(|p| around.count(p, radius_m, &mut counts));
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

/// Points of all sets, sorted by grid cell and within a cell by set.
struct OwnedGrid {
    points: Vec<(Point, u32)>,
    /// Cells in lexicographic order, so that those of equal x and y lie side by side.
    cells: Vec<Cell>,
}

struct Cell {
    at: [i32; 3],
    start: usize,
    end: usize,
}

impl OwnedGrid {
    /// Cells as wide as the radius: what is near a point lies in its own cell or the 26 around.
    fn new(sets: &[Vec<Point>], radius_m: f32) -> Self {
        let cell = |p: &Point| [p.x, p.y, p.z].map(|v| (v / radius_m).floor() as i32);
        let mut keyed: Vec<([i32; 3], u32, u32)> = (0u32..)
            .zip(sets)
            .flat_map(|(owner, set)| (0u32..).zip(set).map(move |(i, p)| (cell(p), owner, i)))
            .collect();
        keyed.par_sort_unstable();
        let points = keyed.iter().map(|&(_, o, i)| (sets[o as usize][i as usize], o)).collect();
        let mut cells: Vec<Cell> = Vec::new();
        for (i, &(at, ..)) in keyed.iter().enumerate() {
            match cells.last_mut() {
                Some(last) if last.at == at => last.end = i + 1,
                _ => cells.push(Cell { at, start: i, end: i + 1 }),
            }
        }
        Self { points, cells }
    }

    /// The 27 cells in and around `cell` that hold points, as ranges; the cell itself first.
    fn neighbourhood<'a>(&'a self, cell: &'a Cell) -> impl Iterator<Item = std::ops::Range<usize>> + 'a {
        let [x, y, z] = cell.at;
        let columns = (-1..=1).flat_map(move |dx| (-1..=1).map(move |dy| [x + dx, y + dy]));
        let others = columns.flat_map(move |[x, y]| {
            let first = self.cells.partition_point(|c| c.at < [x, y, z - 1]);
            self.cells[first..].iter().take_while(move |c| c.at <= [x, y, z + 1])
        });
        let others = others.filter(|c| c.at != cell.at);
        std::iter::once(cell).chain(others).map(|c| c.start..c.end)
    }
}

/// Points in and around one cell, grouped by set.
struct Around {
    points: Vec<Point>,
    /// Set, and where its points lie.
    groups: Vec<(u32, std::ops::Range<usize>)>,
    /// For every set, where its next point goes.
    next: Vec<usize>,
}

impl Around {
    fn new(n: usize) -> Self {
        Self { points: Vec::new(), groups: Vec::new(), next: vec![0; n] }
    }

    /// Counting sort by set. The cell's own points lead every group: they are the likeliest hits.
    fn gather(&mut self, grid: &OwnedGrid, cell: &Cell) {
        let ranges: Vec<std::ops::Range<usize>> = grid.neighbourhood(cell).collect();
        let near = || ranges.iter().flat_map(|r| &grid.points[r.clone()]);
        self.next.fill(0);
        near().for_each(|&(_, owner)| self.next[owner as usize] += 1);
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
        self.points.resize(start, Point::origin());
        for &(point, owner) in near() {
            let slot = &mut self.next[owner as usize];
            self.points[*slot] = point;
            *slot += 1;
        }
    }

    /// Adds one to the count of (own set, other set) for every set with a point near this one.
    fn count(&self, (point, own): &(Point, u32), radius_m: f32, counts: &mut [u32]) {
        let limit = radius_m * radius_m;
        let row = *own as usize * self.next.len();
        for (owner, range) in &self.groups {
            if self.points[range.clone()].iter().any(|p| (p - point).norm_squared() <= limit) {
                counts[row + *owner as usize] += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::RigidMotion;
    use crate::geometry::overlap::two_way_overlap;
    use crate::retrieval::generator;
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
                let pair = two_way_overlap(&sets[i], &sets[j], &RigidMotion::identity(), 0.1).ratio;
                assert!((f64::from(all.get(i, j)) - pair).abs() < 1e-6, "{i} {j}");
                positive += usize::from(pair > 0.0);
            }
        }
        assert!(positive > 10);
    }
}
