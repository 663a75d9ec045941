//! Thinning by a voxel grid.

use super::Point;

/// Voxel of a point for voxels `size_m` wide with a corner at the origin.
#[inline]
pub fn voxel_of(p: &Point, size_m: f32) -> [i32; 3] {
    [(p.x / size_m).floor() as i32, (p.y / size_m).floor() as i32, (p.z / size_m).floor() as i32]
}

/// One thinned point and the indices of the points it stands for.
#[derive(Debug, Clone, PartialEq)]
pub struct VoxelGroups {
    /// Point indices, grouped by voxel.
    members: Vec<u32>,
    /// Start of each group in `members`, and the end of the last.
    starts: Vec<u32>,
}

impl VoxelGroups {
    /// Groups `points` (finite) by voxels of `size_m`; groups are ordered by voxel
    /// coordinates, members by index, so that the result depends on nothing else.
    pub fn new(points: &[Point], size_m: f32) -> Self {
        let mut keyed: Vec<([i32; 3], u32)> =
            points.iter().enumerate().map(|(i, p)| (voxel_of(p, size_m), i as u32)).collect();
        keyed.sort_unstable();
        let mut starts: Vec<u32> = Vec::new();
        for i in 0..keyed.len() {
            if i == 0 || keyed[i].0 != keyed[i - 1].0 {
                starts.push(i as u32);
            }
        }
        starts.push(keyed.len() as u32);
        Self { members: keyed.into_iter().map(|(_, i)| i).collect(), starts }
    }

    /// Number of occupied voxels.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// True when no voxel is occupied.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Indices of the points in each occupied voxel.
    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        self.starts.windows(2).map(|w| &self.members[w[0] as usize..w[1] as usize])
    }
}

/// Mean point of every occupied voxel, ordered by voxel coordinates.
pub fn voxel_means(points: &[Point], size_m: f32) -> Vec<Point> {
    VoxelGroups::new(points, size_m)
        .iter()
        .map(|group| {
            let sum = group.iter().fold(nalgebra::Vector3::<f64>::zeros(), |sum, &i| {
                sum + points[i as usize].coords.cast::<f64>()
            });
            Point::from((sum / group.len() as f64).cast::<f32>())
        })
        .collect()
}

/// Number of occupied voxels of `size_m`.
pub fn occupied_voxels(points: &[Point], size_m: f32) -> usize {
    let mut keys: Vec<[i32; 3]> = points.iter().map(|p| voxel_of(p, size_m)).collect();
    keys.sort_unstable();
    keys.dedup();
    keys.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_and_counts_of_a_hand_made_set() {
        let points = [[0.1, 0.1, 0.1], [0.3, 0.1, 0.1], [1.5, 0.0, 0.0], [-0.1, 0.0, 0.0]].map(Point::from);
        let means = voxel_means(&points, 1.0);
        assert_eq!(means.len(), 3);
        assert_eq!(occupied_voxels(&points, 1.0), 3);
        assert!((means[0] - Point::new(-0.1, 0.0, 0.0)).norm() < 1e-6);
        assert!((means[1] - Point::new(0.2, 0.1, 0.1)).norm() < 1e-6);
        assert!((means[2] - Point::new(1.5, 0.0, 0.0)).norm() < 1e-6);
        assert!(VoxelGroups::new(&[], 1.0).is_empty());
    }
}
