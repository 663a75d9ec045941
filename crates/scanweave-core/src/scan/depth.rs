//! Metric depth images, however they came to be.

use crate::geometry::Point;
use nalgebra::{Point3, Vector3};

/// Pinhole intrinsics; the centre of pixel `(u, v)` has image coordinates `(u, v)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal length along a row, pixels.
    pub fx: f64,
    /// Focal length along a column, pixels.
    pub fy: f64,
    /// Column of the optical axis, pixels.
    pub cx: f64,
    /// Row of the optical axis, pixels.
    pub cy: f64,
}

impl Intrinsics {
    /// Square pixels and the axis in the middle of the image.
    pub fn from_fov(width: usize, height: usize, horizontal_fov_deg: f64) -> Self {
        let f = 0.5 * width as f64 / (0.5 * horizontal_fov_deg.to_radians()).tan();
        Self { width, height, fx: f, fy: f, cx: 0.5 * (width as f64 - 1.0), cy: 0.5 * (height as f64 - 1.0) }
    }

    /// Direction of the ray through image position `(u, v)`, with a z of one: the ray
    /// parameter along it is the depth.
    #[inline]
    pub fn ray(&self, u: f64, v: f64) -> Vector3<f64> {
        Vector3::new((u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0)
    }

    /// Image position of a point in the camera's frame, if it is in front of the camera and in the image.
    #[inline]
    pub fn project(&self, p: &Point3<f64>) -> Option<(f64, f64)> {
        if p.z <= 0.0 {
            return None;
        }
        let (u, v) = (self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy);
        let inside = u >= -0.5 && v >= -0.5 && u < self.width as f64 - 0.5 && v < self.height as f64 - 0.5;
        inside.then_some((u, v))
    }
}

/// Depth along the optical axis, row-major `[height · width]`, metres; 0 where there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthImage {
    /// Camera it was taken with.
    pub intrinsics: Intrinsics,
    /// Depth of every pixel, metres.
    pub depth_m: Vec<f32>,
}

impl DepthImage {
    /// Points of all pixels with depth, in the camera's frame, row by row, with their pixel index.
    pub fn points(&self) -> impl Iterator<Item = (usize, Point)> {
        let k = self.intrinsics;
        self.depth_m.iter().enumerate().filter(|(_, z)| **z > 0.0).map(move |(i, &z)| {
            let ray = k.ray((i % k.width) as f64, (i / k.width) as f64);
            (i, Point::from((ray * f64::from(z)).cast::<f32>()))
        })
    }
}
