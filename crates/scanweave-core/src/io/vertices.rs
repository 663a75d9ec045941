//! Points and what belongs to them, gathered one by one.

use super::scanner::without_zeros;
use crate::scan::PointCloud;
use crate::scan::assemble::{Attributes, assemble_with};

/// Rows of a file that cannot be decoded where they lie. The optional columns have one entry a point,
/// or are left out.
#[derive(Default)]
pub(super) struct Vertices {
    pub xyz: Vec<[f64; 3]>,
    pub rgb: Option<Vec<[u8; 3]>>,
    pub intensity: Option<Vec<f32>>,
    pub normal: Option<Vec<[f32; 3]>>,
}

impl Vertices {
    /// The same without rows at zero where there are several: directions without a return.
    pub(super) fn without_zeros(mut self) -> Self {
        let xyz = without_zeros(self.xyz.len(), |i| self.xyz[i]);
        self.xyz = (0..self.xyz.len()).map(xyz).collect();
        self
    }

    pub(super) fn into_cloud(self) -> PointCloud {
        let n = self.xyz.len();
        let rgb = self.rgb.filter(|c| c.len() == n);
        let rgb = rgb.as_ref().map(|c| |i: usize| c[i]);
        let intensity = self.intensity.filter(|c| c.len() == n);
        let intensity = intensity.as_ref().map(|c| |i: usize| c[i]);
        let normal = self.normal.filter(|c| c.len() == n);
        let normal = normal.as_ref().map(|c| |i: usize| c[i]);
        let attributes = Attributes {
            rgb: rgb.as_ref().map(|f| f as &dyn Fn(usize) -> [u8; 3]),
            intensity: intensity.as_ref().map(|f| f as &dyn Fn(usize) -> f32),
            normal: normal.as_ref().map(|f| f as &dyn Fn(usize) -> [f32; 3]),
        };
        assemble_with(n, |i| self.xyz[i], &attributes, None)
    }
}
