//! The space that a scan saw to be empty.

use crate::geometry::Point;
use crate::scan::Surface;

/// Columns of a [`FreeSpace`]: 3° each.
const AZIMUTHS: usize = 120;
/// Rows of a [`FreeSpace`]: 3° each.
const ELEVATIONS: usize = 60;

/// Distance of the nearest surface from the viewpoint in every direction that the scan saw
/// something in: what lies nearer was empty when the scan was taken.
pub struct FreeSpace {
    viewpoint: Point,
    /// `[ELEVATIONS · AZIMUTHS]`, metres; infinite where nothing was seen.
    nearest_m: Vec<f32>,
}

impl FreeSpace {
    pub(super) fn new(surface: &Surface) -> Self {
        let mut nearest_m = vec![f32::INFINITY; AZIMUTHS * ELEVATIONS];
        for p in &surface.points {
            if let Some((bin, distance)) = bin(&surface.viewpoint, p) {
                nearest_m[bin] = nearest_m[bin].min(distance);
            }
        }
        Self { viewpoint: surface.viewpoint, nearest_m }
    }

    /// How far in front of what the scan saw in its direction a point lies, metres: positive in
    /// space that was seen to be empty, `None` where the scan saw nothing.
    #[inline]
    pub fn in_front_m(&self, p: &Point) -> Option<f32> {
        let (bin, distance) = bin(&self.viewpoint, p)?;
        let nearest = self.nearest_m[bin];
        (nearest < f32::INFINITY).then_some(nearest - distance)
    }
}

/// Direction bin of a point seen from the viewpoint, and its distance.
#[inline]
fn bin(viewpoint: &Point, p: &Point) -> Option<(usize, f32)> {
    let d = p - viewpoint;
    let distance = d.norm();
    if distance <= f32::EPSILON {
        return None;
    }
    let share = |v: f32, n: usize| ((v * n as f32) as usize).min(n - 1);
    let azimuth = d.y.atan2(d.x) / std::f32::consts::TAU + 0.5;
    // Rows of equal angle, not of equal area: sensors sample angles.
    let elevation = (d.z / distance).clamp(-1.0, 1.0).asin() / std::f32::consts::PI + 0.5;
    Some((share(elevation, ELEVATIONS) * AZIMUTHS + share(azimuth, AZIMUTHS), distance))
}
