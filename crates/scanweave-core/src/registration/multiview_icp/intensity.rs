//! Colour as evidence in the multiview ICP.
//!
//! Along a flat wall distances to tangent planes do not change; what is painted on it does. After
//! Park, Zhou & Koltun, "Colored point cloud registration revisited" (ICCV 2017): the intensity of a
//! surface is continued over the tangent plane of each of its points by a slope, and a point of the other
//! scan should have the intensity that is found there. Scans may be exposed differently: the mean
//! difference of two scans' intensities says nothing.

use crate::geometry::{Direction, Point};
use crate::registration::scan_model::ScanModel;

/// Difference of intensities beyond which two points do not show the same thing.
const UNLIKE: f32 = 0.3;
/// A point of one scan on the surface of another.
#[derive(Debug, Clone, Copy)]
pub(super) struct Touch {
    /// The point in the frame of the other scan.
    pub place: Point,
    /// Its intensity.
    pub intensity: f32,
    /// The point of the other surface that is nearest.
    pub nearest: usize,
}

/// What a touch says of the motion between the scans, in the other scan's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct IntensityResidual {
    /// Shade expected where the point lies, less its own.
    pub residual: f32,
    /// How that changes with the place, per metre.
    pub gradient: Direction,
    /// Tukey's biweight.
    pub weight: f32,
}

/// Residuals of touches between two scans, which know their intensities.
pub(super) fn residuals(touches: &[Touch], model: &ScanModel<'_>) -> Vec<(Point, IntensityResidual)> {
    let (surface, gradients) = (model.surface, model.gradients());
    let raw: Vec<f32> = touches
        .iter()
        .map(|t| {
            let q = t.nearest;
            surface.intensities[q] + gradients[q].dot(&(t.place - surface.points[q])) - t.intensity
        })
        .collect();
    // Of what could be the same thing: a bright lamp must not shift all others.
    let mut sorted = raw.clone();
    sorted.sort_unstable_by(f32::total_cmp);
    let middle = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let like: Vec<f32> = raw.iter().copied().filter(|r| (r - middle).abs() < UNLIKE).collect();
    let exposure = like.iter().sum::<f32>() / like.len().max(1) as f32;
    let residual = |(touch, raw): (&Touch, f32)| {
        let residual = raw - exposure;
        let weight = (1.0 - (residual / UNLIKE).powi(2)).max(0.0).powi(2);
        (touch.place, IntensityResidual { residual, gradient: gradients[touch.nearest], weight })
    };
    touches.iter().zip(raw).map(residual).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::config::RegistrationConfig;
    use crate::scan::Surface;

    /// A tilted plane whose intensity rises by `rise` a metre.
    fn ramp(rise: Direction) -> (Surface, Direction) {
        let (u, v) = (Direction::new(2.0, 1.0, -2.0) / 3.0, Direction::new(2.0, -2.0, 1.0) / 3.0);
        let normal = u.cross(&v);
        let points: Vec<Point> =
            (0..1600).map(|i| Point::from(u * (i % 40) as f32 * 0.02 + v * (i / 40) as f32 * 0.02)).collect();
        let intensities = points.iter().map(|p| 0.5 + rise.dot(&p.coords)).collect();
        let surface =
            Surface { normals: vec![normal; points.len()], points, intensities, ..Surface::default() };
        (surface, normal)
    }

    #[test]
    fn exposure_says_nothing_and_what_is_unlike_does_not_count() {
        let rise = Direction::new(0.3, -0.2, 0.4);
        let (surface, _) = ramp(rise);
        let model = ScanModel::new(&surface, 0.07, &RegistrationConfig::default());
        // The same points a little brighter, and one lamp.
        let mut touches: Vec<Touch> = (0..1600)
            .map(|k| Touch { place: surface.points[k], intensity: surface.intensities[k] + 0.1, nearest: k })
            .collect();
        touches[7].intensity = 5.0;
        let found = residuals(&touches, &model);
        for (k, (_, r)) in found.iter().enumerate() {
            if k == 7 {
                assert_eq!(r.weight, 0.0);
            } else {
                assert!(r.residual.abs() < 1e-5 && r.weight > 0.999, "{k}: {r:?}");
            }
        }
    }
}
