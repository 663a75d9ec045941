//! Counting occupied grid cells, and the cell size that occupies a wanted number of them.

use crate::geometry::Point;

/// Number of distinct keys by linear counting (Whang et al. 1990): hash into a bit map of
/// `2^k ≥ 4·capacity` bits and read the count off its fill.
///
/// The standard error is below 0.3 % of `capacity`; small counts are exact but for
/// hash collisions. One pass, no allocation a key: fast enough for millions of points.
fn distinct(keys: impl Iterator<Item = [u32; 3]>, capacity: usize) -> usize {
    let bits = (4 * capacity).next_power_of_two().max(1 << 16);
    let mut map = vec![0u64; bits / 64];
    for [x, y, z] in keys {
        let mut h = u64::from(x).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        h = (h ^ (h >> 32) ^ u64::from(y)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        h = (h ^ (h >> 29) ^ u64::from(z)).wrapping_mul(0x94d0_49bb_1331_11eb);
        h ^= h >> 31;
        let bit = h as usize & (bits - 1);
        map[bit / 64] |= 1 << (bit % 64);
    }
    let set: usize = map.iter().map(|w| w.count_ones() as usize).sum();
    // A full map says only "very many"; half a free bit stands for it.
    let free = ((bits - set) as f64).max(0.5) / bits as f64;
    (-(bits as f64) * free.ln()).round() as usize
}

/// Number of different positions among `points`, to a fraction of a percent.
pub fn distinct_positions(points: &[Point]) -> usize {
    // Adding zero turns −0 into +0, which is the same position.
    distinct(points.iter().map(|p| [p.x, p.y, p.z].map(|v| (v + 0.0).to_bits())), points.len())
}

/// Number of occupied cells of `size_m`, to a fraction of a percent while it is below
/// some three times `capacity`.
pub fn occupied_cells(points: &[Point], size_m: f64, capacity: usize) -> usize {
    let inverse = 1.0 / size_m;
    let cell = |v: f32| (f64::from(v) * inverse).floor() as i64 as u32;
    distinct(points.iter().map(|p| [cell(p.x), cell(p.y), cell(p.z)]), capacity)
}

/// Cell size, metres, at which `points` occupy `target` cells within 1 %, or as near to
/// that as the points allow. `start_m` (positive) is a first guess.
///
/// Bracketed secant on log count over log size, where a surface is a line of slope −2.
pub fn size_for_occupancy(points: &[Point], target: usize, start_m: f64) -> f64 {
    const ROUNDS: usize = 24;
    let wanted = (target.max(1) as f64).ln();
    // (log size, log count): `fine` has too many cells, `coarse` too few.
    let (mut fine, mut coarse) = (None::<(f64, f64)>, None::<(f64, f64)>);
    let mut best = (f64::INFINITY, start_m);
    let mut size = start_m.ln();
    for _ in 0..ROUNDS {
        let count = (occupied_cells(points, size.exp(), target).max(1) as f64).ln();
        let off = count - wanted;
        if off.abs() < best.0 {
            best = (off.abs(), size.exp());
        }
        if off.abs() < 0.01 {
            break;
        }
        if off > 0.0 {
            fine = Some((size, count));
        } else {
            coarse = Some((size, count));
        }
        size = match (fine, coarse) {
            (Some(f), Some(c)) => {
                let share = ((f.1 - wanted) / (f.1 - c.1).max(1e-9)).clamp(0.1, 0.9);
                f.0 + share * (c.0 - f.0)
            }
            (Some(_), None) => size + (0.5 * off).max(0.3),
            _ => size + (0.5 * off).min(-0.3),
        };
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::voxel::occupied_voxels;

    fn sheet(n: usize, spacing: f32) -> Vec<Point> {
        (0..n * n)
            .map(|i| Point::new((i % n) as f32 * spacing + 1e-4, (i / n) as f32 * spacing + 1e-4, 0.3))
            .collect()
    }

    #[test]
    fn counts_agree_with_sorting() {
        let points = sheet(150, 0.01);
        for size in [0.004, 0.013, 0.05, 0.7] {
            let exact = occupied_voxels(&points, size as f32);
            let counted = occupied_cells(&points, size, 20_000);
            assert!(counted.abs_diff(exact) as f64 <= 0.005 * exact as f64, "{counted} of {exact} at {size}");
        }
        let doubled: Vec<Point> = points.iter().chain(&points).copied().collect();
        assert!(distinct_positions(&doubled).abs_diff(points.len()) < 100);
        assert_eq!(distinct_positions(&[Point::new(0.0, 0.0, 0.0), Point::new(-0.0, 0.0, 0.0)]), 1);
    }

    #[test]
    fn the_size_that_fills_a_sheet_has_a_closed_form() {
        // 300 × 300 points 1 cm apart fill 3 m × 3 m: cells of size s are (3/s)² in number.
        let points = sheet(300, 0.01);
        for start in [1e-4, 0.03, 50.0] {
            let size = size_for_occupancy(&points, 900, start);
            assert!((size - 0.1).abs() < 0.003, "{size} from {start}");
        }
    }

    #[test]
    fn an_unreachable_target_ends_at_the_nearest_count() {
        let points = vec![Point::new(1.0, 2.0, 3.0); 50];
        assert!(size_for_occupancy(&points, 10, 1.0).is_finite());
    }
}
