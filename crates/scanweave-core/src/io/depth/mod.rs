//! Depth images as single-frame scans: the image, the camera's calibration, the unit of depth, and the
//! colours and the pose that lie beside it.

mod camera_keys;
mod camera_search;
mod color_image;
mod frame;
mod image;
mod image_size;
mod intrinsics;
mod layout_lists;
mod names;
mod png_file;
#[cfg(test)]
mod tests;

use super::scan_file::{Note, ReadOptions, ScanFile, StoredScan};
use super::unpack_limit::UnpackLimit;
use crate::error::{Error, Result};
use crate::scan::assemble::{Attributes, assemble_with};
use crate::scan::{self, PointCloud};
use camera_search::{DepthUnits, find_camera, find_units};
use color_image::colors_of;
use frame::Frame;
use layout_lists::pose_beside;
use std::path::Path;

pub use camera_search::{UNITS_PER_M, find_intrinsics};
pub(super) use image::is_image;
pub use image::{StoredDepth, read_depth_png};
pub use intrinsics::{CameraMatrix, read_intrinsics};
pub(super) use names::{depth_images, is_depth};

/// Medians between which depth in an assumed unit is plausible, metres: depth cameras see from some
/// centimetres to less than ten metres. Indoor images have 1 to 4 m (7-Scenes: 1.9 m), which is 5 to 20 m
/// where 5000 units a metre are taken for 1000.
const PLAUSIBLE_MEDIAN_M: std::ops::Range<f64> = 0.05..10.0;

/// Reads a depth image with what lies beside it.
///
/// # Errors
/// Those of [`read_depth_png`] and [`find_intrinsics`]; [`Error::File`] for a calibration of images of
/// another shape.
pub(super) fn read(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<ScanFile> {
    let limit = UnpackLimit::of_scan(options, bytes.len() as u64);
    let image = image::decode(path, bytes, limit)?;
    let frame = Frame::of(path);
    let camera = find_camera(path, &frame, options.intrinsics.as_deref())?;
    let (intrinsics, mut notes) = camera.for_images(image.width, image.height)?;
    let (units, note) = find_units(&frame, &camera, options.depth_units_per_m)?;
    notes.extend(note);
    notes.extend(implausible(&image, units));
    let color = frame.color_image().map(|path| colors_of(&path, image.width, image.height, options));
    let (colors, note) = color.unwrap_or_default();
    notes.extend(note);
    let (pose, note) = pose_beside(&frame);
    notes.extend(note);
    let cloud = image.colored_cloud(&intrinsics, units.per_m, colors.as_deref())?;
    Ok(ScanFile { scans: vec![StoredScan { cloud, pose }], notes })
}

/// Reads a 16-bit depth image, with the intrinsics and the unit of depth of `options`, else those found beside
/// it, and what is worth knowing of how it was read.
///
/// # Errors
/// Those of [`read_depth_png`] and [`find_intrinsics`].
pub fn read_frame(path: impl AsRef<Path>, options: &ReadOptions) -> Result<(scan::DepthImage, Vec<Note>)> {
    let path = path.as_ref();
    let image = read_depth_png(path)?;
    let frame = Frame::of(path);
    let camera = find_camera(path, &frame, options.intrinsics.as_deref())?;
    let (intrinsics, mut notes) = camera.for_images(image.width, image.height)?;
    let (units, note) = find_units(&frame, &camera, options.depth_units_per_m)?;
    notes.extend(note);
    notes.extend(implausible(&image, units));
    Ok((image.to_metric(&intrinsics, units.per_m as f32), notes))
}

/// A warning where an assumed unit gives depth that no depth camera sees.
fn implausible(image: &StoredDepth, units: DepthUnits) -> Option<Note> {
    let mut measured: Vec<u16> = image.values.iter().copied().filter(|d| is_measured(*d)).collect();
    if !units.assumed || measured.is_empty() {
        return None;
    }
    let middle = measured.len() / 2;
    let median_m = f64::from(*measured.select_nth_unstable(middle).1) / units.per_m;
    let (than, other) = match median_m {
        m if m >= PLAUSIBLE_MEDIAN_M.end => ("more than 10 m", "5000 (TUM RGB-D) or 6553.5 (Replica)"),
        m if m < PLAUSIBLE_MEDIAN_M.start => ("less than 5 cm", "100 (centimetres)"),
        _ => return None,
    };
    Some(Note::warning(format!(
        "with 1000 units a metre the median depth is {than}, which is not that of a depth camera: \
         the unit may be another, such as --depth-scale {other}"
    )))
}

fn is_measured(depth: u16) -> bool {
    !matches!(depth, 0 | u16::MAX)
}

impl StoredDepth {
    /// Back-projects every measured pixel: z = d/depth_scale, x = (u−cx)·z/fx, y = (v−cy)·z/fy,
    /// with pixel centres at whole u, v. The camera, at the origin, is the viewpoint.
    ///
    /// `depth_scale` is in units a metre (1000 for millimetres). Pixels without a measurement
    /// count as dropped rows.
    ///
    /// # Errors
    /// [`Error::Setting`] when the scale or a focal length is not positive.
    pub fn to_cloud(&self, intrinsics: &CameraMatrix, depth_scale: f32) -> Result<PointCloud> {
        self.colored_cloud(intrinsics, f64::from(depth_scale), None)
    }

    /// [`to_cloud`](Self::to_cloud) with a colour a pixel, where there are as many.
    fn colored_cloud(
        &self,
        intrinsics: &CameraMatrix,
        units_per_m: f64,
        colors: Option<&[[u8; 3]]>,
    ) -> Result<PointCloud> {
        let CameraMatrix { fx, fy, cx, cy } = *intrinsics;
        for (key, value) in [("depth scale", units_per_m), ("fx", fx), ("fy", fy)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::setting(
                    key,
                    value.to_string(),
                    "a positive number",
                    "check the camera's calibration",
                ));
            }
        }
        let at = |i: usize| {
            if !is_measured(self.values[i]) {
                return [f64::NAN; 3];
            }
            let z = f64::from(self.values[i]) / units_per_m;
            let (u, v) = ((i % self.width) as f64, (i / self.width) as f64);
            [(u - cx) * z / fx, (v - cy) * z / fy, z]
        };
        let colors = colors.filter(|c| c.len() == self.values.len());
        let color = colors.map(|colors| move |i: usize| colors[i]);
        let rgb = color.as_ref().map(|c| c as &dyn Fn(usize) -> [u8; 3]);
        let attributes = Attributes { rgb, ..Attributes::default() };
        Ok(assemble_with(self.values.len(), at, &attributes, Some([0.0; 3])))
    }

    /// The image in metres with its camera; `depth_scale` is in units a metre.
    pub fn to_metric(&self, intrinsics: &CameraMatrix, depth_scale: f32) -> scan::DepthImage {
        let CameraMatrix { fx, fy, cx, cy } = *intrinsics;
        let metres = |d: &u16| if is_measured(*d) { f32::from(*d) / depth_scale } else { 0.0 };
        scan::DepthImage {
            intrinsics: scan::Intrinsics { width: self.width, height: self.height, fx, fy, cx, cy },
            depth_m: self.values.iter().map(metres).collect(),
        }
    }
}
